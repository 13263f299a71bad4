"""Places between wire and upper line where a scan has no data, and the surface that is assumed there.

A fit that looks at the data only slides into a shadow: nothing there speaks against it. So a gap is bridged, from
its rim and the lines that bound the cup, and the fit sees places on that bridge. They count in no figure.

The breast is seen from a place within it: each direction has a radius. On the chart of directions
(`brafit.surface.directions`) gaps are holes; in them the radius is a spline (kernel r^3, smoother than a thin plate, so
that it goes on as the surface about the gap curves) through the points about them, wire and upper line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from brafit.surface.coverage import spacing_of
from brafit.surface.directions import Chart
from brafit.surface.neighbours import tree_of

GAP = 4.0
"""A gap begins at this distance (mm) from every point, or at SPARSE times the cloud's spacing."""
SPARSE = 2.0
RIM_LEAST, RIM_MOST = 100, 800
"""Points about a gap that its bridge is laid through: at least, and one more for each cell of the gap, at most."""
SMOOTHING = 1e-2
BOUNDS = 0.7
"""A bridge's radius lies between this share of the least about it and the inverse share of the largest."""


@dataclass(frozen=True)
class DataGaps:
    """What a scan does not show of a breast.

    Attributes:
        share: share of the surface between wire and upper line that lies in gaps.
        places: on the surface that is assumed there, as dense as the points of the fit, mm.
        spacing: of the points of the fit, mm (`brafit.surface.coverage.spacing_of`).
    """

    share: float
    places: Float[np.ndarray, "g 3"]
    spacing: float


def gaps(
    points: Float[np.ndarray, "n 3"], dense: Float[np.ndarray, "d 3"], curve: Float[np.ndarray, "k 3"]
) -> DataGaps:
    """The gaps of a breast.

    Args:
        points: of the fit, evenly thinned; mm.
        dense: all of the breast, before thinning: where there are data.
        curve: the closed curve of wire and upper line.
    """
    spacing = spacing_of(points)
    reach = max(GAP, SPARSE * spacing)
    chart = Chart.about(points, curve)
    place, radius = chart.flat(points)
    rim, rim_radius = chart.flat(curve)
    size = float(np.median(radius))
    cells = _within(rim, 0.5 * spacing / size)
    # On the chart distances are about those on the surface over the radius, or less: nothing is overlooked by 0.8.
    away, nearest = tree_of(place).query(cells)
    bare = away >= 0.8 * reach / size
    if not bare.any():
        return DataGaps(0.0, np.empty((0, 3)), spacing)
    most = min(RIM_LEAST + int(bare.sum()), RIM_MOST)
    near = np.argsort(KDTree(cells[bare]).query(place)[0], kind="stable")[:most]
    known, values = np.concatenate([place[near], rim]), np.log(np.concatenate([radius[near], rim_radius]))
    spline = RBFInterpolator(*_distinct(known, values), smoothing=SMOOTHING, kernel="cubic")
    low, high = values.min() + np.log(BOUNDS), values.max() - np.log(BOUNDS)
    bridge = chart.space(cells[bare], np.exp(np.clip(spline(cells[bare]), low, high)))
    gap = tree_of(dense).query(bridge)[0] > reach
    surface = chart.space(cells, radius[nearest])
    surface[bare] = bridge
    area = chart.area(cells, np.linalg.norm(surface - chart.centre, axis=1))
    share = float(area[_opened(surface, bridge[gap], reach)].sum() / area.sum())
    return DataGaps(share, _thinned(bridge[gap], spacing), spacing)


def _opened(surface: np.ndarray, inner: np.ndarray, reach: float) -> np.ndarray:
    """Which places lie in gaps, whose inner places are farther than `reach` from all data: these, and all that are
    nearer than that to one of them.
    """
    if not len(inner):
        return np.zeros(len(surface), dtype=bool)
    return KDTree(inner).query(surface, distance_upper_bound=reach)[0] < np.inf


def _within(polygon: np.ndarray, step: float) -> np.ndarray:
    """Places of a square grid within a closed polygon: a ray from them along x crosses an odd number of its sides."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    step = max(step, float((high - low).max()) / 400)
    x, y = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
    start, end = polygon, np.roll(polygon, -1, axis=0)
    side, row = np.nonzero((start[:, 1:] > y) != (end[:, 1:] > y))
    a, b = start[side], end[side]
    crossing = a[:, 0] + (y[row] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    # Each crossing is counted at the first place beyond it, and so by all places before that.
    counts = np.zeros((len(x) + 1, len(y)), dtype=int)
    np.add.at(counts, (np.searchsorted(x, crossing), row), 1)
    i, j = np.nonzero(counts[::-1].cumsum(axis=0)[::-1][1:] % 2)
    return np.stack([x[i], y[j]], axis=1)


def _distinct(places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without repeated places, which a spline cannot have."""
    _, first = np.unique(np.round(places, 6), axis=0, return_index=True)
    first.sort()
    return places[first], values[first]


def _thinned(points: np.ndarray, spacing: float) -> np.ndarray:
    """Means of the points in voxels that leave about this distance to the nearest six."""
    if not len(points):
        return points
    voxel = np.floor(points / (spacing / 1.25)).astype(np.int64)
    _, cell = np.unique(voxel, axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    return np.stack([np.bincount(cell, weights=column) / count for column in points.T], axis=1)
