"""From a raw cloud to the points of the fit: doubles and outliers out, the breast only, evenly thinned."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from brafit.cloud.open3d_runtime import open3d
from brafit.errors import ConfigError
from brafit.surface.cropping import crop
from brafit.surface.neighbours import Neighbours, nearest, tree_of
from brafit.surface.normals import NEIGHBOURS, Surface, links, on_surface, parts, settle, surface_of

SURPLUS, SLACK = 1.2, 1.25
"""Ratio of occupied voxels to wanted points: what the search aims at, and the most that it accepts. The means of
neighbouring voxels can lie close together; the most crowded of the surplus are then removed."""
DENSE = 32_000
"""More points than this about a breast add nothing; they are averaged in voxels first."""
SCATTER_PLACES, SCATTER_RADIUS = 500, 6.0
"""Places at which noise is measured, and the radius (mm) of the plane about each."""
LONELY = 3.0
"""A point is on no surface if the mean distance to its neighbours is more than LONELY times the cloud's median."""
ISLAND = 0.05
"""A part that hangs together with nothing else goes if it is smaller than this share of the largest: scanners cut real
surfaces into large parts (shadows) and put small ones where nothing is."""


@dataclass(frozen=True)
class Cleaning:
    """How many points each step took; with `used` they add up to `read` and `other_side`.

    Attributes:
        read: points in the file (or sampled on its mesh).
        other_side: points of the other breast that were added, mirrored.
        not_finite: coordinates NaN, infinite or absurdly large.
        elsewhere: far from the breast, left out.
        duplicates: repetitions of a point.
        outliers: removed as statistical outliers.
        off_surface: floating beside the surface that their neighbours make up.
        islands: in small parts without connection.
        outside: not flagged `inside`, or not within wire and neckline.
        thinned: merged with neighbours.
        used: points of the fit.
        voxel_mm: edge of the voxels in which points were averaged; 0 where all points are used.
        scatter_mm: root mean square distance of the breast's points, before thinning, from the mean plane of those
            about them: the noise that is left; None where that is not known.
    """

    read: int
    other_side: int
    not_finite: int
    elsewhere: int
    duplicates: int
    outliers: int
    off_surface: int
    islands: int
    outside: int
    thinned: int
    used: int
    voxel_mm: float
    scatter_mm: float | None = None


@dataclass(frozen=True)
class Cleaned:
    """A cleaned cloud in the cup frame, mm.

    Attributes:
        points: the points of the fit.
        dense: all that is left of the breast before thinning: where there are data.
        steps: what each step took.
    """

    points: Float[np.ndarray, "n 3"]
    dense: Float[np.ndarray, "m 3"]
    steps: Cleaning


@dataclass(frozen=True)
class Tidy:
    """A cloud without doubles and outliers: the points, their flags, the surface where it is known, the counts of what
    was taken, and the points that were taken because they lie on no surface.
    """

    points: Float[np.ndarray, "n 3"]
    inside: Bool[np.ndarray, " n"]
    surface: Surface | None
    duplicates: int = 0
    outliers: int = 0
    off_surface: int = 0
    islands: int = 0
    thinned: int = 0
    removed: Float[np.ndarray, "r 3"] = field(default_factory=lambda: np.empty((0, 3)))


def clean(
    points: Float[np.ndarray, "n 3"],
    inside: Bool[np.ndarray, " n"] | None = None,
    *,
    count: int | None = 2000,
    outliers: float | None = 3.0,
    neighbours: int = 16,
) -> tuple[Float[np.ndarray, "m 3"], Cleaning]:
    """Clean and thin a cloud (cup frame, millimetres): `tidy`, then `finish` by the flag.

    Args:
        points: in any order; repeated ones count once.
        inside: the cloud's flag; None: there is none, and all points are kept.
        count: points at most; None: all.
        outliers: see `tidy`; None: only repeated points go.
        neighbours: see `tidy`.

    Raises:
        ConfigError: a setting out of its range.
    """
    check_settings(count, outliers, neighbours)
    cleaned = finish(tidy(points, inside, outliers=outliers, neighbours=neighbours), count=count)
    return cleaned.points, cleaned.steps


def tidy(
    points: Float[np.ndarray, "n 3"],
    inside: Bool[np.ndarray, " n"] | None = None,
    *,
    outliers: float | None = 3.0,
    neighbours: int = 16,
    dense: int = DENSE,
) -> Tidy:
    """Take out what is no part of the surface. The result is sorted, and the same for every order of the input.

    Outliers are sought among all points, so that the rim of the breast has its neighbours from the margin.

    Args:
        points: the cloud, z towards the front, mm.
        inside: its flag; None: it has none.
        outliers: a point goes when its mean distance to its neighbours exceeds the cloud's mean of it by this many
            standard deviations; None keeps all points but repeated ones.
        neighbours: the number of neighbours for that.
        dense: clouds of more points are averaged in voxels first, if they have no flag.
    """
    points, flag, duplicates = _distinct_flagged(points, inside)
    counts = {"duplicates": duplicates, "thinned": 0}
    if inside is None and len(points) > dense:
        distinct_points = len(points)
        points = averaged(points, dense)
        flag, counts["thinned"] = np.ones(len(points), dtype=bool), distinct_points - len(points)
    if outliers is None or len(points) <= NEIGHBOURS:
        return Tidy(points, flag, None, counts["duplicates"], thinned=counts["thinned"])
    known = Neighbours.of(points, max(NEIGHBOURS, neighbours + 1))
    kept = inliers(known, neighbours, outliers)
    known, _ = known.among(kept)
    alone = lonely(known, neighbours)
    known, _ = known.among(~alone)
    kept[kept] = ~alone
    counts["outliers"], removed = int((~kept).sum()), [points[~kept]]
    points, flag = points[kept], flag[kept]
    kept, known = on_surface(known)
    counts["off_surface"] = int((~kept).sum())
    removed.append(points[~kept])
    points, flag = points[kept], flag[kept]
    if len(points) <= NEIGHBOURS:
        return Tidy(points, flag, None, **counts, removed=np.concatenate(removed))
    surface = surface_of(points, np.array([0.0, 0.0, 1.0]), known)
    part, sizes = parts(links(surface))
    kept = sizes[part] >= ISLAND * sizes[0]
    counts["islands"] = int((~kept).sum())
    removed.append(points[~kept])
    return Tidy(points[kept], flag[kept], surface.select(kept), **counts, removed=np.concatenate(removed))


