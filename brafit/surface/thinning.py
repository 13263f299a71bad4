"""Fewer points, evenly spread: each once, means of voxels, and the most crowded out."""

from __future__ import annotations

import math
from heapq import heappop, heappush
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from brafit.cloud.open3d_runtime import open3d
from brafit.surface.neighbours import nearest, tree_of

SURPLUS, SLACK = 1.2, 1.25
"""Ratio of occupied voxels to wanted points: what the search aims at, and the most that it accepts. The means of
neighbouring voxels can lie close together; the most crowded of the surplus are then removed."""


def distinct(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """The points sorted by x, y, z, each once."""
    points = points[np.lexsort(points.T[::-1])]
    return points[first_of_each(points)]


def first_of_each(ordered: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which of sorted points differ from the one before."""
    new = np.ones(len(ordered), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return new


def thin(points: Float[np.ndarray, "n 3"], count: int | None) -> tuple[Float[np.ndarray, "m 3"], float]:
    """At most `count` points, evenly spread, and the voxel edge used.

    Points in a voxel are replaced by their mean; the voxel edge is sought so that a fifth more voxels are occupied than
    points wanted, and of these the most crowded go (`uncrowd`). So exactly `count` points come back, or all distinct
    ones where there are no more. Sorted; independent of the input's order.

    Args:
        points: in any order.
        count: points at most; None: all distinct ones.
    """
    points = distinct(points)
    if count is None or len(points) <= count:
        return points, 0.0
    voxel = _voxel_for(points, count)
    means = _averaged(points, voxel) if voxel else points
    return means[uncrowd(means, count)], voxel


def uncrowd(points: Float[np.ndarray, "n 3"], count: int) -> Bool[np.ndarray, " n"]:
    """Mask of `count` evenly spread points of a cloud.

    Points are taken out one by one: of the closest pair, the one with the nearer third point.
    """
    if len(points) <= count:
        return np.ones(len(points), dtype=bool)
    crowd = _Crowd(*(found[:, 1:] for found in nearest(tree_of(points), points, min(17, len(points)))))
    alive, whose = crowd.alive, _Partners(crowd.near[:, 0])
    closest, partner = crowd.distances[:, 0].tolist(), crowd.near[:, 0].tolist()
    # Of many points few are touched, so the first pairs are a sorted list, and only those that change a heap.
    order = np.argsort(crowd.distances[:, 0], kind="stable")
    sorted_pairs = zip(crowd.distances[order, 0].tolist(), order.tolist(), strict=True)
    changed: list[tuple[float, int]] = []
    pair = next(sorted_pairs, None)
    excess = len(points) - count
    while excess:
        if changed and (pair is None or changed[0] < pair):
            away, first = heappop(changed)
        elif pair is not None:
            (away, first), pair = pair, next(sorted_pairs, None)
        else:  # no point knows another that is left
            kept = np.array(alive, dtype=bool)
            kept[kept] = uncrowd(points[kept], count)
            return kept
        if not alive[first] or closest[first] != away:
            continue  # out of date
        second = partner[first]
        gone = first if crowd.left(first, 1)[0] < crowd.left(second, 1)[0] else second
        alive[gone] = False
        excess -= 1
        for k in whose.of(gone):
            if alive[k] and partner[k] == gone:
                closest[k], partner[k] = crowd.left(k, 0)
                if partner[k] >= 0:
                    whose.add(partner[k], k)
                    heappush(changed, (closest[k], k))
    return np.array(alive, dtype=bool)


class _Crowd:
    """Points of which some are taken out, and the nearest of each.

    Attributes:
        alive: which are left; of single entries much quicker than an array.
        distances, near: of each point's neighbours, nearest first.
    """

    def __init__(self, distances: Float[np.ndarray, "n k"], near: Int[np.ndarray, "n k"]) -> None:
        self.distances, self.near = distances, near
        self.alive = bytearray(b"\1" * len(near))

    def left(self, k: int, rank: int) -> tuple[float, int]:
        """Distance and index of a point's nearest neighbour (rank 0) or the next one, of those that are left; infinite
        and -1 where it knows none.
        """
        for column, neighbour in enumerate(self.near[k].tolist()):
            if self.alive[neighbour]:
                if not rank:
                    return float(self.distances[k, column]), neighbour
                rank -= 1
        return np.inf, -1


class _Partners:
    """Which points have a point as their nearest one."""

    def __init__(self, nearest: Int[np.ndarray, " n"]) -> None:
        self._order = np.argsort(nearest, kind="stable")
        self._starts = np.searchsorted(nearest[self._order], np.arange(len(nearest) + 1))
        self._added: dict[int, list[int]] = {}

    def of(self, k: int) -> list[int]:
        """Those of a point, some of them maybe no longer."""
        return self._order[self._starts[k] : self._starts[k + 1]].tolist() + self._added.get(k, [])

    def add(self, k: int, other: int) -> None:
        """Another one has it as its nearest now."""
        self._added.setdefault(k, []).append(other)


def _voxel_for(points: np.ndarray, count: int) -> float:
    """A voxel edge that leaves some more points than `count`; 0 if there are few."""
    wanted = SURPLUS * count
    if len(points) <= wanted:
        return 0.0
    coarse = float(np.linalg.norm(np.ptp(points, axis=0)))
    fine = 0.0
    for _ in range(60):
        # Geometric bisection; until a fine enough edge is known, a jump down.
        edge = float(np.sqrt(fine * coarse)) if fine else coarse / 4
        occupied = _occupied(points, edge)
        if occupied < wanted:
            coarse = edge
            continue
        fine = edge
        if occupied <= SLACK * count or coarse / fine < 1 + 1e-6:
            break
    return fine


def averaged(points: Float[np.ndarray, "n 3"], dense: int) -> Float[np.ndarray, "m 3"]:
    """Means of the points in voxels, about `dense` of them; fewer points stay as they are."""
    return points if len(points) <= dense else _averaged(points, _edge_for(points, dense))


def _edge_for(points: np.ndarray, dense: int) -> float:
    """Voxel edge that leaves about `dense` points of a surface: from the number at a coarser edge, as areas go; again,
    where strays fill the space and the number does not go with the area.
    """
    edge = float(np.linalg.norm(np.ptp(points, axis=0))) / 60
    for _ in range(4):
        occupied = _occupied(points, edge)
        edge *= float(np.sqrt(occupied / dense))
        if occupied > dense / 2:
            break
    return edge


def _occupied(points: np.ndarray, edge: float) -> int:
    """How many points `_averaged` leaves: a search needs no more."""
    cells = np.floor(points / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    sides = [int(side) for side in cells.max(axis=0) + 1]
    if math.prod(sides) > 2**62:
        return len(np.unique(cells, axis=0))
    cells[:, 0] *= sides[1]
    cells[:, 0] += cells[:, 1]
    cells[:, 0] *= sides[2]
    cells[:, 0] += cells[:, 2]
    return 1 + int(np.count_nonzero(np.diff(np.sort(cells[:, 0]))))


def _averaged(points: np.ndarray, edge: float) -> np.ndarray:
    return distinct(_cloud(points).voxel_down_sample(edge).point.positions.numpy())


def _cloud(points: np.ndarray) -> Any:
    o3d = open3d()
    return o3d.t.geometry.PointCloud(o3d.core.Tensor(np.ascontiguousarray(points)))
