"""A breast in its cup frame: its wire, given or found, and what else is marked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from brafit.anatomy.confidence import Confidence
from brafit.cloud.read import Cloud
from brafit.errors import InputError, WrongWayError
from brafit.landmarks.cup_frame import END_TOLERANCE, CupFrame, frame_from_wire, from_inner_end, runs_backwards
from brafit.landmarks.file import SIDES, Landmarks
from brafit.landmarks.plausibility import check_scan
from brafit.scan.marked import Marked
from brafit.scan.wiring import Wiring


@dataclass(frozen=True, eq=False)
class Framed:
    """One breast's marks and its cup frame.

    Attributes:
        marks: in the scan's frame, mm, with a wire.
        marks_origin: `given`, `mirrored` or `proposed`.
        wire_origin: `given`, `mirrored`, `proposed`, `detected` or `size NAME`.
        guessed: share of the wire that no crease shows; None for one that is not found.
        frame: the cup frame.
        wire: in the cup frame, inner end first.
        confidence: how far marks can be trusted that nobody looked at; None for given ones.
        own_wire: the wire line that the scan has itself, where a wire of a size is laid instead; in the scan's frame.
        lengths: see `Wired`.
        turned: the wire was given from its outer end; `marks` have it from the inner.
        away: how far lines and marked points that are given lie from the cloud, see `check_scan`.
    """

    marks: Landmarks
    marks_origin: str
    wire_origin: str
    guessed: float | None
    frame: CupFrame
    wire: Float[np.ndarray, "k 3"]
    turned: bool
    confidence: Confidence | None = None
    own_wire: Float[np.ndarray, "j 3"] | None = None
    lengths: Mapping[str, float] = field(default_factory=dict)
    away: Mapping[str, float] = field(default_factory=dict)

    def mark(self, name: str) -> Float[np.ndarray, "3"] | None:
        """A marked point in the cup frame, if there is one."""
        point = self.marks.points.get(name)
        return None if point is None else self.frame.to_cup(point)

    def upper_line(self) -> Float[np.ndarray, "m 3"] | None:
        """The marked upper line in the cup frame, from the wire's inner to its outer end.

        Raises:
            InputError: it does not end at the wire's ends.
        """
        if self.marks.upper_line is None:
            return None
        line = self.frame.to_cup(self.marks.upper_line)
        ways = (line, line[::-1].copy())
        ends = self.wire[[0, -1]]
        first, other = (float(np.linalg.norm(way[[0, -1]] - ends, axis=1).max()) for way in ways)
        if min(first, other) > END_TOLERANCE:
            cause = f"upper_line: its ends are up to {min(first, other):.1f} mm from the ends of the wire"
            remedy = f"Let it start and end at the wire's ends (within {END_TOLERANCE:g} mm)"
            raise InputError(self.marks.path, cause, remedy)
        return ways[0] if first <= other else ways[1]


def framed(wiring: Wiring, side: str | None) -> Framed:
    """A side's breast in its cup frame.

    Args:
        wiring: the cloud with the marks of one or both breasts, and which wire they get.
        side: `left` or `right`; None: the one that is marked first.

    Raises:
        InputError: marks that cannot be those of a breast on this cloud; no wire, and none can be found.
    """
    marked = wiring.marked
    marks, marks_origin = marked.of(side)
    confidence = marked.confidence(marks, marks_origin)
    away = check_scan(marked.cloud, marks)
    own = marks.wire if wiring.wire not in (None, "detect") else None
    wired = wiring.of(marks, marks_origin)
    marks, turned = inner_end_first(marked, wired.marks)
    frame = frame_of(marked.cloud, marks)
    return Framed(
        marks=marks,
        marks_origin=marks_origin,
        wire_origin=wired.origin,
        guessed=wired.guessed,
        frame=frame,
        wire=frame.to_cup(_line(marks)),
        turned=turned,
        confidence=confidence,
        own_wire=own,
        lengths=wired.lengths,
        away=away if marks_origin == "given" else {},
    )


def frame_of(cloud: Cloud, marks: Landmarks) -> CupFrame:
    """The cup frame of marks that have a wire.

    Args:
        cloud: with the flag of its points, if there is one.
        marks: with a wire, its inner end first.

    Raises:
        InputError: the wire is no bow, does not end at the marked ends, or runs the wrong way round for its side.
    """
    line = _line(marks)
    _check_outer_end(line, marks)
    try:
        return frame_from_wire(line, marks.side, _front(cloud, marks), marks.path)
    except WrongWayError as error:
        remedy = error.remedy
        if {"inner_end", "outer_end"} <= marks.points.keys():
            other = SIDES[1 - SIDES.index(marks.side)]
            remedy = (
                f'The side is probably wrong: write "{other}", or exchange inner_end and outer_end, if they are swapped'
            )
            remedy = f"{remedy} (the inner end is the one towards the other breast)"
        if marks.upper_line is not None and not {"strap_point", "wire_bottom"} & marks.points.keys():
            remedy = f"{remedy}, or exchange wire and upper_line, if each stands in the other's place"
        raise WrongWayError(error.file, error.cause, remedy) from None


def inner_end_first(marked: Marked, marks: Landmarks) -> tuple[Landmarks, bool]:
    """Marks whose wire runs from its inner to its outer end, and whether it was turned for that.

    The marked ends say which is which; where none is marked the file's side does, and on a torso the end that is nearer
    to the body's middle. Arrays may be a scan's own, in the cup frame, where right breasts are mirrored: of them the
    side is wrong.

    Args:
        marked: the cloud with the marks of one or both breasts.
        marks: of the breast, with a wire.

    Raises:
        InputError: the wire is no bow, or does not end at the marked inner end.
    """
    assert marks.wire is not None
    line = from_inner_end(marks.wire, marks.points.get("inner_end"), marks.path, marks.points.get("outer_end"))
    turned = line is not marks.wire
    if marks.path.is_file() and not ({"inner_end", "outer_end"} & marks.points.keys()):
        turned = runs_backwards(line, marks.side, _front(marked.cloud, marks), marks.path)
        turned = turned and not (marked.whole.is_torso and _starts_nearer_the_middle(line, marked))
        line = line[::-1].copy() if turned else line
    return (replace(marks, wire=line), True) if turned else (marks, False)


def _starts_nearer_the_middle(line: np.ndarray, marked: Marked) -> bool:
    """Whether a torso's plane of symmetry is nearer to a line's start than to its end."""
    ends = line[[0, -1]]
    first, last = np.linalg.norm(marked.whole.mirror(ends) - ends, axis=1)
    return bool(first < last)


def _line(marks: Landmarks) -> np.ndarray:
    """The wire from its inner to its outer end."""
    assert marks.wire is not None
    return from_inner_end(marks.wire, marks.points.get("inner_end"), marks.path)


def _check_outer_end(wire: np.ndarray, marks: Landmarks) -> None:
    outer = marks.points.get("outer_end")
    away = 0.0 if outer is None else float(np.linalg.norm(wire[-1] - outer))
    if away > END_TOLERANCE:
        cause = f"landmarks.outer_end: {away:.1f} mm from the outer end of the wire"
        raise InputError(marks.path, cause, f"Both mark the same point: bring them within {END_TOLERANCE:g} mm")


def _front(cloud: Cloud, marks: Landmarks) -> np.ndarray:
    """A point in front of the chest: the apex, or else the middle of the breast's points."""
    if "apex" in marks.points:
        return marks.points["apex"]
    chosen = cloud.points if cloud.inside is None else cloud.points[cloud.inside]
    return np.median(chosen, axis=0)