def distinct(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """The points sorted by x, y, z, each once."""
    points = points[np.lexsort(points.T[::-1])]
    return points[_new(points)]


def _new(points: np.ndarray) -> Bool[np.ndarray, " n"]:
    """Which of sorted points differ from the one before."""
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[1:] != points[:-1]).any(axis=1)
    return new


def _distinct_flagged(points: np.ndarray, inside: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, int]:
    """Sorted distinct points, whether they are inside, and how many repeated another. A point is inside if one of its
    repetitions is.
    """
    order = np.lexsort(points.T[::-1])
    points = points[order]
    new = _new(points)
    group = np.cumsum(new) - 1
    flag = np.ones(int(new.sum()), dtype=bool)
    if inside is not None:
        flag = np.bincount(group, weights=inside[order], minlength=len(flag)) > 0
    return points[new], flag, int((~new).sum())


def finish(
    tidied: Tidy,
    curve: Float[np.ndarray, "k 3"] | None = None,
    *,
    count: int | None = 2000,
    not_finite: int = 0,
    elsewhere: int = 0,
    other_side: int = 0,
) -> Cleaned:
    """The breast's points of a tidied cloud, thinned to `count` (see `thin`).

    Args:
        tidied: the cloud, from `tidy`.
        curve: the closed curve of wire and neckline to cut along; None: nothing but the flag decides.
        count: points at most; None: all.
        not_finite: points that reading left out, for the counts.
        elsewhere: points far from the breast that were left out before, for the counts.
        other_side: how many of the points were added to those that were read.
    """
    chosen = tidied.inside
    if curve is not None:
        surface = tidied.surface or surface_of(tidied.points, np.array([0.0, 0.0, 1.0]))
        chosen = chosen & crop(surface, curve)[0]
    breast = tidied.points[chosen]
    thinned, voxel = thin(breast, count)
    taken = tidied.duplicates + tidied.outliers + tidied.off_surface + tidied.islands + tidied.thinned
    steps = Cleaning(
        read=len(tidied.points) + taken + not_finite + elsewhere - other_side,
        other_side=other_side,
        not_finite=not_finite,
        elsewhere=elsewhere,
        duplicates=tidied.duplicates,
        outliers=tidied.outliers,
        off_surface=tidied.off_surface,
        islands=tidied.islands,
        outside=int((~chosen).sum()),
        thinned=tidied.thinned + len(breast) - len(thinned),
        used=len(thinned),
        voxel_mm=voxel,
        scatter_mm=None if tidied.surface is None or not len(breast) else _scatter(tidied.surface, breast),
    )
    return Cleaned(thinned, breast, steps)


def _scatter(surface: Surface, breast: np.ndarray) -> float:
    level = places = breast[:: max(1, len(breast) // SCATTER_PLACES)]
    for _ in range(4):  # the points nearest to a stray one share its error: step by step towards the middle
        level, _ = settle(surface, level, max(SCATTER_RADIUS, 3 * surface.spacing))
    return float(np.sqrt(np.mean(((places - level) ** 2).sum(axis=1))))


def inliers(known: Neighbours, neighbours: int, deviations: float) -> Bool[np.ndarray, " n"]:
    """Mask of the points that statistical outlier removal keeps, as Open3D does it.

    Args:
        known: the neighbours of each point, at least `neighbours` of them, itself included.
        neighbours: as many as the mean distance is taken of.
        deviations: above the cloud's mean of that at which a point goes.
    """
    distance = known.distances[:, : min(neighbours, known.count)].mean(axis=1)
    return distance <= distance.mean() + deviations * distance.std(ddof=1)


def lonely(known: Neighbours, neighbours: int) -> Bool[np.ndarray, " n"]:
    """Mask of points whose mean distance to their neighbours is LONELY times the median of it.

    Where strays are many they spread the statistics by which `inliers` judges; the median stays that of the surface.

    Args:
        known: the neighbours of each point, at least `neighbours` and itself.
        neighbours: as many as the mean is taken of.
    """
    distance = known.distances[:, 1 : min(neighbours + 1, known.count)].mean(axis=1)
    return distance > LONELY * np.median(distance)


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


def check_settings(count: int | None, outliers: float | None, neighbours: int) -> None:
    """Refuse settings out of their range with a ConfigError."""
    if count is not None and count < 10:
        raise ConfigError(f"scan.points: {count}, but at least 10 are needed (null: all points)")
    if outliers is not None and not outliers > 0:
        raise ConfigError(f"scan.outliers: {outliers}, but it must be above 0 (null: keep all points)")
    if neighbours < 2:
        raise ConfigError(f"scan.neighbours: {neighbours}, but at least 2 are needed")
