"""Wavefront OBJ: its vertices (v) and polygons (f)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from brafit.cloud.polygons import Mesh, filled
from brafit.cloud.refusal import RefusedError
from brafit.cloud.soundness import check_uncounted
from brafit.cloud.words import Words, plain_lines

VERTEX_WIDTHS = (3, 4, 6, 7)
"""Numbers of a vertex: its position; with a weight; with a colour; with a colour and its opacity."""
_KEYWORD = re.compile(r"[A-Za-z_][\w.-]+|[glops]")
_SURFACES = ("surf", "call")
"""What would bring surface that is not read: free-form surfaces, other files."""


def read_obj(path: Path) -> Mesh:
    """Vertices and triangles of an OBJ; without `f` lines a cloud.

    Words may be parted by any white space and lines begin with it; # begins a comment anywhere; a backslash at the end
    of a line joins the next to it. An index may be relative: -1 is the last vertex before that face. Texture
    coordinates, normals, groups, materials, points and lines say nothing about the surface and are passed over.

    Raises:
        RefusedError: it holds curved surfaces, names other files, or counts vertices from 0.
        ValueError: with a short reason, if a line is not what it should be, a face names a vertex that there is not, or
            the faces are those of no surface (an OBJ says nowhere how many lines it should have).
        OSError: the file cannot be read.
    """
    words = Words(plain_lines(path.read_bytes(), comment=b"#", joining=b"\\"))
    heads, lengths = words.heads, words.lengths
    is_vertex, is_face = words.are(heads, b"v"), words.are(heads, b"f")
    is_passed = words.are(heads, b"vt") | words.are(heads, b"vn")
    _check_others(words, heads[~(is_vertex | is_face | is_passed)])
    if not is_vertex.any():
        raise ValueError("no line of it begins with 'v'")
    vertices = _vertices(words, heads[is_vertex], lengths[is_vertex] - 1)
    if not is_face.any():
        if words.are(heads, b"vt").any():
            raise ValueError("it has texture coordinates but no faces, as if its end were missing")
        return Mesh(vertices)
    before = np.cumsum(is_vertex)[is_face]
    corners, sizes = _faces(words, heads[is_face], lengths[is_face] - 1, before, len(vertices))
    triangles = filled(vertices, corners, sizes)
    check_uncounted(vertices, triangles)
    return Mesh(vertices, triangles)


def _check_others(words: Words, heads: Int[np.ndarray, " n"]) -> None:
    for head in heads:
        if not _KEYWORD.fullmatch(words[head]):
            raise ValueError(f"line {words.line(head)} begins with {words[head][:20]!r}, which no line of an OBJ does")
        if words[head] in _SURFACES:
            cause = f"line {words.line(head)} ({words[head]}) brings more than polygons, which is not read"
            raise RefusedError(cause, "Export the surface as polygons")


def _vertices(words: Words, heads: Int[np.ndarray, " v"], widths: Int[np.ndarray, " v"]) -> Float[np.ndarray, "v 3"]:
    wrong = np.flatnonzero(~np.isin(widths, VERTEX_WIDTHS))
    if wrong.size:
        line, width = words.line(heads[wrong[0]]), widths[wrong[0]]
        raise ValueError(f"line {line} is not complete: a vertex with {width} of its numbers")
    weighted = heads[widths == 4]
    bent = weighted[words.numbers(weighted + 4) != 1]
    if bent.size:
        line, weight = words.line(bent[0]), words[bent[0] + 4]
        cause = f"line {line} gives a vertex the weight {weight}, which makes sense in curved surfaces only"
        raise RefusedError(cause, "Export it with three numbers a vertex, or as a binary .ply")
    coloured = heads[widths > 4]
    if coloured.size:
        words.numbers(coloured[:, None] + np.arange(4, 7))
    return words.numbers(heads[:, None] + np.arange(1, 4))


def _faces(
    words: Words,
    heads: Int[np.ndarray, " f"],
    sizes: Int[np.ndarray, " f"],
    before: Int[np.ndarray, " f"],
    count: int,
) -> tuple[Int[np.ndarray, " c"], Int[np.ndarray, " f"]]:
    """Corners, counted from 0, of one polygon after another, and how many each polygon has.

    Args:
        words: of the file.
        heads: the word `f` of each face.
        sizes: how many corners each face has.
        before: vertices that stand before each face.
        count: vertices in all.
    """
    few = np.flatnonzero(sizes < 3)
    if few.size:
        raise ValueError(f"line {words.line(heads[few[0]])} is not complete: a face of {sizes[few[0]]} corners")
    which = np.repeat(heads + 1 - (np.cumsum(sizes) - sizes), sizes) + np.arange(sizes.sum())
    named = words.whole_numbers(which, until=b"/")
    corners = np.where(named < 0, np.repeat(before, sizes) + named, named - 1)
    wrong = np.flatnonzero((corners < 0) | (corners >= count))
    if wrong.size and named.min() == 0 and named.max() == count - 1:
        cause = "its faces count the vertices from 0, an OBJ counts them from 1"
        raise RefusedError(cause, "Add 1 to every corner of its faces, or export it as a .ply")
    if wrong.size:
        at, stand = words.line(which[wrong[0]]), int(np.repeat(before, sizes)[wrong[0]])
        there = f"{stand} stand before it" if named[wrong[0]] < 0 else f"there are {count}, counted from 1"
        raise ValueError(f"line {at}: a face names vertex {named[wrong[0]]}, {there}")
    return corners, sizes
