"""Clouds written as plain text: .xyz, .xyzn, .pts, .txt, .csv.

Read here and not by Open3D, whose readers of these formats drop a last line without a line end, invent points where
lines are missing, and can crash on a damaged file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

TEXT_FORMATS = frozenset({".xyz", ".xyzn", ".pts", ".txt", ".csv", ".asc"})
_COMMENTS = ("#", "//")


def read_text(path: Path) -> dict[str, np.ndarray]:
    """Columns `positions` and, where the file has them, `normals` and `inside`, in float64.

    Numbers are parted by blanks, commas or semicolons (then with decimal points or commas). Lines that start with # or
    // are skipped. A first line of names (x, y, z, nx, ny, nz, inside) tells where things are; without one the first
    three columns are the position, of .xyzn the next three the normal. A first line of a single number is the number of
    points (.pts always begins so).

    Raises:
        ValueError: with a short reason, if it is no such table.
        OSError: the file cannot be read.
    """
    kind = path.suffix.lower()
    needed = 6 if kind == ".xyzn" else 3
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = (line for line in file if line.strip() and not line.lstrip().startswith(_COMMENTS))
        first = next(lines, "")
        promised = _promised(first, kind == ".pts")
        if promised is not None:
            first = next(lines, "")
        names = _names(first)
        if names is not None:
            first = next(lines, "")
        rows = _table(first, lines) if first else np.empty((0, needed))
    if promised is not None and promised != len(rows):
        raise ValueError(f"its first line promises {promised} points, {len(rows)} follow")
    if names is not None:
        return _named(rows, names)
    if rows.shape[1] < needed:
        raise ValueError(f"{rows.shape[1]} columns, {needed} are needed")
    normals = {"normals": rows[:, 3:6]} if kind == ".xyzn" else {}
    return {"positions": rows[:, :3], **normals}


def _promised(line: str, must: bool) -> int | None:
    words = line.split()
    if len(words) == 1 and words[0].isascii() and words[0].isdigit():
        return int(words[0])
    if must:
        raise ValueError("its first line is not the number of points")
    return None


def _separator(line: str) -> str | None:
    """What parts the numbers of a line; None: blanks."""
    return next((mark for mark in (";", ",") if mark in line), None)


def _names(line: str) -> list[str] | None:
    """The columns' names, lower case, if the line holds names and not numbers."""
    words = [word.strip().strip('"').lower() for word in line.split(_separator(line))]
    return words if {"x", "y", "z"} <= set(words) else None


def _named(rows: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
    if rows.size and rows.shape[1] != len(names):
        raise ValueError(f"its first line names {len(names)} columns, {rows.shape[1]} follow")
    found = {}
    for column, parts in {"positions": ("x", "y", "z"), "normals": ("nx", "ny", "nz"), "inside": ("inside",)}.items():
        if set(parts) <= set(names):
            found[column] = rows[:, [names.index(part) for part in parts]] if rows.size else np.empty((0, len(parts)))
    return found


def _table(first: str, rest: Iterable[str]) -> np.ndarray:
    mark = _separator(first)
    lines: Iterator[str] = itertools.chain([first], rest)
    if mark == ";":
        lines = (line.replace(",", ".") for line in lines)
    try:
        return np.loadtxt(lines, ndmin=2, delimiter=mark, comments=None)
    except ValueError as error:
        # NumPy's first sentence says what and where; the rest is advice to programmers.
        raise ValueError(str(error).split(";")[0].split("\n")[0].rstrip(".")) from None
    except MemoryError:
        raise ValueError("it needs more memory than there is") from None
