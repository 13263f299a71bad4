"""Which clouds a run works on: folders, patterns and files, expanded and named."""

from __future__ import annotations

import glob
import itertools
import os
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from brafit.cloud.read import FORMATS, SURE_FORMATS
from brafit.errors import InputError
from brafit.landmarks.file import landmarks_path
from brafit.naming import folded, on_disk, safe_name, shown
from brafit.samples import sample_paths

SAMPLES = "samples"
"""The word that stands for the bundled scans."""


@dataclass(frozen=True)
class _Search:
    """What counts as a cloud.

    Attributes:
        propose: also one without a landmark file.
        suffixes: of clouds, beside `FORMATS`.
    """

    propose: bool
    suffixes: frozenset[str]

    @property
    def formats(self) -> frozenset[str]:
        return FORMATS | self.suffixes

    @property
    def sure(self) -> frozenset[str]:
        """Those of them that hold hardly anything but scans."""
        return SURE_FORMATS | self.suffixes


def find_scans(
    scans: str | Path | Sequence[str | Path] = SAMPLES, propose: bool = False, suffixes: frozenset[str] = frozenset()
) -> list[Path]:
    """The clouds that `scans` means, sorted, each once.

    Each entry is one of
      - `samples`: the bundled scans;
      - a folder: every cloud in it (not in its subfolders) that has a landmark file of the same stem;
      - a pattern (`*`, `?`, `[...]`, `**`): every cloud and folder that it matches; tables and arrays (`.txt`, `.csv`,
        `.npy` and the like), which may be anything, only if it names that extension or a landmark file is beside them;
      - a file: itself, whatever it is, so that a missing or unusable one is reported by `load_scan`.
    A cloud without a landmark file is left out only where a folder was named. Hidden files are passed over, unless they
    are named.

    Args:
        scans: an entry or a list of them, see above.
        propose: landmarks are proposed where there are none: a folder means every cloud in it, tables and arrays as in
            a pattern.
        suffixes: of clouds that readers from outside of brafit read.

    Raises:
        InputError: nothing at all was found. (An entry without any match among others that have some is returned as it
            stands, so that the run reports it and goes on.)
    """
    search = _Search(propose, suffixes)
    entries = [scans] if isinstance(scans, str | Path) else list(scans)
    if not entries:
        raise InputError("scans", "the list is empty", "Name a folder, a pattern, a file, or 'samples'")
    found: dict[str, Path] = {}
    fruitless: list[str] = []
    for entry in entries:
        paths = _expand(str(entry), search)
        if not paths:
            fruitless.append(str(entry))
        found.update((_absolute(path), path) for path in paths)
    if not found:
        raise _nothing(fruitless[0], search)
    found.update((_absolute(Path(entry)), Path(entry)) for entry in fruitless)
    return sorted(found.values())


def _absolute(path: Path) -> str:
    """What tells files apart that are named more than once. Links are files of their own: two of them may lead to one
    cloud, each with landmarks of its own.
    """
    return os.path.abspath(path)


def passed_over(
    scans: str | Path | Sequence[str | Path], propose: bool = False, suffixes: frozenset[str] = frozenset()
) -> list[str]:
    """A line for each folder named in which clouds have no landmark file, and what to do about it; with `propose` for
    each in which tables are left out.
    """
    search = _Search(propose, suffixes)
    entries = [scans] if isinstance(scans, str | Path) else list(scans)
    lines = []
    for folder in (on_disk(Path(str(entry)).expanduser()) for entry in entries):
        if not folder.is_dir():
            continue
        left = _tables(folder, search) if propose else [path for path in _visible(folder) if _is_bare(path, search)]
        if left:
            what = f"{_counted(left, 'table' if propose else 'cloud')} without landmark file passed over"
            named = ", ".join(sorted({f"{folder}/*{path.suffix}" for path in left}))
            other = (
                f"mark them with brafit-mark {folder}; for torsos brafit-inspect {folder} --beside proposes landmarks"
            )
            remedy = f"to take such, name them: {named}" if propose else other
            lines.append(shown(f"{folder}: {what} ({_listed(left)}): {remedy}"))
    return lines


def scan_names(paths: Sequence[str | Path], given: Sequence[str] = ()) -> list[str]:
    """A name for each path, no two alike (also where case is ignored), which a folder in a run's folder can have.

    The stem; for paths with the same stem, with the extension or with the folder, if that tells them apart; at last
    with a number.

    Args:
        paths: of the clouds.
        given: names to take instead, empty ones aside; as many as paths, or none.
    """
    paths = [Path(path) for path in paths]
    given = given or [""] * len(paths)
    groups: dict[str, list[Path]] = {}
    for path, own in zip(paths, given, strict=True):
        if not own:
            groups.setdefault(folded(path.stem), []).append(path)
    chosen = {stem: _telling(group) for stem, group in groups.items()}
    names = [own or chosen[folded(path.stem)](path) for path, own in zip(paths, given, strict=True)]
    return numbered([safe_name(name) for name in names], [bool(own) for own in given])


