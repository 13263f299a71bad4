"""What a run works on: a list of scans, from files and folders or from a table, none of them opened yet."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from brafit.errors import ConfigError, InputError
from brafit.naming import on_disk

SIDES = ("left", "right")
COLUMNS = ("cloud", "landmarks", "side", "name")
"""Columns of a manifest that say which scan it is; any other is a setting of that scan, such as `cup.panels`."""


@dataclass(frozen=True)
class ScanRef:
    """One file of the dataset, and which breasts of it are fitted.

    Attributes:
        path: the cloud.
        names: what the results of each breast are called.
        sides: for each of them `left`, `right`, or None for what the landmark file marks.
        positions: their places in the whole dataset, which a shard does not change.
        landmarks: the landmark file; None: the one beside the cloud.
        overrides: settings of this scan alone, `key=value`.
    """

    path: Path
    names: tuple[str, ...]
    sides: tuple[str | None, ...]
    positions: tuple[int, ...]
    landmarks: Path | None = None
    overrides: tuple[str, ...] = ()


def dataset(
    scans: Sequence[str | Path],
    side: str | None = None,
    manifest: str | None = None,
    shard: str | None = None,
    propose: bool = False,
    suffixes: frozenset[str] = frozenset(),
) -> tuple[list[ScanRef], list[str]]:
    """The scans of a run in their order, and notes on what was passed over.

    Args:
        scans: files, folders, patterns or `samples`, see `brafit.scan.find_scans`; ignored with a manifest.
        side: `left`, `right`, `both` or None, see `brafit.scan.load_scan`.
        manifest: a table of scans, CSV or Parquet, see `read_manifest`.
        shard: `K/N`: every N-th file from the K-th on. The names are those of the whole dataset.
        propose: landmarks are proposed where there are none, so a folder means all clouds in it.
        suffixes: of clouds that readers from outside of brafit read.

    Raises:
        InputError: no scan is found, none of the files named exists, or the table cannot be used.
        ConfigError: `shard` is not of that form.
    """
    # imports much, and not everyone gets here
    from brafit.scan.discovery import find_scans, numbered, passed_over, scan_names

    if manifest is not None:
        rows, notes = read_manifest(manifest)
    else:
        rows = [_Row(path) for path in find_scans(list(scans), propose, suffixes)]
        notes = passed_over(list(scans), propose, suffixes)
        _check_one_exists([row.path for row in rows])
    given = [row.name for row in rows if row.name]
    if doubled := {name for name in given if given.count(name) > 1} if len(set(given)) < len(given) else set():
        raise InputError(manifest or "scans", f"the name {min(doubled)!r} stands twice", "Give every row its own name")
    names = scan_names([row.path for row in rows], [row.name for row in rows])
    sides = [SIDES if (row.side or side) == "both" else (row.side or side,) for row in rows]
    own = [
        [f"{name}_{one}" if len(both) > 1 else name for one in both] for name, both in zip(names, sides, strict=True)
    ]
    unique = iter(numbered([name for group in own for name in group]))  # `a` of both sides, and `a_left`
    refs: list[ScanRef] = []
    position = itertools.count()
    for row, both in zip(rows, sides, strict=True):
        called, positions = tuple(next(unique) for _ in both), tuple(next(position) for _ in both)
        refs.append(ScanRef(row.path, called, both, positions, row.landmarks, row.overrides))
    return (refs if shard is None else _part(refs, shard)), notes


def _check_one_exists(paths: Sequence[Path]) -> None:
    """Refuse a run of files none of which is there; one among others that are is the failure of one scan."""
    if not any(path.exists() for path in paths):
        first, *others = paths
        also = f", and none of the {len(paths)} files named exists" if others else ""
        raise InputError(first, f"there is no such file{also}", "Check the path")


@dataclass(frozen=True)
class _Row:
    path: Path
    name: str = ""
    landmarks: Path | None = None
    side: str | None = None
    overrides: tuple[str, ...] = ()


def shard_of(text: str) -> tuple[int, int]:
    """K and N of `K/N`, 1 <= K <= N.

    Raises:
        ConfigError: it is something else.
    """
    match = re.fullmatch(r"(\d+)/(\d+)", text.strip())
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ConfigError(f"dataset.shard={text}: must be K/N with K from 1 to N, such as 3/16")
    return int(match[1]), int(match[2])


def _part(refs: list[ScanRef], shard: str) -> list[ScanRef]:
    number, count = shard_of(shard)
    return refs[number - 1 :: count]


def read_manifest(file: str | Path) -> tuple[list[_Row], list[str]]:
    """The rows of a table of scans, and notes on columns that are not understood.

    The column `cloud` names the file, relative to the table's folder; `landmarks`, `side` and `name` may follow. A
    column whose name has a dot (`cup.panels`) or is a group or a setting (`cup`, `restarts`) holds a setting for its
    scan; an empty cell means the run's own.

    Raises:
        InputError: no such file, no column `cloud`, an empty cell there, an unknown side.
    """
    file = Path(file).expanduser()
    if not file.is_file():
        raise InputError(file, "there is no such table", "Name a CSV or Parquet file with a column 'cloud'")
    lines = _parquet(file) if file.suffix.lower() == ".parquet" else _csv(file)
    rows: list[_Row] = []
    settings: list[str] = []
    notes: list[str] = []
    for number, line in enumerate(lines, start=1):
        if number == 1:
            if "cloud" not in line:
                cause = f"it has no column 'cloud', but {', '.join(map(repr, line)) or 'nothing'}"
                raise InputError(file, cause, "Name the column with the clouds' files 'cloud'")
            others = [key for key in line if key not in COLUMNS]
            settings = [key for key in others if _is_setting(key)]
            if passed := [key for key in others if key not in settings]:
                notes.append(f"{file}: columns that are no settings are passed over: {', '.join(passed)}")
        rows.append(_manifest_row(file, number, line, settings))
    if not rows:
        raise InputError(file, "the table has no row", "Write a line for each scan")
    return rows, notes


def _manifest_row(file: Path, number: int, line: dict[str, str], settings: Sequence[str]) -> _Row:
    if not line["cloud"]:
        raise InputError(file, f"row {number}: the cell 'cloud' is empty", "Name the scan's file")
    side = line.get("side") or None
    if side not in (None, *SIDES, "both"):
        raise InputError(file, f"row {number}: side {side!r}", "It must be left, right, both, or empty")
    return _Row(
        path=_beside(file, line["cloud"]),
        name=line.get("name", ""),
        landmarks=_beside(file, line["landmarks"]) if line.get("landmarks") else None,
        side=side,
        overrides=tuple(f"{key}={line[key]}" for key in settings if line.get(key)),
    )


def _beside(table: Path, entry: str) -> Path:
    path = Path(entry).expanduser()
    return on_disk(path if path.is_absolute() else table.parent / path)


def _is_setting(key: str) -> bool:
    from brafit.settings.schema import is_setting

    return is_setting(key)


def _csv(file: Path) -> Iterator[dict[str, str]]:
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            sample = text.read(4096)
            text.seek(0)
            head = sample.splitlines()[0] if sample.strip() else ""
            reader = csv.DictReader(text, delimiter=max(",;\t", key=head.count))
            for row in reader:
                yield {str(key).strip(): _cell(value) for key, value in row.items() if key is not None}
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(file, f"is no CSV file ({error})", "Save it as CSV, UTF-8") from None


def _parquet(file: Path) -> Iterator[dict[str, str]]:
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.ParquetFile(file)
        for batch in table.iter_batches():
            for row in batch.to_pylist():
                yield {key: _cell(value) for key, value in row.items()}
    except pyarrow.ArrowException as error:
        raise InputError(file, f"is no Parquet file ({error})", "Write it again, or as CSV") from None


def _cell(value: Any) -> str:
    if value is None or isinstance(value, list):
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value).strip()
