"""From a raw cloud to the points of the fit: doubles and outliers out, the breast only, evenly thinned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real

import numpy as np
from jaxtyping import Bool, Float

from brafit.errors import ConfigError
from brafit.surface.cropping import crop
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import FRONT, NEIGHBOURS, Surface, links, on_surface, parts, settle, surface_of
from brafit.surface.thinning import averaged, first_of_each, thin

DENSE = 32_000
"""More points than this about a breast add nothing; they are averaged in voxels first."""
SCATTER_PLACES, SCATTER_RADIUS = 500, 6.0
"""Places at which noise is measured, and the radius (mm) of the plane about each."""
LONELY = 3.0
"""A point is on no surface if the mean distance to its neighbours is more than LONELY times the cloud's median."""
ISLAND = 0.05
"""A part that hangs together with nothing else goes if it is smaller than this share of the largest: scanners cut real
surfaces into large parts (shadows) and put small ones where nothing is."""


@dataclass(frozen=True, kw_only=True)
class Cleaning:
    """How many points each step took, 0 where nobody tells; with `used` they add up to `read` and `other_side`.

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
    not_finite: int = 0
    elsewhere: int = 0
    duplicates: int = 0
    outliers: int = 0
    off_surface: int = 0
    islands: int = 0
    outside: int = 0
    thinned: int = 0
    used: int
    voxel_mm: float
    scatter_mm: float | None


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
    """A cloud without doubles and outliers.

    Attributes:
        points: of the cloud, mm.
        inside: their flags.
        surface: that they make up, where it is known.
        taken: how many points each step took, by its name in `Cleaning`.
        removed: the points that were taken because they lie on no surface.
    """

    points: Float[np.ndarray, "n 3"]
    inside: Bool[np.ndarray, " n"]
    surface: Surface | None
    taken: Mapping[str, int]
    removed: Float[np.ndarray, "r 3"] = field(default_factory=lambda: np.empty((0, 3)))


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
    taken = {"duplicates": duplicates}
    if inside is None and len(points) > dense:
        distinct_points = len(points)
        points = averaged(points, dense)
        flag, taken["thinned"] = np.ones(len(points), dtype=bool), distinct_points - len(points)
    if outliers is None or len(points) <= NEIGHBOURS:
        return Tidy(points, flag, None, taken)
    known = Neighbours.of(points, max(NEIGHBOURS, neighbours + 1))
    kept = inliers(known, neighbours, outliers)
    known, _ = known.among(kept)
    alone = lonely(known, neighbours)
    known, _ = known.among(~alone)
    kept[kept] = ~alone
    taken["outliers"], removed = int((~kept).sum()), [points[~kept]]
    points, flag = points[kept], flag[kept]
    kept, known = on_surface(known)
    taken["off_surface"] = int((~kept).sum())
    removed.append(points[~kept])
    points, flag = points[kept], flag[kept]
    if len(points) <= NEIGHBOURS:
        return Tidy(points, flag, None, taken, np.concatenate(removed))
    surface = surface_of(points, FRONT, known)
    part, sizes = parts(links(surface))
    kept = sizes[part] >= ISLAND * sizes[0]
    taken["islands"] = int((~kept).sum())
    removed.append(points[~kept])
    return Tidy(points[kept], flag[kept], surface.select(kept), taken, np.concatenate(removed))


def _distinct_flagged(points: np.ndarray, inside: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, int]:
    """Sorted distinct points, whether they are inside, and how many repeated another. A point is inside if one of its
    repetitions is.
    """
    order = np.lexsort(points.T[::-1])
    points = points[order]
    new = first_of_each(points)
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
        surface = tidied.surface or surface_of(tidied.points, FRONT)
        chosen = chosen & crop(surface, curve)[0]
    breast = tidied.points[chosen]
    thinned, voxel = thin(breast, count)
    taken = Counter(tidied.taken)
    taken.update(not_finite=not_finite, elsewhere=elsewhere)
    taken.update(outside=int((~chosen).sum()), thinned=len(breast) - len(thinned))
    steps = Cleaning(
        read=len(thinned) + taken.total() - other_side,
        other_side=other_side,
        used=len(thinned),
        voxel_mm=voxel,
        scatter_mm=None if tidied.surface is None or not len(breast) else _scatter(tidied.surface, breast),
        **taken,
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


def check_settings(count: int | None, outliers: float | None, neighbours: int) -> None:
    """Refuse settings that are no numbers or out of their range with a ConfigError."""
    for name, value in (("points", count), ("outliers", outliers), ("neighbours", neighbours)):
        if not isinstance(value, Real | None) or isinstance(value, bool):
            raise ConfigError(f"scan.{name}: {value!r}, but it must be a number")
    if count is not None and count < 10:
        raise ConfigError(f"scan.points: {count}, but at least 10 are needed (null: all points)")
    if outliers is not None and not outliers > 0:
        raise ConfigError(f"scan.outliers: {outliers}, but it must be above 0 (null: keep all points)")
    if neighbours < 2:
        raise ConfigError(f"scan.neighbours: {neighbours}, but at least 2 are needed")
