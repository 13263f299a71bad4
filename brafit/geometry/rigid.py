"""Rigid alignment of points with points (NumPy)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float


def laid_on(
    points: Float[np.ndarray, "n 3"],
    aims: Float[np.ndarray, "n 3"],
    used: Bool[np.ndarray, " n"] | slice = slice(None),
) -> Float[np.ndarray, "n 3"]:
    """Points moved rigidly, without mirroring, so that those used come nearest to their aims (least squares, Kabsch).

    Args:
        points: in a plane as well.
        aims: where each of them should come to.
        used: those that decide; all are moved.
    """
    middle, aim = points[used].mean(axis=0), aims[used].mean(axis=0)
    u, _, v = np.linalg.svd((points[used] - middle).T @ (aims[used] - aim))
    return (points - middle) @ u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v + aim
