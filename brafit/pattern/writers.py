"""Writers of pattern files: brafit's own by their names, and what others must look like: docs/extending.md."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from brafit.errors import ConfigError

if TYPE_CHECKING:
    from brafit.pattern.finish import Pattern


class Writer(Protocol):
    """Whatever writes files of known names into a scan's folder."""

    files: tuple[str, ...]


class PatternWriter(ABC):
    """Writes finished patterns into a folder.

    Attributes:
        files: names of all files that it writes, without folders.
    """

    files: tuple[str, ...]

    @abstractmethod
    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        """Write the files, each whole or not at all (`brafit.atomic`).

        Args:
            folder: made if it does not exist.
            patterns: of one scan, or of all scans of a run (`pattern.nest`); lengths are mm.
            title: the scan's name, or the run's.
            note: side, cup model and number of panels, or how many scans.
        """


class SvgWriter(PatternWriter):
    """See `brafit.pattern.svg`."""

    files = ("patterns.svg",)

    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        from brafit.pattern.svg import write_svg

        write_svg(folder / "patterns.svg", patterns, title, note)


class DxfWriter(PatternWriter):
    """See `brafit.pattern.dxf`."""

    files = ("patterns.dxf",)

    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        from brafit.pattern.dxf import write_dxf

        write_dxf(folder / "patterns.dxf", patterns, title)


class PdfWriter(PatternWriter):
    """Page by page, and one large sheet, see `brafit.pattern.pdf`."""

    files = ("patterns.pdf", "patterns_sheet.pdf")

    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        from brafit.pattern.pdf import write_pdf_sheet, write_pdf_tiles

        write_pdf_tiles(folder / "patterns.pdf", patterns, title, note)
        write_pdf_sheet(folder / "patterns_sheet.pdf", patterns, title, note)


class ProjectorWriter(PatternWriter):
    """The sheet for projectors, see `brafit.pattern.pdf`."""

    files = ("patterns_projector.pdf",)

    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        from brafit.pattern.pdf import write_pdf_projector

        write_pdf_projector(folder / "patterns_projector.pdf", patterns, title, note)


WRITERS: dict[str, PatternWriter] = {
    "svg": SvgWriter(),
    "dxf": DxfWriter(),
    "pdf": PdfWriter(),
    "projector": ProjectorWriter(),
}
"""brafit's own, each imported by itself as it writes, so that it costs only what it needs."""


OTHER_FILES = ("report.html", "thumbnail.png", "fit.json")
"""What is written beside the patterns of a scan and its cup."""


def check_writers(formats: Iterable[object]) -> None:
    """Refuse what is no pattern format.

    Raises:
        ConfigError: a name that no writer has, an object that is no writer, or two that write the same file.
    """
    seen = {file for known in WRITERS.values() for file in known.files} | {*OTHER_FILES}
    for entry in formats:
        if isinstance(entry, PatternWriter):
            seen |= check_files("pattern.formats", entry, seen)
        elif not (isinstance(entry, str) and entry in WRITERS):
            raise no_writer("pattern.formats", entry, WRITERS, "brafit.pattern.PatternWriter")


def no_writer(setting: str, entry: object, names: Iterable[str], kind: str) -> ConfigError:
    """What to raise for an entry of a setting that is neither one of brafit's own writers nor another of that kind."""
    what = entry if isinstance(entry, str | int | float) else getattr(entry, "__name__", type(entry).__name__)
    own = f"{{_target_: MODULE.CLASS}}, a {kind}"
    return ConfigError(f"{setting}={what}: must be a list of {', '.join(names)}, {own}")


def check_files(setting: str, writer: Writer, seen: Collection[str]) -> set[str]:
    """The files of a writer from outside of brafit.

    Args:
        setting: that names it.
        writer: of patterns or of cups.
        seen: files that others write.

    Raises:
        ConfigError: they are no names of files, or another writes one of them.
    """
    name, files = type(writer).__name__, getattr(writer, "files", None)
    if not (isinstance(files, tuple) and files and all(isinstance(f, str) and Path(f).name == f for f in files)):
        raise ConfigError(f"{setting}: {name}.files must be a tuple of names of files, got {files}")
    if taken := set(files).intersection(seen):
        raise ConfigError(f"{setting}: {name} writes {min(taken)}, which something else writes")
    return set(files)


def written(folder: Path, writer: Writer) -> list[Path]:
    """The files of a writer that has written.

    Args:
        folder: that it wrote into.
        writer: of patterns or of cups.

    Raises:
        RuntimeError: one is not there.
    """
    files = [folder / name for name in writer.files]
    if missing := [file.name for file in files if not file.is_file()]:
        raise RuntimeError(f"{type(writer).__name__} did not write {', '.join(missing)}")
    return files


def write_patterns(
    folder: Path, patterns: Sequence[Pattern], title: str, note: str, formats: Iterable[str | PatternWriter]
) -> list[Path]:
    """Write pattern files, by brafit's own writers (names of `WRITERS`) and others.

    Returns:
        the files, in the order written.

    Raises:
        RuntimeError: a writer that left a file unwritten.
    """
    every: list[Path] = []
    for entry in formats:
        writer = WRITERS[entry] if isinstance(entry, str) else entry
        writer.write(folder, patterns, title, note)
        every += written(folder, writer)
    return every
