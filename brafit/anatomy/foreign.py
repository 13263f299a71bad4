"""What a scan holds beside a body: a floor or a wall, another body. Looked for where no breast was found."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import ndimage

SLAB, FLAT = 10.0, 0.06
"""A floor: so large a share of the points between two planes so far apart (mm). Of a body, a slab holds 3 %."""
WIDE = 500.0
"""It reaches so far (mm) both ways: farther than a body is deep."""
CELL, CELLS = 30.0, 150
"""Edge (mm) of the cells in which parts of a scan are told apart, and cells along its longest side at most."""
OTHER = 0.2
"""A part with so large a share of the points is another body, or a piece of furniture."""


def foreign_cause(points: Float[np.ndarray, "n 3"]) -> tuple[str, str] | None:
    """What of a scan is no part of one body, and what to do about it; None if nothing is seen of the kind.

    Args:
        points: mm, in any frame.
    """
    shares = _part_shares(points)
    if len(shares) > 1 and shares[1] > OTHER:
        listed = " and ".join(f"{100 * share:.0f} %" for share in shares[:2])
        return f"it falls apart into parts with {listed} of its points, as of two bodies", "Leave one body in each file"
    flat = _flat_share(points)
    if flat > FLAT:
        return f"{100 * flat:.0f} % of its points lie in one plane, as of a floor or a wall", "Cut the plane off"
    return None


def _flat_share(points: np.ndarray) -> float:
    """Largest share of the points in a wide slab across an axis of the scan, or of its frame."""
    centred = points - np.median(points, axis=0)
    axes = np.concatenate([np.eye(3), np.linalg.eigh(centred.T @ centred)[1].T])
    return max(_share_across(centred, axis) for axis in axes)


def _share_across(points: np.ndarray, axis: np.ndarray) -> float:
    """The share in the fullest slab across an axis, if that is wide in both directions; else 0."""
    height = np.sort(points @ axis)
    inside = np.searchsorted(height, height + SLAB) - np.arange(len(height))
    start = height[inside.argmax()]
    along = points @ axis
    slab = points[(along >= start) & (along <= start + SLAB)]
    sides = np.linalg.svd(axis[None])[2][1:]
    low, high = np.quantile(slab @ sides.T, (0.05, 0.95), axis=0)
    return len(slab) / len(points) if (high - low).min() > WIDE else 0.0


def _part_shares(points: np.ndarray) -> list[float]:
    """Shares of the points in the parts into which the scan falls, the largest first."""
    low = points.min(axis=0)
    cell = max(CELL, float(np.ptp(points, axis=0).max()) / CELLS)
    places = ((points - low) / cell).astype(int)
    filled = np.zeros(places.max(axis=0) + 1, dtype=bool)
    filled[tuple(places.T)] = True
    parts = np.zeros(filled.shape, dtype=np.int32)
    ndimage.label(filled, np.ones((3, 3, 3)), output=parts)
    counts = np.bincount(parts[tuple(places.T)])
    return sorted((counts[1:] / len(points)).tolist(), reverse=True)
