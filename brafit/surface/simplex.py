"""Nelder and Mead's simplexes, many at once: for functions of a few numbers that are cheap to evaluate together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

LARGER, FROM_ZERO = 0.05, 0.00025
"""A start's simplex: each coordinate larger by this share of it, or so far off zero."""


def minimised(
    loss: Callable[[Float[np.ndarray, "n d"]], Float[np.ndarray, " n"]],
    starts: Float[np.ndarray, "b d"],
    *,
    xatol: float,
    fatol: float,
    rounds: int,
) -> Float[np.ndarray, "b d"]:
    """The best point that each start leads to; step by step what `scipy.optimize.minimize` finds for one start.

    In every round all places that a simplex may want next are evaluated in one call.

    Args:
        loss: of many points.
        starts: one a row.
        xatol: a simplex stops when its corners are so near to the best one, in every coordinate, and
        fatol: their losses so near to the least.
        rounds: at most `rounds` - 1 rounds are done.
    """
    b, d = starts.shape
    corners = np.repeat(starts[:, None], d + 1, axis=1)
    k = np.arange(d)
    corners[:, k + 1, k] = np.where(starts != 0, (1 + LARGER) * starts, FROM_ZERO)
    corners, values = _sorted(corners, loss(corners.reshape(-1, d)).reshape(b, d + 1))
    going = np.arange(b)
    for _ in range(rounds - 1):
        near = np.abs(corners[going, 1:] - corners[going, :1]).max(axis=(1, 2)) <= xatol
        near &= np.abs(values[going, 1:] - values[going, :1]).max(axis=1) <= fatol
        going = going[~near]
        if not len(going):
            break
        corners[going], values[going] = _sorted(*_step(loss, corners[going], values[going]))
    return corners[:, 0]


def _step(
    loss: Callable[[np.ndarray], np.ndarray], corners: Float[np.ndarray, "b c d"], values: Float[np.ndarray, "b c"]
) -> tuple[np.ndarray, np.ndarray]:
    """The worst corner reflected, or beyond that, or drawn to the others from either side; or all drawn to the best."""
    b, d = len(corners), corners.shape[2]
    worst, middle = corners[:, -1], corners[:, :-1].mean(axis=1)
    tried = np.stack([middle + share * (middle - worst) for share in (1.0, 2.0, 0.5, -0.5)], axis=1)
    reflected, beyond, outside, inside = loss(tried.reshape(-1, d)).reshape(b, 4).T
    best, second, last = values[:, 0], values[:, -2], values[:, -1]
    choice = np.select(
        [reflected < best, reflected < second, reflected < last],
        [np.where(beyond < reflected, 1, 0), 0, np.where(outside <= reflected, 2, -1)],
        np.where(inside < last, 3, -1),
    )
    corners, values = corners.copy(), values.copy()
    moved = np.flatnonzero(choice >= 0)
    corners[moved, -1] = tried[moved, choice[moved]]
    values[moved, -1] = np.stack([reflected, beyond, outside, inside], axis=1)[moved, choice[moved]]
    if len(shrunk := np.flatnonzero(choice < 0)):
        corners[shrunk, 1:] = (corners[shrunk, 1:] + corners[shrunk, :1]) / 2
        values[shrunk, 1:] = loss(corners[shrunk, 1:].reshape(-1, d)).reshape(len(shrunk), -1)
    return corners, values


def _sorted(corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(values, axis=1, kind="stable")
    return np.take_along_axis(corners, order[:, :, None], axis=1), np.take_along_axis(values, order, axis=1)
