"""Whether faces are those of a surface, for files that do not say how many lines they should have (OBJ)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from brafit.cloud.refusal import RefusedError

USED = 0.5
"""Least share of the vertices that the faces use."""
REPEATED = 2
"""Vertices in a row that a file has twice, from which on lines were doubled."""
BACK, FOLDED = -0.7, 0.1
"""Cosine between the normals of faces that share a side below which the surface turns back there; largest share of such
sides, each counted by the area of its faces."""
FAR, STRAY = 10.0, 0.02
"""A side reaches far if it is FAR times as long as is usual about its ends; largest share of the area in faces that
join vertices far apart and hang on one other face, or on none."""


def check_uncounted(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "f 3"]) -> None:
    """Refuse faces that do not go with their vertices: the file was cut off among the faces, or lost or doubled lines,
    after which indices mean other vertices.

    A whole mesh may have parts much finer than others, holes, single faces, and long thin ones.

    Raises:
        RefusedError: faces use few of the vertices.
        ValueError: with a short reason.
    """
    used = np.flatnonzero(np.bincount(triangles.ravel()))
    if len(used) < USED * len(vertices):
        cause = f"its faces use {len(used)} of {len(vertices)} vertices only, as if its end were missing"
        raise RefusedError(cause, "Check that the copy is complete; if it is, delete the vertices that no face uses")
    _check_repeats(vertices, unused=len(vertices) - 1 - int(used[-1]) if len(used) else 0)
    if np.isfinite(vertices[used]).all():
        _check_surface(vertices, triangles)


def _check_repeats(vertices: Float[np.ndarray, "v 3"], unused: int) -> None:
    """Refuse a row of vertices that stands twice, one after the other, where as many at the end are not used: those
    behind it are counted wrongly, by that many. (A row that stands twice up to the very end shifts nothing.)
    """
    if unused < REPEATED:
        return
    same = np.append((vertices[unused:] == vertices[:-unused]).all(axis=1), False)
    ends = np.flatnonzero(~same)
    rows = np.diff(ends, prepend=-1) - 1
    # The two lines where the copy begins and ends are one line of both.
    found = ends[(rows >= max(unused - 1, REPEATED)) & (ends < len(same) - 1)]
    if found.size:
        first = int(found[0] - rows[ends == found[0]][0])
        raise ValueError(f"its vertices from the {first + 1}. on stand in it twice, as if lines were doubled")


def _check_surface(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "f 3"]) -> None:
    corners = _places(vertices)[triangles]
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    lengths = np.stack([np.linalg.norm(q - p, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=1)
    begin, end = corners, np.roll(corners, -1, axis=1)
    key = np.minimum(begin, end) * (corners.max(initial=0) + 1) + np.maximum(begin, end)
    order = np.argsort(key, axis=None, kind="stable")
    paired = key.ravel()[order][1:] == key.ravel()[order][:-1]
    one, other = order[:-1][paired], order[1:][paired]
    # The sides of a face that stands there twice, maybe once a way, join it to nothing.
    third = np.roll(corners, 1, axis=1).ravel()
    one, other = (sides[third[one] != third[other]] for sides in (one, other))
    joined = np.zeros(key.size, dtype=bool)
    joined[one] = joined[other] = True
    if _folded(normals, area, begin < end, one, other) > FOLDED or _stray(lengths, area, corners, joined) > STRAY:
        raise ValueError("its faces join vertices far apart, as if lines were lost or doubled")


def _folded(normals: np.ndarray, area: np.ndarray, rising: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Share of the sides between two faces at which the surface turns back, by the area of these faces.

    Args:
        normals: of the faces, as long as their areas are large.
        area: of the faces.
        rising: which way each face runs along each of its sides; two faces turned alike run along theirs both ways.
        one: sides (three a face) that another face has too.
        other: of the other face, in the same order.
    """
    left, right = one // 3, other // 3
    cosine = np.einsum("ij,ij->i", normals[left], normals[right])
    cosine = np.where(rising.ravel()[one] == rising.ravel()[other], -cosine, cosine)
    weight = area[left] + area[right]
    back = cosine < BACK * area[left] * area[right]
    return float(weight[back].sum() / max(weight.sum(), np.finfo(float).tiny))


def _stray(lengths: np.ndarray, area: np.ndarray, corners: np.ndarray, joined: np.ndarray) -> float:
    """Share of the area in faces with at most one side that another face shares, and that reach far."""
    # The usual length at a corner: the mean of the sides there of all other faces; the face's own if there are none.
    own = lengths + np.roll(lengths, 1, axis=1)
    sums, counts = np.bincount(corners.ravel(), own.ravel()), 2 * np.bincount(corners.ravel())
    others = counts[corners] - 2
    usual = np.where(others > 0, (sums[corners] - own) / np.maximum(others, 1), own / 2)
    local = np.maximum(usual, np.roll(usual, -1, axis=1))
    alone = joined.reshape(-1, 3).sum(axis=1) < 2
    far = (lengths > FAR * local).any(axis=1)
    return float(area[alone & far].sum() / max(area.sum(), np.finfo(float).tiny))


def _places(vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, " v"]:
    """A number for each vertex, the same for those at the same place."""
    order = np.lexsort(vertices.T)
    sorted_ = vertices[order]
    places = np.empty(len(vertices), dtype=np.int64)
    places[order] = np.cumsum(np.append(True, (sorted_[1:] != sorted_[:-1]).any(axis=1))) - 1
    return places