def _telling(group: list[Path]) -> Callable[[Path], str]:
    """The shortest way of naming these paths that tells them apart, or else the last."""
    ways: list[Callable[[Path], str]] = [
        lambda path: path.stem,
        lambda path: f"{path.stem}_{path.suffix.lstrip('.')}",
        lambda path: f"{path.absolute().parent.name}_{path.stem}",
    ]
    return next((way for way in ways if len({folded(way(path)) for path in group}) == len(group)), ways[-1])


def numbered(names: Sequence[str], first: Sequence[bool] = ()) -> list[str]:
    """Names with numbers at those that stood before; those marked in `first` have theirs before the others."""
    used: set[str] = set()
    unique = list(names)
    for k in sorted(range(len(names)), key=lambda k: not (first and first[k])):
        candidate, number = names[k], 2
        while folded(candidate) in used:
            candidate, number = f"{names[k]}_{number}", number + 1
        used.add(folded(candidate))
        unique[k] = candidate
    return unique


def _expand(entry: str, search: _Search) -> list[Path]:
    path = on_disk(Path(entry).expanduser())
    if path.is_dir():
        return _in_folder(path, search)
    if path.exists():
        return [path]
    if entry == SAMPLES:
        return sample_paths()
    if glob.has_magic(entry):
        matches = _matches(str(path))
        inside = [cloud for folder in matches if folder.is_dir() for cloud in _in_folder(folder, search)]
        named = Path(entry).suffix.lower()
        return [match for match in matches if _is_cloud(match, search, named)] + inside
    return [path] if path.suffix else []


def _matches(pattern: str) -> list[Path]:
    """What a pattern matches, its letters with marks composed or decomposed. `*` does not match hidden files."""
    parts = Path(pattern).parts
    plain = list(itertools.takewhile(lambda part: not glob.has_magic(part), parts))
    rest = str(Path(*parts[len(plain) :]))
    forms = {rest, *(unicodedata.normalize(form, rest) for form in ("NFC", "NFD"))}
    folder = glob.escape(str(on_disk(Path(*plain))))
    return [Path(match) for form in sorted(forms) for match in glob.glob(f"{folder}/{form}", recursive=True)]


def _is_cloud(path: Path, search: _Search, named: str = "") -> bool:
    """Whether a file found in passing is a cloud: of a sure format, or of the named one, or with a landmark file."""
    kind = path.suffix.lower()
    sure = kind in search.sure or kind == named
    return kind in search.formats and path.is_file() and (sure or landmarks_path(path).is_file())


def _is_bare(path: Path, search: _Search) -> bool:
    """Whether it is a cloud of a sure format without a landmark file."""
    return _is_cloud(path, search) and not landmarks_path(path).is_file()


def _visible(folder: Path) -> list[Path]:
    """A folder's files, without the hidden ones: `._NAME` is no cloud, but what macOS keeps beside one."""
    return [path for path in folder.iterdir() if not path.name.startswith(".")]


def _in_folder(folder: Path, search: _Search) -> list[Path]:
    clouds = [path for path in _visible(folder) if _is_cloud(path, search)]
    return [path for path in clouds if search.propose or landmarks_path(path).is_file()]


def _tables(folder: Path, search: _Search) -> list[Path]:
    """Files that may be clouds or anything else, without landmark files."""
    maybe = [path for path in _visible(folder) if path.suffix.lower() in search.formats - search.sure]
    return [path for path in maybe if path.is_file() and not _is_cloud(path, search)]


def _counted(paths: Sequence[Path], word: str) -> str:
    return f"{len(paths)} {word}{'s' * (len(paths) > 1)}"


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(sorted(path.name for path in paths)[:3]) + (", ..." if len(paths) > 3 else "")


def _nothing(entry: str, search: _Search) -> InputError:
    """Why an entry gave no cloud, as helpfully as the disk allows."""
    path = on_disk(Path(entry).expanduser())
    formats = ", ".join(sorted(search.formats))
    if not path.is_dir():
        what = "the pattern matches no cloud" if glob.has_magic(entry) else "there is no such file or folder"
        return InputError(entry, what, f"Name a folder, a pattern or a file of {formats}, or 'samples'")
    clouds = sum(_is_cloud(child, search) for child in _visible(path))
    if clouds:
        what = f"the folder has no cloud with a landmark file, and {clouds} without"
        remedy = f"Mark them with brafit-mark {path}; for torsos scan.propose=true proposes landmarks"
        return InputError(entry, what, remedy)
    if tables := _tables(path, search):
        what = f"the folder holds {_counted(tables, 'table')} that may be clouds ({_listed(tables)}), and no sure one"
        return InputError(entry, what, f"Write landmark files beside them, or name them: {path}/*{tables[0].suffix}")
    below = sorted(child.name for child in _visible(path) if child.is_dir() and _in_folder(child, search))
    hint = f"Name a folder inside it: {', '.join(below)}" if below else f"Name a folder with clouds ({formats})"
    return InputError(entry, "the folder holds no cloud", hint)
