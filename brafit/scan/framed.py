"""A breast in its cup frame: its wire, given or found, and what else is marked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from brafit.anatomy.body import Body, body_from_marks
from brafit.anatomy.confidence import Confidence
from brafit.anatomy.torso import apex_of, body_of, wire_about, wire_laid
from brafit.anatomy.wire_detection import Wire
from brafit.cloud.read import Cloud
from brafit.errors import InputError
from brafit.landmarks.cup_frame import END_TOLERANCE, CupFrame, frame_from_wire, from_inner_end, runs_backwards
from brafit.landmarks.file import Landmarks
from brafit.landmarks.plausibility import check_scan
from brafit.scan.marked import Marked, origin_of
from brafit.underwires.sizes import wire_size

_SIZE = "size "
"""What comes before the name of a size where a wire of one was laid."""
WIRE_POINTS = 151
"""Points of a wire of a given size: enough for their chords to be less than 0.01 mm shorter than the wire."""


@dataclass(frozen=True, eq=False)
class Framed:
    """One breast's marks and its cup frame.

    Attributes:
        marks: in the scan's frame, mm, with a wire.
        marks_origin: `given`, `mirrored` or `proposed`.
        wire_origin: `given`, `proposed`, `detected` or `size NAME`.
        guessed: share of the wire that no crease shows; None for one that is not found.
        frame: the cup frame.
        wire: in the cup frame, inner end first.
        confidence: how far marks can be trusted that nobody looked at; None for given ones.
        own_wire: the wire line that the scan has itself, where a wire of a size is laid instead; in the scan's frame.
        turned: the wire was given from its outer end; `marks` have it from the inner.
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


def framed(marked: Marked, side: str | None, wire: str | None) -> Framed:
    """A side's breast in its cup frame.

    Args:
        marked: the cloud with the marks of one or both breasts.
        side: `left` or `right`; None: the one that is marked first.
        wire: None: as it is marked, detected where it is not; `detect`; or a size.

    Raises:
        InputError: marks that cannot be those of a breast on this cloud; no wire, and none can be found.
    """
    marks, marks_origin = marked.of(side)
    confidence = marked.confidence(marks, marks_origin)
    check_scan(marked.cloud, marks)
    own = marks.wire if wire not in (None, "detect") else None
    marks, wire_origin, guessed = _with_wire(marked, marks, wire)
    marks, turned = inner_end_first(marked, marks)
    frame = frame_of(marked.cloud, marks)
    line = frame.to_cup(_line(marks))
    return Framed(marks, marks_origin, wire_origin, guessed, frame, line, turned, confidence, own)


def size_laid(wire_origin: str) -> str:
    """The size of the wire that was laid, by where a wire comes from; empty where none of a size was."""
    return wire_origin.removeprefix(_SIZE) if wire_origin.startswith(_SIZE) else ""


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
    return frame_from_wire(line, marks.side, _front(cloud, marks), marks.path)


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


def _with_wire(marked: Marked, marks: Landmarks, wire: str | None) -> tuple[Landmarks, str, float | None]:
    """Marks that have a wire, where it comes from and the share of it that is guessed."""
    if wire is None and marks.wire is not None:
        return marks, origin_of(marks), None
    body, apex = _body_and_apex(marked, marks)
    ends = [marks.points.get(name) for name in ("inner_end", "outer_end")]
    both = None if ends[0] is None or ends[1] is None else np.stack([ends[0], ends[1]])
    points = marked.cloud.points
    if wire in (None, "detect"):
        found, origin = wire_about(points, body, marks.side, apex, both), "detected"
    else:
        arc = wire_size(str(wire)).line(WIRE_POINTS)
        found, origin = wire_laid(points, body, marks.side, apex, arc, both), f"{_SIZE}{wire}"
    changes = {"inner_end": found.wire[0], "outer_end": found.wire[-1], "apex": apex}
    upper = _joined(marks.upper_line, found)
    return replace(marks, wire=found.wire, upper_line=upper, points={**marks.points, **changes}), origin, found.guessed


def _body_and_apex(marked: Marked, marks: Landmarks) -> tuple[Body, np.ndarray]:
    """The body's axes, from the whole torso or from the breast's marks, and the apex."""
    inner, outer, apex = (marks.points.get(name) for name in ("inner_end", "outer_end", "apex"))
    bottom, strap = marks.points.get("wire_bottom"), marks.points.get("strap_point")
    if inner is not None and outer is not None and apex is not None and (bottom is not None or strap is not None):
        middle = (inner + outer) / 2
        below = bottom - middle if bottom is not None else middle - np.asarray(strap)
        # The apex lies before the chest, but also below the chord's middle: only what is across counts.
        front = apex - middle
        front = front - (front @ below) / (below @ below) * below
        return body_from_marks(np.stack([inner, outer]), below, front, marks.side), apex
    if not marked.whole.is_torso:
        remedy = "Give wire, or landmarks inner_end, outer_end, apex and strap_point; or scan the whole torso"
        absent = [name for name in ("inner_end", "outer_end", "apex") if name not in marks.points]
        absent += [] if bottom is not None or strap is not None else ["strap_point"]
        cause = f"wire: its place is not given, and without {', '.join(absent)} it is found on a whole torso only"
        raise InputError(marks.path, cause, remedy)
    points = marked.cloud.points
    body = body_of(points)
    return body, apex_of(points, body, marks.side) if apex is None else apex


def _joined(upper: np.ndarray | None, found: Wire) -> np.ndarray | None:
    """A given upper line with its ends brought to the ends of a wire that was found."""
    if upper is None:
        return None
    flipped = np.linalg.norm(upper[0] - found.wire[0]) > np.linalg.norm(upper[0] - found.wire[-1])
    line = upper[::-1].copy() if flipped else upper.copy()
    share = np.linspace(0, 1, len(line))[:, None]
    first, last = np.clip(1 - 3 * share, 0, 1), np.clip(3 * share - 2, 0, 1)
    return line + first * (found.wire[0] - line[0]) + last * (found.wire[-1] - line[-1])


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
