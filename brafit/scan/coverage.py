"""Where a scan has no data: weights by the surface that points stand for, and the share of a cup without data."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from brafit.cup.shape import CupShape

REACH = 5.0
"""A place of the cup farther than this (mm) from every point has no data."""
NEIGHBOURS = 6
WEIGHTS = (0.3, 3.0)
"""Least and largest weight of a point, over the median: a stray point on the far side of a hole must not rule."""


def point_weights(points: Float[np.ndarray, "n 3"], neighbours: int = NEIGHBOURS) -> Float[np.ndarray, " n"]:
    """The share of the surface that each point stands for; they sum to 1.

    The area about a point goes with the squared distance to its neighbours. So the mean over the points is one over the
    surface, and the points at the edge of a hole stand for part of it, instead of leaving it to whatever is cheapest.
    """
    if len(points) <= neighbours:
        return np.full(len(points), 1 / max(len(points), 1))
    distances = np.asarray(KDTree(points).query(points, k=neighbours + 1)[0])[:, 1:]
    area = (distances**2).mean(axis=1)
    median = float(np.median(area))
    if median == 0:
        return np.full(len(points), 1 / len(points))
    weights = np.clip(area / median, *WEIGHTS)
    return weights / weights.sum()


def uncovered_share(shape: CupShape, points: Float[np.ndarray, "n 3"], reach: float = REACH) -> float:
    """Share of a cup's area that has no point within `reach`.

    Args:
        shape: one cup (no batch dimension), mm.
        points: the data, before thinning, in the cup's frame.
    """
    edges = shape.edges.detach().cpu().double().numpy()
    u = (np.arange(40) + 0.5)[:, None, None] / 40
    places, areas = [], []
    for lower, upper in itertools.pairwise(edges):
        middle_lower, middle_upper = (lower[1:] + lower[:-1]) / 2, (upper[1:] + upper[:-1]) / 2
        ruling = middle_upper - middle_lower
        along = (1 - u) * np.diff(lower, axis=0) + u * np.diff(upper, axis=0)
        places.append((middle_lower + u * ruling).reshape(-1, 3))
        areas.append(np.linalg.norm(np.cross(along, ruling), axis=-1).ravel())
    distance = KDTree(points).query(np.concatenate(places))[0]
    area = np.concatenate(areas)
    return float(area[distance > reach].sum() / area.sum())
