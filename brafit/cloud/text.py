"""Clouds written as plain text: .xyz, .xyzn, .pts, .txt, .csv, .asc.

Read here and not by Open3D, whose readers of these formats drop a last line without a line end, invent points where
lines are missing, and can crash on a damaged file.

The first rows tell how a file is written. NumPy then reads it quickly; a file in which NumPy does not understand
something is read again, line by line, so that rare spellings are understood and a fault can be named.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from brafit.cloud.arrays import MANY
from brafit.cloud.dialect import Numbers, cells_of
from brafit.cloud.layout import Layout, count_of, is_empty, layout_of, opened, said
from brafit.cloud.refusal import RefusedError

TEXT_FORMATS = frozenset({".xyz", ".xyzn", ".pts", ".txt", ".csv", ".asc"})


def read_text(path: Path) -> dict[str, np.ndarray]:
    """Columns `positions` and, where the file has them, `normals`, `inside` and `unit`; numbers in float64.

    Cells are parted by blanks, tabs, semicolons, bars or commas, and may be quoted; numbers have decimal points or
    commas. Lines that start with #, // or % are skipped, empty ones too. A line of names (see `columns_of`), which may
    be such a comment, tells where things are, and maybe their unit. Without it the first three columns of numbers are
    the position, of .xyzn the next three the normal; a first column that numbers the points is left out, as is a first
    line that numbers the columns from 0. A line of a single number is the number of points that follow; several such
    blocks are one cloud.

    Raises:
        ValueError: with a short reason, if it is no such table; a `RefusedError` if it could be read in two ways.
        OSError: the file cannot be read.
    """
    try:
        layout = layout_of(path)
        if layout is None:
            return {"positions": np.empty((0, 3))}
        try:
            found = _read_quickly(path, layout)
        except ValueError:
            found = _read_carefully(path, layout)
    except MemoryError:
        raise ValueError("it needs more memory than there is") from None
    positions = found["positions"]
    if layout.width > MANY and len(positions) in (3, 4):
        cause = f"its table is {len(positions)} x {layout.width}: a point a column, not a point a row"
        raise RefusedError(cause, "Save it transposed, a line a point")
    unit = layout.columns.unit
    return found if unit is None else {**found, "unit": np.array([unit])}


def _read_quickly(path: Path, layout: Layout) -> dict[str, np.ndarray]:
    """The columns; ValueError if anything is not written as the first rows are."""
    tables: list[np.ndarray] = []
    with opened(path, layout.encoding) as file:
        lines = said(file)
        head = [count_of(next(lines)) for _ in range(layout.skipped + layout.counted)]
        if layout.commas:
            lines = _with_points(lines)
        if not layout.counted:
            tables.append(_table(lines, layout))
        count = next((number for number in head if number is not None), None)
        while count is not None:
            if count:
                tables.append(_table(itertools.islice(lines, count), layout))
                if len(tables[-1]) != count:
                    raise ValueError("fewer points than promised")
            line = next(lines, None)
            count = None if line is None else count_of(line)
            if line is not None and count is None:
                raise ValueError("more points than promised")
    places = layout.columns.places
    if layout.words:
        return {
            name: np.concatenate([np.stack([table[f"c{k}"] for k in own], axis=1) for table in tables])
            for name, own in places.items()
        }
    return {name: np.concatenate([table[:, own] for table in tables]) for name, own in places.items()}


def _table(lines: Iterable[str], layout: Layout) -> np.ndarray:
    """Rows as an array; columns of words, of which only a letter is kept, make it a structured one."""
    options: dict[str, Any] = {"delimiter": layout.mark, "comments": None, "quotechar": '"' if layout.quoted else None}
    if layout.words:
        kinds = [(f"c{k}", "U1" if k in layout.words else "f8") for k in range(layout.width)]
        return np.loadtxt(lines, dtype=kinds, ndmin=1, **options)
    table = np.loadtxt(lines, ndmin=2, **options)
    if table.shape[1] != layout.width:
        raise ValueError("another width than that of most rows")
    return table


def _with_points(lines: Iterator[str]) -> Iterator[str]:
    """Lines with decimal points in place of decimal commas; ValueError if some have points already."""
    for line in lines:
        if "." in line:
            raise ValueError("points and commas")
        yield line.replace(",", ".")


@dataclass
class _Block:
    """Points that a line promises, the line's number, and how many have come."""

    line: int
    promised: int
    found: int = 0

    def check(self, first: bool) -> None:
        if self.found != self.promised:
            where = "its first line" if first else f"its line {self.line}"
            raise ValueError(f"{where} promises {self.promised} points, {self.found} follow")


def _read_carefully(path: Path, layout: Layout) -> dict[str, np.ndarray]:
    """The columns, cell by cell; a ValueError names the line and what is wrong with it."""
    numbers, values, blocks = Numbers(), array("d"), list[_Block]()
    wanted = list(itertools.chain(*layout.columns.places.values()))
    with opened(path, layout.encoding) as file:
        for number, line in _rows(file, layout, blocks):
            cells = cells_of(line, layout.mark)
            if len(cells) == layout.width + 1 and not cells[-1]:
                cells.pop()
            if len(cells) != layout.width:
                raise ValueError(f"line {number} has {len(cells)} columns, most lines have {layout.width}")
            try:
                values.extend([numbers(cells[k]) for k in wanted])
            except RefusedError as error:
                raise RefusedError(f"line {number}: {error.cause}", error.remedy) from None
            except ValueError as error:
                remedy = "Correct that line or take it out, if it is no point; or export the cloud again"
                raise RefusedError(f"line {number}: {error}", remedy) from None
    for k, block in enumerate(blocks):
        block.check(k == 0)
    table = np.array(values, dtype=np.float64).reshape(-1, len(wanted))
    ends = np.cumsum([len(own) for own in layout.columns.places.values()])[:-1]
    return dict(zip(layout.columns.places, np.split(table, ends, axis=1), strict=True))


def _rows(file: Iterable[str], layout: Layout, blocks: list[_Block]) -> Iterator[tuple[int, str]]:
    """The lines that are rows, with their numbers; the counts between them go to `blocks`."""
    skipped = layout.skipped
    for number, line in enumerate(file, start=1):
        if is_empty(line) or next(said([line]), None) is None:
            continue
        count = count_of(line) if layout.counted else None
        if count is not None:
            blocks.append(_Block(number, count))
        elif skipped:
            skipped -= 1
        else:
            if blocks:
                blocks[-1].found += 1
            yield number, line
