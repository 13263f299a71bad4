"""The wire of a breast that is marked without one or is to have another: found in the crease, or of a size, laid there.

Breasts that are mirror images have wires that are, too: the mean of what is found on both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from brafit.anatomy.body import Body, body_from_marks
from brafit.anatomy.pair import are_alike, mean_wire
from brafit.anatomy.torso import apex_of, body_of, wire_about
from brafit.anatomy.wire_detection import FoundWire, laid
from brafit.errors import InputError
from brafit.geometry.polyline import polyline_length
from brafit.landmarks.file import SIDES, Landmarks
from brafit.scan.marked import Marked, origin_of
from brafit.underwires.sizes import wire_size

_SIZE = "size "
"""What comes before the name of a size where a wire of one was laid."""
WIRE_POINTS = 151
"""Points of a wire of a given size: enough for their chords to be less than 0.01 mm shorter than the wire."""
IMAGES = 1.0
"""Marks of the two breasts are mirror images if they agree to so much (mm): files round, and find the plane anew."""
GUIDES = ("apex", "inner_end", "outer_end")
"""The marks by which a wire is found."""


@dataclass(frozen=True, eq=False)
class Found:
    """What was found of one breast, in the scan's frame, mm.

    Attributes:
        body: axes by which it was found.
        apex: the bust point, marked or found.
        wire: in the crease, inner end first.
    """

    body: Body
    apex: Float[np.ndarray, "3"]
    wire: FoundWire


@dataclass(frozen=True, eq=False)
class Wired:
    """A breast's marks with a wire.

    Attributes:
        marks: in the scan's frame, mm.
        origin: `given`, `mirrored`, `proposed`, `detected` or `size NAME`.
        guessed: share of the wire that no crease shows; None for one that is not found.
        lengths: by side, mm, of the wires found on breasts that are no mirror images; empty: they are, or it was not
            looked.
    """

    marks: Landmarks
    origin: str
    guessed: float | None = None
    lengths: Mapping[str, float] = field(default_factory=dict)


def size_laid(wire_origin: str) -> str:
    """The size of the wire that was laid, by where a wire comes from; empty where none of a size was."""
    return wire_origin.removeprefix(_SIZE) if wire_origin.startswith(_SIZE) else ""


@dataclass(frozen=True, eq=False)
class Wiring:
    """Gives the breasts of one scan their wires; what both need is found once.

    Attributes:
        marked: the cloud with the marks of one or both breasts.
        wire: None: as it is marked, detected where it is not; `detect`; or a size.
    """

    marked: Marked
    wire: str | None

    def of(self, marks: Landmarks, marks_origin: str) -> Wired:
        """Marks of a side with their wire.

        Args:
            marks: of the side.
            marks_origin: where they are from, see `Marked.of`.

        Raises:
            InputError: there is no wire, and none can be found.
        """
        if self.wire is None and marks.wire is not None:
            return Wired(marks, "mirrored" if marks_origin == "mirrored" else origin_of(marks))
        both = self._both
        found = self._traced(marks) if both is None else both[marks.side]
        apart = {} if both is None or self._alike else both
        lengths = {side: polyline_length(own.wire.line) for side, own in sorted(apart.items())}
        wire, origin = found.wire, "detected"
        if self.wire not in (None, "detect"):
            wire, origin = laid(wire, wire_size(str(self.wire)).line(WIRE_POINTS)), f"{_SIZE}{self.wire}"
        places = {"inner_end": wire.line[0], "outer_end": wire.line[-1], "apex": found.apex}
        upper = _joined(marks.upper_line, wire.line)
        wired = replace(marks, wire=wire.line, upper_line=upper, points={**marks.points, **places})
        return Wired(wired, origin, wire.guessed, lengths)

    @cached_property
    def _first(self) -> Found:
        return self._traced(self.marked.breasts[0])

    @cached_property
    def _alike(self) -> bool:
        """Whether the breasts are mirror images, as far as the first one shows."""
        first, found = self.marked.breasts[0], self._first
        mirror = self.marked.whole.mirror
        return are_alike(self.marked.cloud.points, mirror, found.body, first.side, found.apex, found.wire.line)

    @cached_property
    def _both(self) -> Mapping[str, Found] | None:
        """What is found on both breasts, by side: mirror images, if the breasts are. None where the marks of the two
        are not: each then has what is found by its own.
        """
        images = self._images()
        if images is None:
            return None
        first, other = images
        mirror, one, two = self.marked.whole.mirror, self._first, self._traced(other)
        if not self._alike:
            return {first.side: one, other.side: two}
        wires = [one.wire, replace(two.wire, line=mirror(two.wire.line))]
        mean = replace(one, apex=(one.apex + mirror(two.apex)) / 2, wire=mean_wire(wires))
        image = replace(two, apex=mirror(mean.apex), wire=replace(mean.wire, line=mirror(mean.wire.line)))
        return {first.side: mean, other.side: image}

    def _images(self) -> tuple[Landmarks, Landmarks] | None:
        """The marks of both breasts, if they are mirror images; first those of the breast that was marked first."""
        if not self.marked.whole.has_middle:
            return None
        first = self.marked.breasts[0]
        try:
            other, _ = self.marked.of(SIDES[1 - SIDES.index(first.side)])
        except InputError:  # there is no other breast
            return None
        own, its = ({name: marks.points[name] for name in GUIDES if name in marks.points} for marks in (first, other))
        mirror = self.marked.whole.mirror
        agree = own.keys() == its.keys() and all(
            np.linalg.norm(mirror(place) - its[name]) < IMAGES for name, place in own.items()
        )
        return (first, other) if agree else None

    @cached_property
    def _body(self) -> Body:
        return body_of(self.marked.cloud.points)

    def _traced(self, marks: Landmarks) -> Found:
        """What is found on a side alone."""
        body, apex = self._body_and_apex(marks)
        ends = [marks.points[name] for name in ("inner_end", "outer_end") if name in marks.points]
        both = np.stack(ends) if len(ends) == 2 else None
        return Found(body, apex, wire_about(self.marked.cloud.points, body, marks.side, apex, both))

    def _body_and_apex(self, marks: Landmarks) -> tuple[Body, np.ndarray]:
        """The body's axes, from the whole torso or from the breast's marks, and the apex."""
        inner, outer, apex = (marks.points.get(name) for name in ("inner_end", "outer_end", "apex"))
        bottom, strap = marks.points.get("wire_bottom"), marks.points.get("strap_point")
        if inner is not None and outer is not None and apex is not None and (bottom is not None or strap is not None):
            middle = (inner + outer) / 2
            below = bottom - middle if bottom is not None else middle - np.asarray(strap)
            return body_from_marks(np.stack([inner, outer]), below, apex, marks.side), apex
        if not self.marked.whole.is_torso:
            remedy = "Give wire, or landmarks inner_end, outer_end, apex and strap_point; or scan the whole torso"
            absent = [name for name in ("inner_end", "outer_end", "apex") if name not in marks.points]
            absent += [] if bottom is not None or strap is not None else ["strap_point"]
            cause = f"wire: its place is not given, and without {', '.join(absent)} it is found on a whole torso only"
            raise InputError(marks.path, cause, remedy)
        return self._body, apex_of(self.marked.cloud.points, self._body, marks.side) if apex is None else apex


def _joined(upper: np.ndarray | None, wire: np.ndarray) -> np.ndarray | None:
    """A given upper line with its ends brought to the ends of a wire that was found."""
    if upper is None:
        return None
    flipped = np.linalg.norm(upper[0] - wire[0]) > np.linalg.norm(upper[0] - wire[-1])
    line = upper[::-1].copy() if flipped else upper.copy()
    share = np.linspace(0, 1, len(line))[:, None]
    first, last = np.clip(1 - 3 * share, 0, 1), np.clip(3 * share - 2, 0, 1)
    return line + first * (wire[0] - line[0]) + last * (wire[-1] - line[-1])
