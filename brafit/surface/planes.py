"""Planes through the neighbours of every point of a cloud, many at once.

Arrays here have one row a coordinate, (3, n) or (6, n): sums over neighbours then run along memory, several times as
fast as for (n, 3).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

CLEAR = 1e-3
"""Where the least eigenvalue is nearer to the next one than this, as a share of their spread (about), the closed form
would lose digits, and LAPACK is asked instead."""
CHUNK = 1024
"""Points that are computed together, few enough for the processor's cache."""
LEAST = {np.dtype(np.float64): 1e-100, np.dtype(np.float32): np.float32(1e-12)}
"""A spread (of eigenvalues whose largest entry is 1) that counts as none."""
ROUNDS = 3
"""Times that a plane is fitted, each time with less weight on what lay far off it the time before."""


def least_axes(moments: Float[np.ndarray, "6 n"]) -> Float[np.ndarray, "3 n"]:
    """Unit eigenvectors of the least eigenvalues of symmetric matrices.

    The eigenvalue is the closed form by a cosine, the vector the largest of the cross products of the rows of A -
    lambda I. Where two eigenvalues are alike, so that the vector is in doubt, it is one that LAPACK gives.

    Args:
        moments: rows xx, xy, xz, yy, yz, zz.
    """
    largest = np.abs(moments).max(axis=0)
    xx, xy, xz, yy, yz, zz = moments / np.where(largest > 0, largest, 1.0)
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    half = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / 2
    cosine = np.clip(half / np.maximum(spread, LEAST[spread.dtype]) ** 3, -1.0, 1.0)
    least = 2 * spread * np.cos(np.arccos(cosine) / 3 + 2 * np.pi / 3)
    a, b, c = a - least, b - least, c - least
    crossed = np.array([
        [xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy],
        [xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz],
        [b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz],
    ])  # fmt: skip
    square = (crossed**2).sum(axis=1)
    chosen = np.take_along_axis(crossed, square.argmax(axis=0)[None, None], axis=0)[0]
    size = np.sqrt(square.max(axis=0))
    axes = chosen / np.where(size > 0, size, 1.0)
    doubtful = np.flatnonzero(~(size > CLEAR * spread**2))
    if len(doubtful):
        full = moments[:, doubtful][[0, 1, 2, 1, 3, 4, 2, 4, 5]].T.reshape(-1, 3, 3)
        axes[:, doubtful] = np.linalg.eigh(full)[1][:, :, 0].T
    return axes


def normals_at(points: Float[np.ndarray, "n 3"], near: Int[np.ndarray, "m k"]) -> Float[np.ndarray, "m 3"]:
    """Unit normals, to either side, of the planes through groups of points.

    Args:
        points: in any unit.
        near: indices of each group's points.
    """
    columns = np.ascontiguousarray(points.T)
    moments = np.empty((6, len(near)))
    for start in range(0, len(near), CHUNK):
        part = slice(start, start + CHUNK)
        around = np.take(columns, np.ascontiguousarray(near[part].T), axis=1)
        around -= around.mean(axis=1, keepdims=True)
        moments[:, part] = _moments(around, around)
    return np.ascontiguousarray(least_axes(moments).T)


def distances_off(
    points: Float[np.ndarray, "n 3"], chosen: Int[np.ndarray, " m"], near: Int[np.ndarray, "m k"]
) -> Float[np.ndarray, " m"]:
    """Distances of chosen points from the planes through their neighbours; those that lie far off a plane count little
    for it.

    Args:
        points: in any unit, about a few mm apart if that is mm.
        chosen: indices of the points.
        near: indices of each one's neighbours.
    """
    columns = np.ascontiguousarray(points.T)
    distances = np.empty(len(near))
    for start in range(0, len(near), CHUNK):
        part = slice(start, start + CHUNK)
        own = columns[:, chosen[part]]
        others = np.take(columns, np.ascontiguousarray(near[part].T), axis=1) - own[:, None]
        # Offsets of a few mm: single precision is exact to a millionth of that, and half the work.
        distances[part] = _distance_off(others.astype(np.float32))
    return distances


def _distance_off(others: Float[np.ndarray, "3 k m"]) -> Float[np.ndarray, " m"]:
    """Distance of the origin from the plane through others."""
    count = others.shape[1]
    weights = np.ones(others.shape[1:], dtype=others.dtype)
    distance = np.zeros(others.shape[2])
    for left in reversed(range(ROUNDS)):
        centre = np.einsum("km,ikm->im", weights, others) / weights.sum(axis=0)
        offset = others - centre[:, None]
        normal = least_axes(_moments(weights * offset, offset))
        distance = np.abs((centre * normal).sum(axis=0))
        if left:
            off = np.abs(np.einsum("im,ikm->km", normal, offset))
            low, high = (count - 1) // 2, count // 2
            ordered = np.partition(np.ascontiguousarray(off.T), sorted({low, high}), axis=1)
            off /= np.maximum(ordered[:, low] + ordered[:, high], 1e-9)  # over twice the median
            weights = 1 / (1 + off * off) ** 2
    return distance


def _moments(one: Float[np.ndarray, "3 k m"], other: Float[np.ndarray, "3 k m"]) -> Float[np.ndarray, "6 m"]:
    """Sums of products over k: rows xx, xy, xz, yy, yz, zz."""
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    return np.stack([np.einsum("km,km->m", one[i], other[j]) for i, j in pairs])
