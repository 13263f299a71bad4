"""Clouds written as plain text: .xyz, .xyzn and .pts.

Read here and not by Open3D, whose readers of these formats drop a last line without a line end, invent points where
lines are missing, and can crash on a damaged file.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

TEXT_FORMATS = frozenset({".xyz", ".xyzn", ".pts"})


def read_text(path: Path) -> dict[str, np.ndarray]:
    """Columns `positions` and, of .xyzn, `normals`, in float64; lines that start with # are skipped.

    Raises:
        ValueError: with a short reason, if it is no such table.
        OSError: the file cannot be read.
    """
    kind = path.suffix.lower()
    needed = 6 if kind == ".xyzn" else 3
    with path.open(encoding="utf-8", errors="replace") as file:
        promised = _promised(file.readline()) if kind == ".pts" else None
        first = next((line for line in file if line.strip() and not line.lstrip().startswith("#")), None)
        rows = np.empty((0, needed)) if first is None else _table(itertools.chain([first], file))
    if rows.shape[1] < needed:
        raise ValueError(f"{rows.shape[1]} columns, {needed} are needed")
    if promised is not None and promised != len(rows):
        raise ValueError(f"its first line promises {promised} points, {len(rows)} follow")
    normals = {"normals": rows[:, 3:6]} if kind == ".xyzn" else {}
    return {"positions": rows[:, :3], **normals}


def _promised(line: str) -> int:
    words = line.split()
    if len(words) != 1 or not words[0].isdigit():
        raise ValueError("its first line is not the number of points")
    return int(words[0])


def _table(lines: itertools.chain[str]) -> np.ndarray:
    try:
        return np.loadtxt(lines, ndmin=2)
    except ValueError as error:
        # NumPy's first sentence says what and where; the rest is advice to programmers.
        raise ValueError(str(error).split(";")[0].split("\n")[0].rstrip(".")) from None
