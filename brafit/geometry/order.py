"""Points in the order of a curve that fills space."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

BITS = 10
"""Halvings of the cloud's extent along each axis."""


def along_curve(points: Float[np.ndarray, "n 3"], bits: int = BITS) -> Int[np.ndarray, " n"]:
    """Indices that put points in the order in which Hilbert's curve visits the cells of a grid, 2^bits to an axis.

    Neighbours in this order are neighbours in space, so a run of k points is a small patch of the cloud, and every k-th
    point a sample as evenly spread as all. Coordinates that are not finite count as 0.

    Skilling (2004), Programming the Hilbert curve, AIP Conference Proceedings 707: the index in transposed form.
    """
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    points = np.where(np.isfinite(points), points, 0.0)
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    # The far side belongs to the last cell.
    cells = np.minimum((points - low) / (size or 1.0) * 2**bits, 2**bits - 1).astype(np.int64)
    first, *others = cells.T
    for bit in 2 ** np.arange(bits - 1, 0, -1):
        first = np.where(first & bit, first ^ (bit - 1), first)
        for i, axis in enumerate(others):
            swap = np.where(axis & bit, 0, (first ^ axis) & (bit - 1))
            first, others[i] = np.where(axis & bit, first ^ (bit - 1), first ^ swap), axis ^ swap
    axes = np.bitwise_xor.accumulate([first, *others])
    flip = np.zeros_like(first)
    for bit in 2 ** np.arange(bits - 1, 0, -1):
        flip = np.where(axes[-1] & bit, flip ^ (bit - 1), flip)
    index = np.zeros_like(first)
    for bit in range(bits - 1, -1, -1):
        for axis in axes ^ flip:
            index = (index << 1) | ((axis >> bit) & 1)
    return np.argsort(index, kind="stable")
