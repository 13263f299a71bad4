"""Names of files and scans: how they are shown, found on the disk, and kept apart from a run's own files."""

from __future__ import annotations

import io
import re
import sys
import tempfile
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

OWN = re.compile(
    r"(summary|sweep)(_\d+_of_\d+)?\.(csv|parquet)|index\.html|config\.yaml|errors\.log|tensorboard|sweep"
    r"|patterns(_sheet|_projector)?\.(svg|dxf|pdf)|multirun\.yaml|(con|prn|aux|nul|com\d|lpt\d)(\..*)?"
)
"""Names in a run's folder that are no scan's: those of its own files, and those that Windows keeps for itself."""
LONGEST = 180
"""Bytes of a scan's name; with what is added to it, a file's name must stay below 255."""
_STRAY = re.compile("[\ud800-\udfff]")


def shown(text: str) -> str:
    """A text that can be written: bytes of a file's name that are no text become replacement signs."""
    return _STRAY.sub("\ufffd", text)


def print_anything() -> None:
    """Let the terminal show a sign for each letter that it does not have, rather than raise an error."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def folded(name: str) -> str:
    """What is alike for names that a disk may take for the same one."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def on_disk(path: str | Path) -> Path:
    """The path as the disk has it: letters with marks may be composed (u with two dots: one sign) or decomposed (two),
    and look the same. As it is, where no such file exists.
    """
    path = Path(path)
    if str(path).isascii() or path.exists():
        return path
    folder = on_disk(path.parent)
    forms = (folder / unicodedata.normalize(form, path.name) for form in ("NFC", "NFD"))
    return next((form for form in forms if form.exists()), path)


@contextmanager
def plain_path(path: Path) -> Iterator[Path]:
    """The path; if its bytes are no text, a link to it for the `with` block: libraries in other languages refuse such
    paths.
    """
    if shown(str(path.absolute())) == str(path.absolute()):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        link = Path(folder) / f"link{shown(path.suffix)}"
        link.symlink_to(path.absolute())
        yield link


def safe_name(name: str) -> str:
    """A scan's name as its folder can be called: no name of a run's own files, none that is hidden, a part of a path,
    or too long.
    """
    name = unicodedata.normalize("NFC", shown(name))
    name = "".join("_" if c in "/\\" or not c.isprintable() else c for c in name)
    name = name.encode()[:LONGEST].decode(errors="ignore").rstrip(" .").strip()
    if not name:
        return "scan"
    return f"scan_{name}" if name.startswith(".") or OWN.fullmatch(folded(name)) else name


def told_apart(folders: Sequence[Path]) -> list[str]:
    """What to call folders: by their own names and, where several of these are alike, by those above as well."""
    names, depth = [folder.name for folder in folders], 1
    while len(set(names)) < len(names) and depth < max(len(folder.parts) for folder in folders):
        depth += 1
        alike = {name for name, count in Counter(names).items() if count > 1}
        longer = ("/".join(folder.parts[-depth:]) for folder in folders)
        names = [more if name in alike else name for name, more in zip(names, longer, strict=True)]
    return names
