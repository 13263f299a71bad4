"""The numbers of a run: fit.json of one scan, summary.csv of all, and a short table for the terminal.

A row maps the keys below to values; missing, None and not finite all mean that there is no such number.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

from brafit.atomic import replacing, write_text
from brafit.naming import shown

SUMMARY_KEYS: tuple[str, ...] = (
    "scan", "status", "reason", "side", "cup", "panels", "terms", "solver", "points",
    "rms_mm", "mean_mm", "p95_mm", "max_mm", "upper_edge_mm", "neckline_smoothing_mm", "seam_to_apex_mm",
    "outline_sd_mm", "tightest_radius_mm", "wire_length_mm", "wire_smoothing_mm", "wire_drift_mm",
    "nearest_wire", "nearest_wire_length_diff_mm", "nearest_wire_span_diff_mm",
    "twist_deg_max", "regularity_min", "isometry_mm", "seam_mismatch_mm", "iterations", "seconds",
    "landmark_confidence", "warning_count",
)  # fmt: skip
"""Keys of fit.json and columns of summary.csv, in this order."""
WORDS = ("scan", "status", "reason", "side", "cup", "solver", "nearest_wire")
COUNTS = ("panels", "terms", "points", "iterations", "warning_count")
"""Which of them are texts, and which whole numbers."""

# Column of the terminal's table: key, heading, format. How far the cup is from points, neckline and bust point (its
# nearest seam), and the rest.
_SHORT = (
    ("scan", "scan", "s"), ("status", "status", "s"), ("panels", "panels", "d"), ("points", "points", "d"),
    ("rms_mm", "rms", ".2f"), ("p95_mm", "p95", ".2f"), ("max_mm", "max", ".2f"),
    ("upper_edge_mm", "upper edge", ".2f"), ("seam_to_apex_mm", "bust point", ".1f"),
    ("seam_mismatch_mm", "cup seam", ".3f"),
    ("nearest_wire", "nearest wire", "s"), ("warning_count", "warnings", "d"), ("seconds", "s a scan", ".1f"),
)  # fmt: skip


def write_fit_json(path: str | Path, row: Mapping[str, Any], extra: Mapping[str, Any] | None = None) -> None:
    """Write one scan's row, all keys present and in order, with full digits; `null` where there is no number.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        row: by the names of SUMMARY_KEYS.
        extra: further entries, nested as they like, after the row's.

    Raises:
        KeyError: a key of `row` is not a column, or `extra` repeats one.
    """
    extra = dict(extra or {})
    if repeated := set(extra) & set(SUMMARY_KEYS):
        raise KeyError(f"extra repeats {', '.join(sorted(repeated))}")
    content = {**_complete(row), **extra}
    write_text(path, json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_summary(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write all rows as CSV: UTF-8, six significant digits (no more than nine places), empty cells where there is no
    number, a reason in one line.

    Raises:
        KeyError: a key of a row is not a column.
    """
    write_text(path, "".join([_csv_line(SUMMARY_KEYS), *map(summary_line, rows)]))


def summary_line(row: Mapping[str, Any]) -> str:
    """A row as `write_summary` writes it, with its line end.

    Raises:
        KeyError: a key of the row is not a column.
    """
    return _csv_line([_cell(value) for value in _complete(row).values()])


def write_table(path: str | Path, keys: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of any keys as CSV, in the manner of `write_summary`."""
    lines = [_csv_line([_cell(row.get(key)) for key in keys]) for row in rows]
    write_text(path, "".join([_csv_line(keys), *lines]))


def write_parquet(path: str | Path, rows: Sequence[Mapping[str, Any]], keys: Sequence[str] = SUMMARY_KEYS) -> None:
    """Write all rows as Parquet, numbers with all their digits, null where there is none.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        rows: by the names of SUMMARY_KEYS, and of `extra`.
        keys: columns; those that `summary.csv` has not are texts.
    """
    import pyarrow  # takes a third of a second
    import pyarrow.parquet

    plain = [{key: _plain(row.get(key)) for key in keys} for row in rows]
    table = pyarrow.Table.from_pylist(plain, schema=pyarrow.schema([(key, _parquet_type(key)) for key in keys]))
    with replacing(path) as temporary, temporary.open("wb") as file:  # opened here: a path may be no UTF-8
        pyarrow.parquet.write_table(table, file)


def _parquet_type(key: str) -> Any:
    import pyarrow

    if key in COUNTS:
        return pyarrow.int64()
    return pyarrow.string() if key not in SUMMARY_KEYS or key in WORDS else pyarrow.float64()


def _csv_line(cells: Sequence[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def format_table(rows: Sequence[Mapping[str, Any]], reasons: bool = True) -> str:
    """The main columns, aligned, in mm and degrees; the reasons of failed scans stand below, if they are wanted."""
    plain = [_plain(_complete(row)) for row in rows]
    cells = [[heading for _, heading, _ in _SHORT]]
    cells += [["" if row[key] is None else format(row[key], style) for key, _, style in _SHORT] for row in plain]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    align = [str.ljust if style == "s" else str.rjust for _, _, style in _SHORT]
    lines = ["  ".join(map(lambda put, cell, w: put(cell, w), align, row, widths)).rstrip() for row in cells]
    failed = [row for row in plain if reasons and row["status"] == "failed" and row["reason"]]
    return "\n".join([*lines, *(f"{row['scan']}: {row['reason']}" for row in failed)])


def _complete(row: Mapping[str, Any]) -> dict[str, Any]:
    if unknown := set(row) - set(SUMMARY_KEYS):
        raise KeyError(f"not a column of the summary: {', '.join(sorted(unknown))}")
    complete = {key: row.get(key) for key in SUMMARY_KEYS}
    if complete["reason"] is not None:
        complete["reason"] = " ".join(str(complete["reason"]).split())
    return complete


def _plain(value: Any) -> Any:
    """Values as JSON has them: tensors and arrays as lists, enums as their names, not finite numbers as None."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else shown(str(value))


def _cell(value: Any) -> str:
    value = _plain(value)
    if value is None:
        return ""
    # beyond nine places numbers are what rounding made of them, which need not be the same twice
    return f"{round(value, 9):.6g}" if isinstance(value, float) else str(value)
