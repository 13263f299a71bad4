"""STL: triangles, binary or ASCII, each with its own three corners."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.cloud.polygons import Mesh
from brafit.cloud.words import Words, in_utf8, plain_lines

HEADER, RECORD = 84, 50
"""Bytes before the triangles of a binary STL, and of one triangle."""
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_TEXT = "facet normal ? ? ? outer loop vertex ? ? ? vertex ? ? ? vertex ? ? ? endloop endfacet"
"""The words of a triangle in an ASCII STL; ?: a number."""
_FACET = _TEXT.split()
_CORNERS = np.array([8, 9, 10, 12, 13, 14, 16, 17, 18])
_PARTS = re.compile(rb"\s(?=(?:facet|endsolid)(?:\s|\Z))")
"""Where lines begin in a text that has but one."""
TAIL = 20
"""Where bytes follow the triangles, the last TAIL of these, or a twentieth of all, must be joined to others."""


def read_stl(path: Path) -> Mesh:
    """Triangles of an STL.

    A file of exactly the size that its count asks for is binary, whatever its header says. Bytes after the triangles
    that are no triangles are passed over.

    Raises:
        ValueError: with a short reason, if the file is damaged or its count does not fit its triangles.
        OSError: the file cannot be read.
    """
    data = path.read_bytes()
    exact = len(data) >= HEADER and len(data) == HEADER + RECORD * _count(data)
    data = data if exact else in_utf8(data)
    text = b"\0" not in data[:512]
    corners = _ascii(data) if text and not exact else _binary(data)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def _count(data: bytes) -> int:
    return int.from_bytes(data[HEADER - 4 : HEADER], "little")


def _binary(data: bytes) -> Float[np.ndarray, "f 3 3"]:
    if len(data) < HEADER:
        raise ValueError(f"it has {len(data)} bytes, the header alone of a binary STL has {HEADER}")
    count, room = _count(data), (len(data) - HEADER) // RECORD
    if count > room:
        raise ValueError(f"its header counts {count} triangles, it has bytes for {room}")
    whole = np.frombuffer(data, dtype=_RECORD, count=room, offset=HEADER)["corners"]
    extra = len(data) - HEADER - RECORD * count
    if any(data[len(data) - extra :]):
        _check_end(whole, count, extra)
    with np.errstate(invalid="ignore"):  # what is no number is told where the faces are looked at
        return whole[:count].astype(np.float64)


def _check_end(whole: Float[np.ndarray, "r 3 3"], count: int, extra: int) -> None:
    """Refuse triangles of a file with bytes after them, if these are triangles as well, or bytes slipped in earlier."""
    # Corners of one place are bit by bit the same in all triangles that they are corners of.
    bits = whole.reshape(-1, 3).view(np.uint32)
    inverse = np.unique(bits, axis=0, return_inverse=True)[1].ravel()
    uses = np.bincount(inverse[: 3 * count], minlength=len(inverse) + 1)
    shared = np.any(np.take(uses > 1, inverse.reshape(-1, 3)), axis=1)
    more = len(whole) - count
    if count == 0 or shared[count:].any():
        raise ValueError(f"its header counts {count} triangles, {more or 'no'} more follow")
    if not shared[max(count - max(TAIL, count // 20), 0) : count].mean() > 0.5:
        raise ValueError(f"{extra} bytes follow the triangles that its header counts, the last of which join nothing")


def _ascii(data: bytes) -> Float[np.ndarray, "f 3 3"]:
    words = Words(plain_lines(data).lower())
    if not len(words) or words[0] not in ("solid", "facet"):
        raise ValueError("it begins neither as an ASCII STL ('solid') nor as a binary one")
    if len(words.heads) == 1:  # all in one line
        words = Words(_PARTS.sub(b"\n", words.text))
    heads = words.heads
    ends = words.are(heads, b"endsolid") | words.are(heads, b"end")
    if not ends[-1]:
        raise ValueError("its last line is not 'endsolid'")
    # Lines that begin or end a solid may go on with any words.
    named = np.repeat(ends | words.are(heads, b"solid"), words.lengths)
    which = np.flatnonzero(~named)
    table = which[: len(which) // len(_FACET) * len(_FACET)].reshape(-1, len(_FACET))
    wrong = {column: ~words.are(table[:, column], word.encode()) for column, word in enumerate(_FACET) if word != "?"}
    found = [(table[rows.argmax(), column], column) for column, rows in wrong.items() if rows.any()]
    if found:
        first, column = min(found)
        raise ValueError(f"line {words.line(first)}: {words[first][:40]!r} stands where {_FACET[column]!r} should")
    if len(which) > table.size:
        raise ValueError(f"line {words.line(which[-1])}: its last triangle is not complete")
    return words.numbers(table[:, _CORNERS]).reshape(-1, 3, 3)
