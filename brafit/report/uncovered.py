"""The share of a cup without data."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from brafit.cup.shape import CupShape

REACH = 5.0
"""A place of the cup farther than this (mm) from every point has no data."""
_FEW = (3, 5)
"""Places of a block, across and along a panel."""
_SURE = 1 - 1e-9
"""Share of a distance that no rounding makes more than the whole."""


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
    tree, found, areas = KDTree(points), [], []
    for lower, upper in itertools.pairwise(edges):
        middle_lower, middle_upper = (lower[1:] + lower[:-1]) / 2, (upper[1:] + upper[:-1]) / 2
        ruling = middle_upper - middle_lower
        along = (1 - u) * np.diff(lower, axis=0) + u * np.diff(upper, axis=0)
        areas.append(np.linalg.norm(np.cross(along, ruling), axis=-1).ravel())
        found.append(_within(reach, middle_lower + u * ruling, tree).ravel())
    area = np.concatenate(areas)
    return float(area[~np.concatenate(found)].sum() / area.sum())


def _within(reach: float, places: Float[np.ndarray, "k n 3"], tree: KDTree) -> Bool[np.ndarray, "k n"]:
    """Which places of a grid have one of the tree's points within reach.

    Of every block the middle is looked up; another is no farther from that one's nearest point than the way by it.
    Only what that leaves open is looked up too, little where the data are dense.
    """
    middle, block = zip(*(_blocks(size, few) for size, few in zip(places.shape, _FEW, strict=False)), strict=True)
    middles = places[np.ix_(*middle)]
    away = np.asarray(tree.query(middles)[0])
    own = np.ix_(*block)
    found = away[own] + np.linalg.norm(places - middles[own], axis=-1) < reach * _SURE
    found[~found] = tree.query(places[~found], distance_upper_bound=reach)[0] < np.inf
    return found


def _blocks(count: int, few: int) -> tuple[Int[np.ndarray, " blocks"], Int[np.ndarray, " count"]]:
    """The middles of blocks of so many in a row, and the block of each."""
    return np.minimum(np.arange(0, count, few) + few // 2, count - 1), np.arange(count) // few
