"""Which clouds a run works on: folders, patterns and files, expanded and named."""

from __future__ import annotations

import glob
from collections.abc import Callable, Sequence
from pathlib import Path

from brafit.cloud.read import FORMATS, SURE_FORMATS
from brafit.errors import InputError
from brafit.landmarks.file import landmarks_path
from brafit.samples import sample_paths

SAMPLES = "samples"
"""The word that stands for the bundled scans."""


def find_scans(scans: str | Path | Sequence[str | Path] = SAMPLES) -> list[Path]:
    """The clouds that `scans` means, sorted, each once.

    Each entry is one of
      - `samples`: the bundled scans;
      - a folder: every cloud in it (not in its subfolders) that has a landmark file of the same stem;
      - a pattern (`*`, `?`, `[...]`, `**`): every cloud and folder that it matches; tables and arrays (`.txt`, `.csv`,
        `.npy` and the like), which may be anything, only if it names that extension or a landmark file is beside them;
      - a file: itself, whatever it is, so that a missing or unusable one is reported by `load_scan`.
    A cloud without a landmark file is left out only where a folder was named.

    Raises:
        InputError: nothing at all was found. (An entry without any match among others that have some is returned as it
            stands, so that the run reports it and goes on.)
    """
    entries = [scans] if isinstance(scans, str | Path) else list(scans)
    if not entries:
        raise InputError("scans", "the list is empty", "Name a folder, a pattern, a file, or 'samples'")
    found: dict[Path, Path] = {}
    fruitless: list[str] = []
    for entry in entries:
        paths = _expand(str(entry))
        if not paths:
            fruitless.append(str(entry))
        found.update((path.resolve(), path) for path in paths)
    if not found:
        raise _nothing(fruitless[0])
    found.update((Path(entry).resolve(), Path(entry)) for entry in fruitless)
    return sorted(found.values())


def passed_over(scans: str | Path | Sequence[str | Path]) -> list[str]:
    """A line for each folder named in which clouds have no landmark file, and what to do about it."""
    entries = [scans] if isinstance(scans, str | Path) else list(scans)
    lines = []
    for folder in (Path(str(entry)).expanduser() for entry in entries):
        if not folder.is_dir():
            continue
        sure = [path for path in folder.iterdir() if _is_cloud(path) and not landmarks_path(path).is_file()]
        if sure:
            shown = ", ".join(sorted(path.name for path in sure)[:3]) + (", ..." if len(sure) > 3 else "")
            what = f"{len(sure)} cloud{'s' * (len(sure) > 1)} without landmark file passed over ({shown})"
            lines.append(f"{folder}: {what}: brafit-inspect {folder} --beside proposes landmarks")
    return lines


def scan_names(paths: Sequence[str | Path]) -> list[str]:
    """A name for each path, no two alike (also where case is ignored).

    The stem; for paths with the same stem, with the extension or with the folder, if that tells them apart; at last
    with a number.
    """
    paths = [Path(path) for path in paths]
    groups: dict[str, list[Path]] = {}
    for path in paths:
        groups.setdefault(path.stem.lower(), []).append(path)
    chosen = {stem: _telling(group) for stem, group in groups.items()}
    return _numbered([chosen[path.stem.lower()](path) for path in paths])


def _telling(group: list[Path]) -> Callable[[Path], str]:
    """The shortest way of naming these paths that tells them apart, or else the last."""
    ways: list[Callable[[Path], str]] = [
        lambda path: path.stem,
        lambda path: f"{path.stem}_{path.suffix.lstrip('.')}",
        lambda path: f"{path.absolute().parent.name}_{path.stem}",
    ]
    return next((way for way in ways if len({way(path).lower() for path in group}) == len(group)), ways[-1])


def _numbered(names: list[str]) -> list[str]:
    used: set[str] = set()
    unique = []
    for name in names:
        candidate, number = name, 2
        while candidate.lower() in used:
            candidate, number = f"{name}_{number}", number + 1
        used.add(candidate.lower())
        unique.append(candidate)
    return unique


def _expand(entry: str) -> list[Path]:
    path = Path(entry).expanduser()
    if path.is_dir():
        return _in_folder(path)
    if path.exists():
        return [path]
    if entry == SAMPLES:
        return sample_paths()
    if glob.has_magic(entry):
        matches = [Path(match) for match in glob.glob(str(path), recursive=True)]
        inside = [cloud for folder in matches if folder.is_dir() for cloud in _in_folder(folder)]
        named = Path(entry).suffix.lower()
        return [match for match in matches if _is_cloud(match, named)] + inside
    return [path] if path.suffix else []


def _is_cloud(path: Path, named: str = "") -> bool:
    """Whether a file found in passing is a cloud: of a sure format, or of the named one, or with a landmark file."""
    kind = path.suffix.lower()
    sure = kind in SURE_FORMATS or kind == named or landmarks_path(path).is_file()
    return kind in FORMATS and sure and path.is_file()


def _in_folder(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if _is_cloud(path) and landmarks_path(path).is_file()]


def _nothing(entry: str) -> InputError:
    """Why an entry gave no cloud, as helpfully as the disk allows."""
    path = Path(entry).expanduser()
    formats = ", ".join(sorted(FORMATS))
    if not path.is_dir():
        what = "the pattern matches no cloud" if glob.has_magic(entry) else "there is no such file or folder"
        return InputError(entry, what, f"Name a folder, a pattern or a file of {formats}, or 'samples'")
    clouds = sum(_is_cloud(child) for child in path.iterdir())
    if clouds:
        what = f"the folder has no cloud with a landmark file, and {clouds} without"
        return InputError(entry, what, "Write NAME.json beside NAME.ply, see brafit/landmarks/landmarks.schema.json")
    below = sorted(child.name for child in path.iterdir() if child.is_dir() and _in_folder(child))
    hint = f"Name a folder inside it: {', '.join(below)}" if below else f"Name a folder with clouds ({formats})"
    return InputError(entry, "the folder holds no cloud", hint)
