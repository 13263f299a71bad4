"""The points that a breast is cut out of: its part of a torso, and the other breast's where the two are alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from brafit.cloud.read import MIN_POINTS
from brafit.errors import InputError
from brafit.geometry.polyline import polyline_length
from brafit.landmarks.cup_frame import CupFrame
from brafit.landmarks.file import Landmarks
from brafit.landmarks.plausibility import is_one_breast
from brafit.scan.framed import Framed, frame_of, inner_end_first
from brafit.scan.marked import Marked
from brafit.surface.cleaning import Tidy, tidy
from brafit.surface.symmetry import ALIKE, Mirror, breasts_apart

REGION, MARGIN = 0.8, 40.0
"""Points are left out if they lie farther from the middle of the wire than REGION wire lengths, and more than MARGIN mm
farther than the upper line. Breasts with their edge lie within 0.62 wire lengths."""
OWN = 1.0
"""A removed place nearer than this (mm) to a point of the scan itself counts as that point, and not as one of the
mirrored breast: averaging in voxels moves points a little."""
DIGITS = 9
"""Digits after the point that coordinates (mm) keep in the cup frame, so that nothing later depends on the last digits
of a transformation."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """The tidied points about a breast, in its cup frame.

    Attributes:
        tidied: the points.
        whole: they are part of more than one breast and its margin.
        elsewhere: points of the scan that were left out, far from the breast.
        other_side: points of the other breast that were added.
        alike: rms (mm) between the two breasts, if the points of both were taken.
    """

    tidied: Tidy
    whole: bool = False
    elsewhere: int = 0
    other_side: int = 0
    alike: float | None = None


@dataclass(frozen=True, eq=False)
class Gathering:
    """Gathers the points about the breasts of one scan; what both sides need is found once.

    Attributes:
        marked: the scan.
        outliers, neighbours: see `tidy`.
        symmetry: take the points of both breasts of a torso for either one, where they are alike.
    """

    marked: Marked
    outliers: float | None
    neighbours: int
    symmetry: bool

    def about(self, breast: Framed) -> Gathered:
        """The points about a breast."""
        cloud = self.marked.cloud
        if cloud.inside is not None or is_one_breast(cloud.points, breast.frame.to_scan(breast.wire)):
            return Gathered(self._tidied(_grid(breast.frame.to_cup(cloud.points)), cloud.inside))
        both = self._of_reference if self._reference is not None else self._both(breast.frame, breast.marks)
        if both is not None:
            return both.about(breast, self.marked)
        region = _Region.of(breast.marks)
        near = _grid(breast.frame.to_cup(cloud.points[region.holds(cloud.points)]))
        return Gathered(self._tidied(near), whole=True, elsewhere=len(cloud.points) - len(near))

    @cached_property
    def _reference(self) -> tuple[CupFrame, Landmarks] | None:
        """The breast that is marked (first), if its wire is: in its frame both sides are gathered."""
        marks = self.marked.breasts[0]
        if marks.wire is None:
            return None
        try:
            marks, _ = inner_end_first(self.marked, marks)
            return frame_of(self.marked.cloud, marks), marks
        except InputError:  # it may be the other breast that is wanted
            return None

    @cached_property
    def _of_reference(self) -> _Both | None:
        return None if self._reference is None else self._both(*self._reference)

    def _both(self, frame: CupFrame, marks: Landmarks) -> _Both | None:
        """The points of both breasts in the frame of one, if the two are alike."""
        points = self.marked.cloud.points
        if not (self.symmetry and self.marked.whole.has_middle):
            return None
        region = _Region.of(marks)
        own, other = region.holds(points), region.mirrored(self.marked.whole.mirror).holds(points)
        if other.sum() < MIN_POINTS:
            return None
        one = _grid(frame.to_cup(points[own]))
        image = _grid(frame.to_cup(self.marked.whole.mirror(points[other])))
        rms = breasts_apart(one, image, frame.to_cup(region.middle), region.length, self.outliers, self.neighbours)
        if rms >= ALIKE:
            return None
        return _Both(frame, marks.side, own, other, self._tidied(np.concatenate([one, image])), rms)

    def _tidied(self, points: np.ndarray, inside: np.ndarray | None = None) -> Tidy:
        return tidy(points, inside, outliers=self.outliers, neighbours=self.neighbours)


@dataclass(frozen=True, eq=False)
class _Both:
    """The tidied points of both breasts in the cup frame of one.

    Attributes:
        frame, side: of the one.
        own, other: masks of the scan's points about it, and about the other breast.
        tidied: both together, the other's mirrored.
        rms: mm between the two.
    """

    frame: CupFrame
    side: str
    own: Bool[np.ndarray, " n"]
    other: Bool[np.ndarray, " n"]
    tidied: Tidy
    rms: float

    def about(self, breast: Framed, marked: Marked) -> Gathered:
        """The same in the frame of a breast, one or the other."""
        same = breast.marks.side == self.side
        own, other = (self.own, self.other) if same else (self.other, self.own)

        def moved(points: np.ndarray) -> np.ndarray:
            points = self.frame.to_scan(points)
            return _grid(breast.frame.to_cup(points if same else marked.whole.mirror(points)))

        tidied = self.tidied if same and breast.frame.equals(self.frame) else _moved(self.tidied, moved)
        mine = _grid(breast.frame.to_cup(marked.cloud.points[own]))
        return Gathered(
            replace(tidied, removed=_own(tidied.removed, mine)),
            whole=True,
            elsewhere=len(own) - len(mine),
            other_side=int(other.sum()),
            alike=self.rms,
        )


@dataclass(frozen=True, eq=False)
class _Region:
    """A ball about a breast in the scan's frame, and its wire's length."""

    middle: Float[np.ndarray, "3"]
    radius: float
    length: float

    @staticmethod
    def of(marks: Landmarks) -> _Region:
        assert marks.wire is not None
        middle, length = marks.wire.mean(axis=0), polyline_length(marks.wire)
        lines = [line for line in (marks.upper_line, marks.points.get("strap_point")) if line is not None]
        farthest = max((float(np.linalg.norm(line - middle, axis=-1).max()) for line in lines), default=0.0)
        return _Region(middle, max(REGION * length, farthest + MARGIN), length)

    def mirrored(self, mirror: Mirror) -> _Region:
        return replace(self, middle=mirror(self.middle))

    def holds(self, points: np.ndarray) -> np.ndarray:
        return ((points - self.middle) ** 2).sum(axis=1) < self.radius**2


def _moved(tidied: Tidy, motion: Callable[[np.ndarray], np.ndarray]) -> Tidy:
    """The same points in another frame."""
    surface, points = tidied.surface, motion(tidied.points)
    if surface is not None:
        turn = motion(np.eye(3)) - motion(np.zeros(3))
        surface = surface.at(points, surface.normals @ turn)
    return replace(tidied, points=points, removed=motion(tidied.removed), surface=surface)


def _grid(points: np.ndarray) -> np.ndarray:
    return np.round(points, DIGITS)


def _own(removed: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Those of the removed places that stand for points of the scan itself, not of its mirror image."""
    return removed[KDTree(points).query(removed)[0] < OWN] if len(removed) else removed
