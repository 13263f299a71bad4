"""From a raw cloud to the points of the fit: outliers out, the breast only, evenly thinned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from brafit.errors import ConfigError
from brafit.scan.engine import open3d

SURPLUS, SLACK = 1.2, 1.25
"""Occupied voxels, over the points wanted: what is aimed at and what will do. The excess is what crowded points are
taken out of: the means of neighbouring voxels can lie close together."""


@dataclass(frozen=True)
class Cleaning:
    """How many points each step took.

    Attributes:
        read: points in the file.
        outliers: removed as statistical outliers.
        outside: of the rest, not flagged `inside` (0 for a cloud without the flag).
        used: points of the fit.
        voxel_mm: edge of the voxels in which points were averaged; 0 where all points are used.
    """

    read: int
    outliers: int
    outside: int
    used: int
    voxel_mm: float


def clean(
    points: Float[np.ndarray, "n 3"],
    inside: Bool[np.ndarray, " n"] | None = None,
    *,
    count: int | None = 2000,
    outliers: float | None = 3.0,
    neighbours: int = 16,
) -> tuple[Float[np.ndarray, "m 3"], Cleaning]:
    """Clean and thin a cloud (millimetres).

    Outliers are sought among all points, so that the rim of the breast has its neighbours from the margin; then the
    points flagged `inside` are taken and thinned. The result is sorted, and the same for every order of the input.

    Args:
        points, inside: the cloud and its flag.
        count: points wanted; None for all. See `thin`.
        outliers: a point goes when its mean distance to its neighbours exceeds the cloud's mean of it by this many
            standard deviations; None keeps all.
        neighbours: the number of neighbours for that.

    Raises:
        ConfigError: a setting out of its range.
    """
    _check_settings(count, outliers, neighbours)
    flag = np.ones(len(points), dtype=bool) if inside is None else inside
    order = np.lexsort((flag, *points.T[::-1]))
    points, flag = points[order], flag[order]
    kept = np.ones(len(points), dtype=bool) if outliers is None else inliers(points, neighbours, outliers)
    chosen = points[kept & flag]
    thinned, voxel = thin(chosen, count)
    return thinned, Cleaning(
        read=len(points),
        outliers=int((~kept).sum()),
        outside=int((kept & ~flag).sum()),
        used=len(thinned),
        voxel_mm=voxel,
    )


def inliers(points: Float[np.ndarray, "n 3"], neighbours: int, deviations: float) -> Bool[np.ndarray, " n"]:
    """Mask of the points that Open3D's statistical outlier removal keeps."""
    _, mask = _cloud(points).remove_statistical_outliers(neighbours, deviations)
    return mask.numpy().astype(bool)


def thin(points: Float[np.ndarray, "n 3"], count: int | None) -> tuple[Float[np.ndarray, "m 3"], float]:
    """At most `count` points, evenly spread, and the voxel edge used.

    Points in a voxel are replaced by their mean; the voxel edge is sought so that a fifth more voxels are occupied than
    points wanted, and of these the most crowded go (`uncrowd`). So exactly `count` points come back, or all distinct
    ones where there are no more. Sorted; independent of the input's order.
    """
    points = np.unique(points, axis=0)
    if count is None or len(points) <= count:
        return points, 0.0
    voxel, averaged = _voxel_for(points, count)
    return averaged[uncrowd(averaged, count)], voxel


def uncrowd(points: Float[np.ndarray, "n 3"], count: int) -> Bool[np.ndarray, " n"]:
    """Mask of `count` evenly spread points of a cloud.

    Points are taken out one by one: of the closest pair, the one with the nearer third point.
    """
    alive = np.ones(len(points), dtype=bool)
    if len(points) <= count:
        return alive
    distances, near = (np.asarray(found)[:, 1:] for found in KDTree(points).query(points, k=min(17, len(points))))
    nearest, closest = near[:, 0].copy(), distances[:, 0].copy()
    for _ in range(len(points) - count):
        first = int(np.argmin(closest))
        pair = (first, int(nearest[first]))
        third = [np.append(distances[k][alive[near[k]]], [np.inf, np.inf])[1] for k in pair]
        gone = pair[0] if third[0] < third[1] else pair[1]
        alive[gone], closest[gone] = False, np.inf
        for k in np.flatnonzero(alive & (nearest == gone)):
            left = np.flatnonzero(alive[near[k]])
            # All 16 neighbours gone: so lonely by now that it stays.
            nearest[k], closest[k] = (near[k, left[0]], distances[k, left[0]]) if len(left) else (-1, np.inf)
    return alive


def _voxel_for(points: np.ndarray, count: int) -> tuple[float, np.ndarray]:
    """A voxel edge that leaves some more points than `count`, and these points; 0 and all points if there are few."""
    wanted = SURPLUS * count
    if len(points) <= wanted:
        return 0.0, points
    cloud = _cloud(points)
    coarse = float(np.linalg.norm(np.ptp(points, axis=0)))
    fine, best = 0.0, points
    for _ in range(60):
        # Geometric bisection; until a fine enough edge is known, a jump down.
        edge = float(np.sqrt(fine * coarse)) if fine else coarse / 4
        averaged = _averaged(cloud, edge)
        if len(averaged) < wanted:
            coarse = edge
            continue
        fine, best = edge, averaged
        if len(averaged) <= SLACK * count or coarse / fine < 1 + 1e-6:
            break
    return fine, best


def _averaged(cloud: Any, edge: float) -> np.ndarray:
    return np.unique(cloud.voxel_down_sample(edge).point.positions.numpy(), axis=0)


def _cloud(points: np.ndarray) -> Any:
    o3d = open3d()
    return o3d.t.geometry.PointCloud(o3d.core.Tensor(np.ascontiguousarray(points)))


def _check_settings(count: int | None, outliers: float | None, neighbours: int) -> None:
    if count is not None and count < 10:
        raise ConfigError(f"scan.points: {count}, but at least 10 are needed (null: all points)")
    if outliers is not None and not outliers > 0:
        raise ConfigError(f"scan.outliers: {outliers}, but it must be above 0 (null: keep all points)")
    if neighbours < 2:
        raise ConfigError(f"scan.neighbours: {neighbours}, but at least 2 are needed")
