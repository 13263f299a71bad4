"""How far two cups are apart once one is moved onto the other as a rigid body, for all pairs of a population.

With P, Q (places x 3) the points of two cups about their own centroids, each row times the root of its share of the
surface, the least mean square distance under all rotations is |P|^2 + |Q|^2 - 2 s, where s = s1 + s2 + s3 is the sum of
the singular values of H = P'Q, the last one with the sign of det H (Kabsch). s is the largest root of

    s^4 - 2 |H|^2 s^2 - 8 det(H) s + 2 |H'H|^2 - |H|^4 = 0    (Theobald 2005),

which Newton's method, begun at (|P|^2 + |Q|^2) / 2 >= s, comes down to. So a block of pairs costs one product of
matrices and some sums, and no singular value decomposition. The root of that mean is a distance in the mathematical
sense: it is symmetric, and obeys the triangle inequality.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

BLOCK = 384
"""Cups in a block of pairs: bounds the memory beyond the matrix itself to some ten megabytes."""
_STEPS = 40
_SETTLED = 1e-13


@dataclass(frozen=True)
class Population:
    """Cups as `distances_between` compares them.

    Attributes:
        points: about their centroids, times the roots of the weights.
        square: mean squares of the distances from the centroid, mm^2.
    """

    points: Float[ndarray, "cups 3 places"]
    square: Float[ndarray, " cups"]

    def __len__(self) -> int:
        return len(self.square)

    def part(self, which: slice | ndarray) -> Population:
        """Some of the cups."""
        return Population(self.points[which], self.square[which])


def population(points: Float[ndarray, "cups places 3"], weights: Float[ndarray, " places"]) -> Population:
    """Cups ready to be compared.

    Args:
        points: at corresponding places, mm, each cup in any frame.
        weights: of the places; they add up to one.
    """
    centred = points - np.einsum("p,cpi->ci", weights, points)[:, None]
    scaled = np.ascontiguousarray((centred * np.sqrt(weights)[:, None]).swapaxes(1, 2))
    return Population(scaled, np.einsum("cip,cip->c", scaled, scaled))


def distances_between(one: Population, other: Population) -> Float[ndarray, "a b"]:
    """Root mean square distance, mm, of every cup of one population from every cup of the other, after the rigid
    motion (any turn and shift, no mirroring) that makes it least.
    """
    a, b, places = len(one), len(other), one.points.shape[2]
    product = one.points.reshape(3 * a, places) @ other.points.reshape(3 * b, places).T
    h = np.ascontiguousarray(product.reshape(a, 3, b, 3).transpose(1, 3, 0, 2))  # (3, 3, a, b)
    mean = (one.square[:, None] + other.square[None]) / 2
    return np.sqrt(np.maximum(2 * (mean - _largest_root(h, mean)), 0.0))


def _largest_root(h: Float[ndarray, "3 3 a b"], start: Float[ndarray, "a b"]) -> Float[ndarray, "a b"]:
    """Sums of singular values, the last with the determinant's sign, as the module's comment has them."""
    square = (h * h).sum((0, 1))
    (p, q, r), (s, t, u), (v, w, x) = h
    determinant = p * (t * x - u * w) - q * (s * x - u * v) + r * (s * w - t * v)
    gram = [(h[:, i] * h[:, j]).sum(0) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    fourth = sum(g * g for g in gram[:3]) + 2 * sum(g * g for g in gram[3:])
    c0, c1, c2 = 2 * fourth - square * square, -8 * determinant, -2 * square
    root = start.copy()
    for _ in range(_STEPS):
        value = ((root * root + c2) * root + c1) * root + c0
        slope = (4 * root * root + 2 * c2) * root + c1
        step = np.where(slope > 0, value / np.where(slope > 0, slope, 1.0), 0.0)
        root = root - step
        if (np.abs(step) <= _SETTLED * start).all():
            break
    return root


def distance_matrix(
    cups: Population, tell: Callable[[int], object] | None = None, block: int = BLOCK
) -> Float32[ndarray, "cups cups"]:
    """Distances of all pairs, mm; 4 bytes a pair are all that is held at once, beyond one block.

    Args:
        cups: n cups; the time goes with n^2, the memory with 4 n^2 bytes.
        tell: called with the number of pairs that have just been done.
        block: cups in a block.
    """
    n = len(cups)
    matrix = np.zeros((n, n), np.float32)
    for i in range(0, n, block):
        for j in range(i, n, block):
            rows, columns = slice(i, min(i + block, n)), slice(j, min(j + block, n))
            found = distances_between(cups.part(rows), cups.part(columns)).astype(np.float32)
            if i == j:
                found = np.minimum(found, found.T)
                np.fill_diagonal(found, 0.0)
            matrix[rows, columns], matrix[columns, rows] = found, found.T
            if tell is not None:
                tell(found.size if i == j else 2 * found.size)
    return matrix
