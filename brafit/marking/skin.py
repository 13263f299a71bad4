"""The skin of a scan as a page holds it: every point with a normal and a size, in nine bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int8, UInt8, UInt16
from numpy import ndarray

from brafit.surface.cleaning import lonely
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import on_surface
from brafit.surface.planes import normals_at
from brafit.surface.thinning import averaged, distinct

MOST = 400_000
"""Points that a page holds; of denser scans the averages of small cells are taken, so that no point of the scan is far
from one of the page. Eight bytes each, a third more as text: 4.3 MB."""
NEIGHBOURS = 20
"""Of a point, that its normal is taken from."""
DISC = 7
"""A point is shown as a disc that reaches to so many neighbours: then hardly a gap is left between discs."""
SIZES = 32.0
"""Steps of a disc's size to one median size; none is larger than 255 steps."""
SAME_SHEET = 0.7
"""Least cosine between normals of neighbours on one sheet."""
REACH, CORE = 3000.0, 4.0
"""What lies farther from the middle than REACH (mm), or than CORE times the extent of nearly all points, is not shown:
it would make the others coarse."""
STEPS = 65_535
"""Places along the longest side of the skin's box: 0.02 mm apart on a body of 1.3 m."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Points of a scan, rounded to a grid.

    Attributes:
        origin: corner of the box that holds them, in the scan's frame, mm.
        step: side of the grid's cells, mm.
        places: multiples of `step` from the origin.
        normals: unit normals to either side, as `octahedral` has them.
        sizes: radius of each point's disc, in steps of `spacing` / SIZES.
        spacing: median radius of the discs, mm.
        of: so many points the scan has.
    """

    origin: Float[ndarray, "3"]
    step: float
    places: UInt16[ndarray, "n 3"]
    normals: Int8[ndarray, "n 2"]
    sizes: UInt8[ndarray, " n"]
    spacing: float
    of: int

    @property
    def points(self) -> Float[ndarray, "n 3"]:
        """The points as the page has them, in the scan's frame, mm."""
        return self.origin + self.step * self.places

    def records(self) -> bytes:
        """Eight bytes a point (three unsigned shorts of place, little-endian, two signed bytes of normal); then the
        sizes, a byte each.
        """
        rows = np.empty(len(self.places), dtype=[("place", "<u2", 3), ("normal", "i1", 2)])
        rows["place"], rows["normal"] = self.places, self.normals
        return rows.tobytes() + self.sizes.tobytes()


def skin_of(points: Float[ndarray, "n 3"], most: int = MOST) -> Skin:
    """The skin of a scan: without strays, what floats and repeated points. Every beginning of it is an even sample.

    Args:
        points: of the scan, mm.
        most: points that are kept.
    """
    near = distinct(points[_in_reach(points)])
    if len(near) > most:
        near = averaged(near, most)
    known = Neighbours.of(near, NEIGHBOURS)
    known = known.among(_many(~lonely(known, NEIGHBOURS)))[0]
    known = known.among(_many(on_surface(known)[0]))[0]
    normals = _smoothed(normals_at(known.points, known.near[:, :NEIGHBOURS]), known.near[:, :NEIGHBOURS])
    low, high = known.points.min(axis=0), known.points.max(axis=0)
    step = max(float((high - low).max()), 1e-6) / STEPS
    radii = known.distances[:, min(DISC, known.count - 1)]
    spacing = max(float(np.median(radii)), step)
    order = np.random.default_rng(0).permutation(len(known.points))
    return Skin(
        origin=low,
        step=step,
        places=np.rint((known.points[order] - low) / step).astype(np.uint16),
        normals=octahedral(normals[order]),
        sizes=np.clip(np.rint(SIZES * radii[order] / spacing), 1, 255).astype(np.uint8),
        spacing=spacing,
        of=len(points),
    )


def octahedral(normals: Float[ndarray, "n 3"]) -> Int8[ndarray, "n 2"]:
    """Unit vectors as places on an octahedron that is unfolded into a square, -127 to 127; within a degree."""
    flat = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-12)
    sign = np.where(flat[:, :2] >= 0, 1.0, -1.0)
    folded = np.where(flat[:, 2:] < 0, (1 - np.abs(flat[:, 1::-1])) * sign, flat[:, :2])
    return np.rint(127 * folded).astype(np.int8)


def _smoothed(normals: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Means of the neighbours' normals, turned to the side of each own one; of other sheets none is taken."""
    sums = np.zeros_like(normals)
    for column in near.T:
        other = normals[column]
        cosine = (other * normals).sum(axis=1)
        sums += np.where(np.abs(cosine) > SAME_SHEET, np.sign(cosine), 0.0)[:, None] * other
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def _in_reach(points: np.ndarray) -> np.ndarray:
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return away <= min(REACH, CORE * float(np.quantile(away, 0.9)))


def _many(kept: np.ndarray) -> np.ndarray:
    """The mask, or all, where it leaves hardly anything."""
    return kept if kept.mean() > 0.5 else np.ones_like(kept)
