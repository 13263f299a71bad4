"""Weights of points by the surface that each stands for."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from brafit.geometry.polyline import nearest_on
from brafit.surface.neighbours import tree_of

NEIGHBOURS = 16
"""Neighbours that bound a point's cell."""
RAYS = 32
"""Directions in which a cell is measured."""
WIDE, OPEN = 2.0, 1.0
"""How far a cell reaches where no neighbour bounds it, in spacings of the cloud: where wire and neckline bound it, and
where nothing says how far the breast goes."""
MOST = 4.0
"""Largest area of a cell, over the median: a stray point on the far side of a hole must not rule."""
_CHUNK = 8192


def point_weights(
    points: Float[np.ndarray, "n 3"], curve: Float[np.ndarray, "k 3"] | None = None, spacing: float | None = None
) -> Float[np.ndarray, " n"]:
    """The share of the surface that each point stands for; they sum to 1.

    So the mean over the points is one over the surface, however densely its parts were seen; and the points at the edge
    of a hole stand for part of it, instead of leaving it to whatever is cheapest.

    Args:
        points: in any unit, on a surface.
        curve: the closed curve that bounds the surface, if there is one.
        spacing: of the points, from `spacing_of`, if it is known.
    """
    if len(points) <= NEIGHBOURS:
        return np.full(len(points), 1 / max(len(points), 1))
    area = cell_areas(points, curve, spacing)
    median = float(np.median(area))
    if median == 0:
        return np.full(len(points), 1 / len(points))
    weights = np.minimum(area / median, MOST)
    return weights / weights.sum()


def cell_areas(
    points: Float[np.ndarray, "n 3"], curve: Float[np.ndarray, "k 3"] | None = None, spacing: float | None = None
) -> Float[np.ndarray, " n"]:
    """Areas of the cells into which points (more than NEIGHBOURS) divide the surface that they lie on.

    A cell is what lies nearer to its point than to any other, measured in the plane of the neighbours, so that noise
    across it does not count. Along a direction u it ends at min |f|^2 / (2 f.u) over the neighbours at f, or at WIDE or
    OPEN spacings. The mirror images of points in the curve are neighbours too, so that cells end at the curve.
    """
    reach = (OPEN if curve is None else WIDE) * (spacing_of(points) if spacing is None else spacing)
    alone = np.ones(len(points))
    every = points
    if curve is not None:
        line = np.append(curve, curve[:1], axis=0)
        longest = float(np.linalg.norm(np.diff(line, axis=0), axis=1).max())
        close = KDTree(curve).query(points, distance_upper_bound=reach + longest)[0] < np.inf
        foot = np.full_like(points, np.inf)  # of points that are far from the curve nobody asks
        foot[close] = nearest_on(points[close], line)
        away = np.linalg.norm(points - foot, axis=1)
        near = (away < reach) & (away > 0)
        alone[away == 0] = 0.5  # such a point is its own image: half of its cell lies outside
        every = np.concatenate([points, (2 * foot - points)[near]])
    tree = tree_of(every)
    angle = np.arange(RAYS) * (2 * np.pi / RAYS)
    rays = np.stack([np.cos(angle), np.sin(angle)])
    area = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        near = np.asarray(tree.query(points[part], k=NEIGHBOURS + 1)[1])
        offset = every[near] - points[part, None]
        spread = offset - offset.mean(axis=1, keepdims=True)
        axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))[1][:, :, 1:]
        flat = offset @ axes
        square = (flat[..., 0] ** 2 + flat[..., 1] ** 2)[..., None]
        pull = np.divide(2 * flat, square, out=np.zeros_like(flat), where=square > 0)
        bound = (pull.reshape(-1, 2) @ rays).reshape(*pull.shape[:2], RAYS)
        area[part] = (1 / np.maximum(bound.max(axis=1), 1 / max(reach, 1e-12)) ** 2).sum(axis=1)
    return area * alone * (np.pi / RAYS)


def spacing_of(points: Float[np.ndarray, "n 3"]) -> float:
    """Typical distance of an evenly spread cloud's points to the nearest six."""
    count = min(7, len(points))
    return float(np.median(np.asarray(tree_of(points).query(points, k=count)[0])[:, 1:].mean(axis=1)))
