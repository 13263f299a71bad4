"""How a table is written: what parts its cells, and how its numbers are spelt."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

from brafit.cloud.refusal import RefusedError

MARKS = (";", "\t", "|", ",")
"""What may part the cells of a line; blanks where none of these does."""
POINTS_REMEDY = "Export it with decimal points, or with semicolons or tabs between the numbers"

_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eEdD][+-]?\d+)?", re.ASCII)
# "1.#QNAN", "-1.#IND" and "-nan(ind)" are what Windows makes of NaN.
_MISSING = re.compile(
    r"[+-]?(?:nan(?:\(\w*\))?|inf|infinity|1[.,]#\w+|n/?a|null|none|missing|-)?", re.ASCII | re.IGNORECASE
)
_WHOLE = re.compile(r"[+-]?\d+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_ZERO_FIRST = re.compile(r"[+-]?0\d+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}(?:,\d{3})+(?:\.\d*)?|[+-]?\d{1,3}(?:\.\d{3})+(?:,\d*)?"
    r"|[+-]?\d{1,3}(?:['\u2019_\u00a0\u2009\u202f ]\d{3})+(?:[.,]\d*)?",
    re.ASCII,
)
_WITH_UNIT = re.compile(
    r"(?:[a-z]\s*[=:]\s*)?[+-]?\d+(?:[.,]\d*)?\s*(?:mm|cm|dm|m|in|inch|ft|\")", re.ASCII | re.IGNORECASE
)
_RAGGED = 0.05
"""Share of the lines that differ in width from which on that is how the file is written, and no damage."""


def is_number(cell: str) -> bool:
    """Whether a cell holds a number."""
    return _NUMBER.fullmatch(cell) is not None


def is_numeric(cell: str) -> bool:
    """Whether a cell of a column of numbers may be so: a number, empty, or one of the words for NaN."""
    return is_number(cell) or _MISSING.fullmatch(cell) is not None


def check_spelling(cell: str) -> None:
    """Refuse a cell that is a number to whoever reads it, but is spelt in a way that is not read.

    Raises:
        RefusedError: it has marks of thousands, a unit behind it, or digits of another script or width.
    """
    if any(sign.isdecimal() and not sign.isascii() for sign in cell):
        raise RefusedError(f"{cell[:40]!r} has other digits than 0 to 9", "Export it with plain (half-width) digits")
    if _THOUSANDS.fullmatch(cell) or _NUMBER.fullmatch(cell.replace(".", "").replace(",", "")) is not None:
        raise RefusedError(f"{cell[:40]!r} has marks of thousands", "Export it without them, with decimal points")
    if _WITH_UNIT.fullmatch(cell):
        remedy = "Export numbers only, and write the unit into the columns' names: x [mm], y [mm], z [mm]"
        raise RefusedError(f"{cell[:40]!r} has its unit behind it", remedy)


class Numbers:
    """Turns the cells of one table into numbers: with decimal points or with decimal commas, not with both."""

    def __init__(self) -> None:
        self._mark = ""

    def __call__(self, cell: str) -> float:
        """A cell's number; NaN where it is empty or says so.

        Raises:
            ValueError: it is neither.
            RefusedError: points and commas in one table.
        """
        cell = cell.replace("\u2212", "-")
        if _NUMBER.fullmatch(cell) is None:
            if _MISSING.fullmatch(cell) is not None:
                return float("nan")
            check_spelling(cell)
            raise ValueError(f"{cell[:40]!r} is no number")
        mark = "," if "," in cell else "." if "." in cell else ""
        if mark and self._mark and mark != self._mark:
            raise RefusedError(
                f"its numbers have decimal points and decimal commas, {cell[:40]!r} is not like those before it",
                POINTS_REMEDY,
            )
        self._mark = self._mark or mark
        return float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))


def cells_of(line: str, mark: str | None) -> list[str]:
    """The cells of a line, without blanks and quotation marks around them; mark None: blanks part them."""
    if mark is None:
        return line.replace('"', " ").split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line.strip("\r\n")], delimiter=mark, skipinitialspace=True))]
    return [cell.strip() for cell in line.split(mark)]


def names_of(line: str) -> list[str]:
    """The cells of a line of names, which may be parted otherwise than the numbers."""
    plain = re.sub(r"\s+(?=[\[(])", "", line.strip())  # "X [mm] Y [mm]" are two names
    bare = re.sub(r'"[^"]*"', "", plain)
    mark = next((mark for mark in MARKS if mark in bare), None)
    if mark is None and '"' in plain:
        return [a or b for a, b in re.findall(r'"([^"]*)"|(\S+)', plain)]
    return cells_of(plain, mark)


def separator(rows: Sequence[str]) -> str | None:
    """What parts the numbers in the first rows of a table; None: blanks."""

    def mostly(true: list[bool]) -> bool:  # a damaged line must not decide
        return 2 * sum(true) > len(true)

    for mark in (";", "\t", "|"):
        if mostly([mark in row.strip(" \r\n") for row in rows]):
            beside = [cell for row in rows for cell in row.split(mark)]
            several = [len(parts := cell.split()) > 1 and all(map(is_numeric, parts)) for cell in beside]
            return mark if not mostly(several) else None
    if not mostly(["," in row for row in rows]):
        return None
    return None if mostly([_has_decimal_commas(cells_of(row, None)) for row in rows]) else ","


def _has_decimal_commas(cells: Sequence[str]) -> bool:
    """Whether commas in cells that blanks part stand inside of numbers only, as decimal marks."""
    commas = all(is_number(cell) and cell[-1] != "," for cell in cells if "," in cell)
    return commas and sum(map(is_number, cells)) >= 3


def check_commas(rows: Sequence[Sequence[str]], named: int) -> None:
    """Refuse rows parted by commas whose numbers have decimal commas as well: whole numbers only, which are none.

    Args:
        rows: cells of the first rows.
        named: columns that a header names; 0 without one.

    Raises:
        RefusedError: they are so.
    """
    if not all(_WHOLE.fullmatch(cell) for row in rows for cell in row if is_number(cell)):
        return
    widths = [len(row) for row in rows]
    width = max(set(widths), key=widths.count)
    pairs = [row for row in rows if len(row) == width >= 6 and width % 2 == 0]
    ragged = sum(w != width for w in widths) > _RAGGED * len(rows) and max(widths) > 3
    zeros = any(_ZERO_FIRST.fullmatch(cell) for row in rows for cell in row[1:])
    tenths = bool(pairs) and all(len(cell) == 1 for row in pairs for cell in row[1::2])
    tenths = tenths and any(len(cell) > 1 for row in pairs for cell in row[::2])
    if (named and width == 2 * named) or zeros or ragged or tenths:
        cause = f"the comma both parts its numbers and marks their decimals: {width} columns of whole numbers"
        raise RefusedError(cause, POINTS_REMEDY)
