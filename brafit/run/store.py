"""What is finished already: each scan's fit.json says from which files and settings it was made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brafit import __version__
from brafit.errors import ConfigError, InputError
from brafit.report.table import SUMMARY_KEYS
from brafit.run.dataset import ScanRef
from brafit.run.job import Done, Overview, common_cause

IRRELEVANT = frozenset(
    {"scans", "out", "threads", "batch", "device", "dataset", "sinks", "resume", "patience", "experiment"}
)
"""Settings that say nothing about what comes out for a scan."""
SHOWN = 3
"""Folders that an error names."""
TABLE = "summary.csv"
"""The table of a run, or of what was collected of several."""
SIZES = "sizes.csv"
"""The table that brafit-sizes writes."""
_OWNERS = {"fit.json": "a scan", TABLE: "a run or brafit-collect", "sweep.csv": "a sweep", SIZES: "brafit-sizes"}
"""Of a file that tells whose folder it lies in: whose."""


def relevant(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that a scan's results depend on, and the version of brafit."""
    chosen = {key: value for key, value in settings.items() if key not in IRRELEVANT}
    return {**chosen, "brafit": __version__}


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """A line for each setting that is not the same: `cup.panels: 2, now 3`."""
    lines = []
    for key in dict.fromkeys((*old, *new)):
        one, other, name = old.get(key), new.get(key), f"{prefix}{key}"
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            lines += differences(one, other, f"{name}.")
        elif one != other:
            lines.append(f"{name}: {_shown(one)}, now {_shown(other)}")
    return lines


def _shown(value: Any) -> str:
    return json.dumps(value, default=str)


def key_of(ref: ScanRef, side: str | None, settings: Mapping[str, Any]) -> str:
    """What tells one scan's input from any other: cloud, landmark file, side, the settings that matter, and the modules
    from outside of brafit that these name.

    A file that cannot be read has an empty place in it; whoever loads it says what is wrong.
    """
    from brafit.landmarks.file import landmarks_path
    from brafit.settings.entries import modules

    digest = hashlib.sha256(json.dumps([relevant(settings), side], sort_keys=True, default=str).encode())
    for file in (ref.path, ref.landmarks or landmarks_path(ref.path), *modules(settings)):
        digest.update(_digest(file))
    return digest.hexdigest()


def _digest(file: Path) -> bytes:
    if not file.is_file():  # a pipe would be waited for
        return b""
    try:
        with file.open("rb") as content:
            return hashlib.file_digest(content, "sha256").digest()
    except OSError:
        return b""


def nest_file(out: Path, name: str) -> Path:
    """Where a scan's pattern waits for the nest of the whole run."""
    return out / ".nest" / f"{name}.pickle"


def restored(out: Path, name: str, position: int, key: str, nest: bool) -> Done | None:
    """A scan that is finished: ok, from the same files and settings, its files all there."""
    content = read_fit(out / name)
    if content is None or content.get("key") != key or content.get("status") != "ok":
        return None
    if not all((out / name / file).is_file() for file in content.get("files", ())):
        return None
    if nest and not nest_file(out, name).is_file():
        return None
    return done_of(content, position)


def done_of(content: Mapping[str, Any], position: int) -> Done:
    """What a fit.json says of its scan."""
    row = {key: content.get(key) for key in SUMMARY_KEYS}
    warnings = (*content.get("warnings", ()), *content.get("pattern", {}).get("warnings", ()))
    cause = common_cause(row["reason"] or "") if row["status"] != "ok" else ""
    return Done(position, str(row["scan"]), row, warnings, tuple(content.get("notes", ())), cause, kept=True)


def read_fit(folder: Path) -> dict[str, Any] | None:
    """A scan's fit.json, None where there is none that can be read."""
    try:
        content = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and "scan" in content else None


def left_behind(overview: Overview, heard: Collection[str], since: float | None) -> Iterator[Done]:
    """What the folders of a run that was broken off hold of its scans besides those that it has heard of: of earlier
    runs, and what a worker wrote last.

    Args:
        overview: of the run.
        heard: names of the scans whose end is known.
        since: only results that were written after this time (seconds, as `time.time` has them); None: all.
    """
    for name, position in zip(overview.names, overview.positions, strict=True):
        file = overview.out / name / "fit.json"
        if name in heard or not file.is_file() or (since is not None and file.stat().st_mtime < since):
            continue
        content = read_fit(file.parent)
        if content is not None:
            yield done_of(content, position)


@dataclass(frozen=True)
class Earlier:
    """Scans of earlier runs whose results lie in a run's folder, and which the run does not name.

    Attributes:
        taken: of the same settings; the run's table has their rows too.
        left: names of the others; of a run that starts over, of all.
    """

    taken: tuple[Done, ...] = ()
    left: tuple[str, ...] = ()


def earlier(overview: Overview, settings: Mapping[str, Any]) -> Earlier:
    """What the folder of a run holds of scans that the run does not name. A shard has none: the others are its peers'.

    Args:
        overview: of the run.
        settings: of the run.
    """
    if overview.shard is not None:
        return Earlier()
    own, taken, left = frozenset(overview.names), [], []
    for folder, content in scan_folders(overview.out, own):
        if overview.resumed and _made_with(content) == _comparable(relevant(settings)):
            taken.append(done_of(content, content.get("position") or 0))
        else:
            left.append(folder.name)
    return Earlier(tuple(taken), tuple(left))


def _made_with(content: Mapping[str, Any]) -> str | None:
    """The settings and the version that a fit.json was made with, to compare."""
    settings, versions = content.get("settings"), content.get("versions")
    if not isinstance(settings, Mapping) or not isinstance(versions, Mapping):
        return None
    return _comparable({**relevant(settings), "brafit": versions.get("brafit")})


def _comparable(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True, default=str)


def scan_folders(out: Path, without: Collection[str] = ()) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Folders with results in a run's folder, and what their fit.json says; without those of some names."""
    for folder in sorted(path for path in out.iterdir() if path.name not in without and path.is_dir()):
        content = read_fit(folder)
        if content is not None:
            yield folder, content


def refuse_taken(out: Path, own: str = "") -> None:
    """Let results be written only where no others lie that have files of the same names.

    Args:
        out: where they are wanted.
        own: the file of earlier results of the same kind, which may be written anew.

    Raises:
        ConfigError: a run, a sweep, a scan or another command has its results there.
    """
    if not out.is_dir():
        return
    owner = next((words for file, words in _OWNERS.items() if file != own and (out / file).exists()), "")
    if not owner and any(scan_folders(out)):
        owner = "a run"
    if owner:
        raise ConfigError(f"--out {out}: {owner} has its own files there, which would be lost; name another folder")


def without_scans(folder: Path) -> InputError:
    """What to say of a folder that was named as that of a run, and has no scan's results in it."""
    if read_fit(folder) is not None:
        return InputError(folder, "it is the folder of one scan", "Name the folder of the run, in which it lies")
    if runs := sorted({file.parent.parent for file in folder.glob("*/*/fit.json")}):
        more = f" and {len(runs) - SHOWN} more" * (len(runs) > SHOWN)
        named = ", ".join(str(run) for run in runs[:SHOWN]) + more
        return InputError(folder, "it is no run's own folder: runs lie in folders of it", f"Name those: {named}")
    if (folder / TABLE).exists():
        cause = "it has a table, but no fit.json of any scan, of which tables are made"
        return InputError(folder, cause, "Name the folders of the runs whose scans the table is of")
    return InputError(folder, "it holds no fit.json of any scan", "Name the folder of a run: the one of summary.csv")
