"""The share of a cup without data."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from brafit.cup.shape import CupShape

REACH = 5.0
"""A place of the cup farther than this (mm) from every point has no data."""


def uncovered_share(shape: CupShape, points: Float[np.ndarray, "n 3"], reach: float = REACH) -> float:
    """Share of a cup's area that has no point within `reach`; nan for a cup that is none.

    Args:
        shape: one cup (no batch dimension), mm.
        points: the data, before thinning, in the cup's frame.
        reach: mm.
    """
    edges = shape.edges.detach().cpu().double().numpy()
    if not np.isfinite(edges).all():
        return float("nan")
    u = (np.arange(40) + 0.5)[:, None, None] / 40
    places, areas = [], []
    for lower, upper in itertools.pairwise(edges):
        middle_lower, middle_upper = (lower[1:] + lower[:-1]) / 2, (upper[1:] + upper[:-1]) / 2
        ruling = middle_upper - middle_lower
        along = (1 - u) * np.diff(lower, axis=0) + u * np.diff(upper, axis=0)
        places.append((middle_lower + u * ruling).reshape(-1, 3))
        areas.append(np.linalg.norm(np.cross(along, ruling), axis=-1).ravel())
    found = KDTree(points).query(np.concatenate(places), distance_upper_bound=reach)[0] < np.inf
    area = np.concatenate(areas)
    return float(area[~found].sum() / area.sum())
