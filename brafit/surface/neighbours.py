"""Nearest points: those of every point of a cloud, kept up to date while points are taken out, or of a few places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

LEAF = 16
"""Points of a leaf of `tree_of`."""
SPARE = 4
"""Neighbours that are looked up beyond those asked for: a point that loses some need not be looked up again."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The nearest `count` points, and some more, of each point, nearest first; each point is its own first neighbour.

    Attributes:
        points: the cloud.
        distances, near: of the neighbours and their indices; beyond what is known infinite, and the point itself.
        count: the first `count` columns are complete.
    """

    points: Float[np.ndarray, "n 3"]
    distances: Float[np.ndarray, "n k"]
    near: Int[np.ndarray, "n k"]
    count: int

    @staticmethod
    def of(points: Float[np.ndarray, "n 3"], count: int) -> Neighbours:
        """The neighbours in a cloud; `count` or all points, if there are fewer."""
        wanted = min(count + SPARE, len(points))
        return Neighbours(points, *nearest(tree_of(points), points, wanted), min(count, len(points)))

    def among(self, kept: Bool[np.ndarray, " n"]) -> tuple[Neighbours, Bool[np.ndarray, " m"]]:
        """The neighbours in what is left of the cloud, and which of its points have others than before."""
        if kept.all():
            return self, np.zeros(len(kept), dtype=bool)
        points, count = self.points[kept], min(self.count, int(kept.sum()))
        distances, near = self.distances[kept], self.near[kept]
        alive = kept[near]
        hit = np.flatnonzero(~alive.all(axis=1))
        alive = alive[hit] & np.isfinite(distances[hit])
        changed = np.zeros(len(points), dtype=bool)
        changed[hit] = ~alive[:, : self.count].all(axis=1)
        near = np.take(np.cumsum(kept) - 1, near)
        # What is left comes first, in its order.
        order = np.argsort(~alive, axis=1, kind="stable")
        there = np.take_along_axis(alive, order, axis=1)
        distances[hit] = np.where(there, np.take_along_axis(distances[hit], order, axis=1), np.inf)
        near[hit] = np.where(there, np.take_along_axis(near[hit], order, axis=1), hit[:, None])
        if len(short := hit[there.sum(axis=1) < count]):
            width = min(near.shape[1], len(points))
            distances[short, :width], near[short, :width] = nearest(tree_of(points), points[short], width)
        return Neighbours(points, distances, near, count), changed


def tree_of(points: Float[np.ndarray, "n d"]) -> KDTree:
    """A tree of points: boxes halved in space, with the points of a leaf together, take two thirds of the time of
    SciPy's default to build, and no longer to search."""
    return KDTree(points, leafsize=LEAF, balanced_tree=False)


def nearest(
    tree: KDTree, places: Float[np.ndarray, "k 3"], count: int, within: float = np.inf
) -> tuple[Float[np.ndarray, "k count"], Int[np.ndarray, "k count"]]:
    """Distances and indices of a tree's points nearest to each place, nearest first: one column each, also for one.

    Args:
        tree: of the points.
        places: in the unit of the points.
        count: points to each place.
        within: what is farther is not looked for: infinite distances, and the number of points as index.
    """
    wanted: Any = np.arange(1, count + 1)
    distances, near = tree.query(places, k=wanted, distance_upper_bound=within)
    return np.asarray(distances), np.asarray(near)


def distances_to(
    points: Float[np.ndarray, "n 3"], places: Float[np.ndarray, "k 3"], reach: float
) -> Float[np.ndarray, " k"]:
    """Distances of a few places from a cloud; infinite for those farther than `reach`.

    Only the points in the places' box count, so that no tree of the whole cloud is made.
    """
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    near = points[((points >= low) & (points <= high)).all(axis=1)]
    if not len(near):
        return np.full(len(places), np.inf)
    tree = KDTree(near, leafsize=LEAF, balanced_tree=False, compact_nodes=False)
    return np.asarray(tree.query(places, distance_upper_bound=reach)[0])


def apart(points: Float[np.ndarray, "n 3"], sample: int = 300) -> float:
    """Median distance from one of a sample of points to the nearest other point; infinite where there are not two."""
    if len(points) < 2:
        return float(np.inf)
    tree = KDTree(points, leafsize=LEAF, balanced_tree=False, compact_nodes=False)
    return float(np.median(nearest(tree, points[:: max(1, len(points) // sample)], 2)[0][:, 1]))
