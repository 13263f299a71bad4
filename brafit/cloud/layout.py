"""How a text file of a cloud is written: encoding, counts, names, what parts its cells, which columns it has."""

from __future__ import annotations

import codecs
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from brafit.cloud.columns import Columns, columns_of, units_row
from brafit.cloud.dialect import cells_of, check_commas, check_spelling, is_number, is_numeric, names_of, separator
from brafit.cloud.refusal import RefusedError

SAMPLE = 200
"""Rows that tell how a file is written."""
_COMMENTS = ("#", "//", "%")
_MARKS_OF_ORDER = {
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_EMPTY = '\r\n\t ;,|"\x1a\0'
"""What a line may hold that is an empty row, or the end of a file of DOS."""


@dataclass(frozen=True)
class Layout:
    """How a file is written.

    Attributes:
        encoding: of the text.
        skipped: lines that are neither comments nor counts nor rows.
        counted: the rows stand in blocks, each after a line with the number of its points.
        mark: what parts the cells; None: blanks.
        commas: the numbers have decimal commas.
        quoted: cells stand in quotation marks.
        width: cells of a row.
        words: columns that are not read, for they hold other things than numbers.
        columns: where things are.
    """

    encoding: str
    skipped: int
    counted: bool
    mark: str | None
    commas: bool
    quoted: bool
    width: int
    words: frozenset[int]
    columns: Columns


@dataclass(frozen=True)
class _Head:
    """The beginning of a file: comments before the first row, names (or None), the first rows; see `Layout`."""

    skipped: int
    counted: bool
    comments: list[str]
    names: list[str] | None
    lines: list[str]


def layout_of(path: Path) -> Layout | None:
    """How a file is written, as its first rows tell; None if it has no row.

    Raises:
        ValueError: with a short reason, if it is no table; a `RefusedError` if it could be read in two ways.
        OSError: the file cannot be read.
    """
    encoding = _encoding(path)
    head = _head(path, encoding)
    if not head.lines:
        return None
    mark = separator(head.lines)
    rows = [cells_of(line, mark) for line in head.lines]
    if mark == ",":
        check_commas(rows, len(head.names or ()))
    if ended := all(row[-1] == "" for row in rows):  # a mark at the end of every row
        rows = [row[:-1] for row in rows]
    widths = [len(row) for row in rows]
    width = max(set(widths), key=widths.count)
    rows = [row for row in rows if len(row) == width]
    empty = frozenset(k for k in range(width) if not any(is_number(row[k]) for row in rows))
    columns = _named(head, rows, width, ended)
    if columns is None:
        columns = _in_order([k for k in range(width) if k not in empty], rows, path.suffix.lower() == ".xyzn")
        words = empty
    else:
        mixed = {k for k in range(width) if not all(is_numeric(row[k]) for row in rows)}
        words = (empty | mixed) - set(itertools.chain(*columns.places.values()))
    commas = mark != "," and any("," in cell for row in rows for k, cell in enumerate(row) if k not in words)
    quoted = any('"' in line for line in head.lines)
    return Layout(encoding, head.skipped, head.counted, mark, commas, quoted, width, words, columns)


def opened(path: Path, encoding: str) -> TextIO:
    """A file of text; what is no text in it becomes a sign that is no number."""
    return path.open(encoding=encoding, errors="replace")


def said(lines: Iterable[str]) -> Iterator[str]:
    """Lines that are neither empty nor comments."""
    return (line for line in lines if line.strip() and not line.lstrip().startswith(_COMMENTS))


def is_empty(line: str) -> bool:
    """Whether a line is a row without any cell filled."""
    return not line.strip(_EMPTY)


def count_of(line: str) -> int | None:
    """The number of points that a line promises, if it holds one whole number and nothing else."""
    word = line.strip()
    return int(word) if word.isascii() and word.isdigit() and len(word) < 13 else None


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(400)
    marked = next((name for mark, name in _MARKS_OF_ORDER.items() if head.startswith(mark)), None)
    if marked is not None:
        return marked
    # In UTF-16 every digit has a zero byte before or after it.
    half, even, odd = len(head) // 2, head[::2].count(0), head[1::2].count(0)
    if max(even, odd) > 0.8 * half and min(even, odd) < 0.2 * half:
        return "utf-16-be" if even > odd else "utf-16-le"
    return "utf-8-sig"


def _head(path: Path, encoding: str) -> _Head:
    comments: list[str] = []
    first: list[str] = []
    with opened(path, encoding) as file:
        for line in file:
            if line.lstrip().startswith(_COMMENTS):
                comments += [line] * (not first)
            elif line.strip():
                first.append(line)
            if len(first) > SAMPLE:
                break
    if first and "\0" in first[0]:
        raise ValueError("it is no text")
    skipped = int(bool(first and re.fullmatch(r'"?sep=.\s*"?\s*', first[0])))  # as Excel writes
    names, counted = None, False
    for line in first[skipped : skipped + 2]:
        if count_of(line) is not None:
            counted = True
        elif (names := names or _names(line)) is None:
            break
    if names is not None:
        skipped += 1
        below = first[skipped + counted] if len(first) > skipped + counted else ""
        if (of := units_row(names_of(below))) is not None and len(of) == len(names):
            names, skipped = [f"{name} {unit}" for name, unit in zip(names, of, strict=True)], skipped + 1
    lines = [line for line in first[skipped + counted :] if count_of(line) is None and not is_empty(line)]
    if names is None and not counted and _numbers_columns(lines):
        skipped, lines = skipped + 1, lines[1:]
    return _Head(skipped, counted, comments, names, lines)


def _numbers_columns(lines: Sequence[str]) -> bool:
    """Whether the first line only numbers the columns from 0, as pandas does: `0,1,2`, with nothing above an index."""
    mark = separator(lines)
    if mark is None or len(lines) < 2:
        return False
    first, rows = cells_of(lines[0], mark), [cells_of(line, mark) for line in lines[1:]]
    numbered = [cell for k, cell in enumerate(first) if cell or k]
    whole = all(cell.lstrip("+-").isdigit() for row in rows for cell in row if is_number(cell))
    return len(numbered) >= 3 and numbered == [str(k) for k in range(len(numbered))] and not whole


def _names(line: str) -> list[str] | None:
    """The columns' names, if the line holds names and not numbers.

    Raises:
        RefusedError: it holds neither.
    """
    names = names_of(line)
    if columns_of(names) is not None:
        return names
    if is_empty(line) or any(is_number(cell) for cell in (*names, *line.split())) or all(map(is_numeric, names)):
        return None
    shown = "".join(c if c.isprintable() else "?" for c in line.strip())[:40]
    remedy = "Begin the file with a line of the columns' names, x,y,z, or with the numbers; put # before other lines"
    raise RefusedError(f"its first line is neither numbers nor the names of columns x, y, z: {shown!r}", remedy)


def _named(head: _Head, rows: Sequence[Sequence[str]], width: int, ended: bool) -> Columns | None:
    """The columns as a line of names tells, or else the last comment that names as many as there are; `ended`: a mark
    that parts nothing ends the rows.

    Raises:
        ValueError: the names are not as many as the columns.
    """

    def fitting(names: list[str]) -> list[str]:
        return names[:-1] if not names[-1] and (ended or len(names) == width + 1) else names

    if head.names is None:
        told = (
            fitting(names_of(line.strip().lstrip("#/"))) for line in reversed(head.comments) if line.strip(" #/\r\n")
        )
        return next((found for names in told if len(names) == width and (found := columns_of(names))), None)
    names = fitting(head.names)
    if len(names) == width - 1 and (_counts(rows, 0) or not any(is_number(row[0]) for row in rows)):
        names = ["", *names]  # R gives the points' numbers no name
    if len(names) != width:
        raise ValueError(f"its first line names {len(names)} columns, {width} follow")
    return columns_of(names)


def _in_order(numeric: list[int], rows: Sequence[Sequence[str]], normals: bool) -> Columns:
    """The columns of a table without names, of which these hold numbers.

    Raises:
        ValueError: they are too few; a `RefusedError` if one beside them is spelt so that it is not read.
    """
    needed = 6 if normals else 3
    if len(numeric) > needed and _counts(rows, numeric[0]):
        numeric = numeric[1:]
    # Such a column may be meant for one of those that are taken.
    last = numeric[needed - 1] if len(numeric) >= needed else len(rows[0])
    for k in range(last):
        if k not in numeric and not is_number(rows[0][k]):
            check_spelling(rows[0][k])
    if len(numeric) < needed:
        others = [cell for cell in rows[0] if cell and not is_number(cell)]
        shown = f": {others[0][:40]!r} is no number" if others else ""
        remedy = "Export it as a table of plain numbers, a line a point: x y z"
        raise RefusedError(f"{needed} columns of numbers are needed, it has {len(numeric)}{shown}", remedy)
    places = {"positions": tuple(numeric[:3])}
    return Columns({**places, "normals": tuple(numeric[3:6])} if normals else places)


def _counts(rows: Sequence[Sequence[str]], column: int) -> bool:
    """Whether a column numbers the points: whole numbers that rise with every row, which no coordinate does."""
    cells = [row[column] for row in rows]
    if len(cells) < 3 or not all(map(is_number, cells)) or any("," in cell for cell in cells):
        return False
    values = [float(cell) for cell in cells]
    return all(value.is_integer() for value in values) and all(a < b for a, b in itertools.pairwise(values))
