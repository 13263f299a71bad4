"""OFF, the Object File Format: a header, counts, then one line a vertex and one line a polygon."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from brafit.cloud.polygons import Mesh, filled
from brafit.cloud.refusal import RefusedError
from brafit.cloud.words import Words, plain_lines

_HEADER = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF")


def read_off(path: Path) -> Mesh:
    """Vertices and triangles of an OFF; without faces a cloud. What stands behind position and corners (normals,
    colours, texture coordinates) is passed over.

    Raises:
        RefusedError: it is binary, or not of three dimensions.
        ValueError: with a short reason, if the lines are not those that the counts promise.
        OSError: the file cannot be read.
    """
    words = Words(plain_lines(path.read_bytes(), comment=b"#"))
    first = words[0] if len(words) else ""
    header = _HEADER.fullmatch(first)
    if header is None:
        raise ValueError("its first line is not 'OFF'")
    if header[4] or header[5] or (len(words) > 1 and words[1].upper() == "BINARY"):
        cause = "it is a binary OFF, or one of other than three dimensions, which is not read"
        raise RefusedError(cause, "Export it as an ASCII .off, or as a binary .ply")
    if len(words) < 3:
        raise ValueError("it does not say how many vertices and faces it has")
    vertices, faces = (int(count) for count in words.whole_numbers(np.array([1, 2])))
    # The counts stand in the first line or in one of their own.
    begin = 1 if words.lengths[0] > 1 else 2
    heads, lengths = words.heads[begin:], words.lengths[begin:]
    if vertices < 0 or faces < 0 or len(heads) != vertices + faces:
        raise ValueError(f"it promises {vertices} vertices and {faces} faces, {len(heads)} lines follow")
    short = np.flatnonzero(lengths[:vertices] < 3)
    if short.size:
        raise ValueError(f"line {words.line(heads[short[0]])} is not complete: a vertex of {lengths[short[0]]} numbers")
    positions = words.numbers(heads[:vertices, None] + np.arange(1, 4) - 1)
    heads, lengths = heads[vertices:], lengths[vertices:]
    sizes = words.whole_numbers(heads)
    short = np.flatnonzero((sizes < 1) | (lengths < 1 + sizes))
    if short.size:
        raise ValueError(f"line {words.line(heads[short[0]])} is not complete: it promises {sizes[short[0]]} corners")
    which = np.repeat(heads + 1 - (np.cumsum(sizes) - sizes), sizes) + np.arange(sizes.sum())
    return Mesh(positions, filled(positions, words.whole_numbers(which), sizes))
