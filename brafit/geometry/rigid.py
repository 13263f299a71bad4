"""Rigid alignment of points with points (NumPy)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float


def motion_onto(
    points: Float[np.ndarray, "n 3"], aims: Float[np.ndarray, "n 3"], weights: Float[np.ndarray, " n"] | None = None
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """The rigid motion, without mirroring, that brings points nearest to their aims (least squares, Kabsch).

    Args:
        points: in a plane as well.
        aims: where each of them should come to.
        weights: how much each of them counts; None: all alike.

    Returns:
        turn and shift: `points @ turn + shift` are the moved points.
    """
    share = np.full(len(points), 1 / len(points)) if weights is None else weights / weights.sum()
    middle, aim = share @ points, share @ aims
    u, _, v = np.linalg.svd((points - middle).T @ ((aims - aim) * share[:, None]))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return turn, aim - middle @ turn


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
    turn, shift = motion_onto(points[used], aims[used])
    return points @ turn + shift
