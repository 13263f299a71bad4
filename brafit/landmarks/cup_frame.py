"""The cup frame: where a cup lies, whatever the scanner's axes were and whichever breast it is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.errors import InputError, WrongWayError
from brafit.geometry.polyline import evenly_spaced, polyline_length

END_TOLERANCE = 5.0
"""How far (mm) a line's end may lie from the point where it should end."""
LEAST_SPAN, LEAST_HEIGHT = 0.2, 0.1
"""Least distance between a wire's ends over its length, and least height of its bow over that distance."""


@dataclass(frozen=True, eq=False)
class CupFrame:
    """An isometry between a scan's frame and the cup frame.

    Cup frame: origin at the wire's inner end; y towards its outer end; z out of the chest; the wire's bottom at +x. For
    a left breast that is right-handed (x = y cross z); a right one is mirrored, so that it looks like a left one.

    Attributes:
        origin: the cup frame's origin in the scan's frame.
        axes: rows are the cup's x, y and z axis in the scan's frame; orthonormal, determinant +1, or -1 if mirrored.
    """

    origin: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]

    @property
    def mirrored(self) -> bool:
        """True for a right breast."""
        return bool(np.linalg.det(self.axes) < 0)

    def equals(self, other: CupFrame) -> bool:
        """Whether the two are the same, to the last digit."""
        return np.array_equal(self.origin, other.origin) and np.array_equal(self.axes, other.axes)

    def to_cup(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the scan's frame in the cup frame."""
        return (points - self.origin) @ self.axes.T

    def to_scan(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """The inverse of `to_cup`."""
        return points @ self.axes + self.origin


def frame_from_wire(
    wire: Float[np.ndarray, "k 3"], side: str, front: Float[np.ndarray, "3"], file: str | Path
) -> CupFrame:
    """The cup frame of a wire that runs from its inner to its outer end.

    Args:
        wire: the wire line in the scan's frame.
        side: the wearer's `left` or `right` breast.
        front: a point in front of the wire's plane: the apex, or the middle of the cloud.
        file: named in errors.

    Raises:
        InputError: the wire is no bow.
        WrongWayError: it runs the wrong way round for `side`.
    """
    frame, even = _frame_and_line(wire, side, front, file)
    if frame.to_cup(even)[:, 0].mean() <= 0:
        other = "right" if side == "left" else "left"
        raise WrongWayError(
            file,
            f"side: for a {side} breast the wire runs the wrong way round, its bottom would be above its ends",
            f'The side is probably wrong: write "{other}", or list the wire from its inner to its outer end',
        )
    return frame


def runs_backwards(wire: Float[np.ndarray, "k 3"], side: str, front: Float[np.ndarray, "3"], file: str | Path) -> bool:
    """Whether a wire runs from the outer to the inner end, if it is one of this side's breast.

    Args:
        wire: the wire line in the scan's frame.
        side: the wearer's `left` or `right` breast.
        front: a point in front of the wire's plane.
        file: named in errors.

    Raises:
        InputError: the wire is no bow.
    """
    frame, even = _frame_and_line(wire, side, front, file)
    return bool(frame.to_cup(even)[:, 0].mean() <= 0)


def _frame_and_line(wire: np.ndarray, side: str, front: np.ndarray, file: str | Path) -> tuple[CupFrame, np.ndarray]:
    """The cup frame, if the wire runs from its inner to its outer end, and the wire in even steps."""
    even = evenly_spaced(wire, 200)
    y = chord_of(even, file)
    normal = np.linalg.svd(even - even.mean(axis=0), full_matrices=False)[2][2]
    z = normal - (normal @ y) * y
    z /= np.linalg.norm(z)
    if (front - wire[0]) @ z < 0:
        z = -z
    x = np.cross(y, z) * (1.0 if side == "left" else -1.0)
    return CupFrame(wire[0].copy(), np.stack([x, y, z])), even


def from_inner_end(
    wire: Float[np.ndarray, "k 3"],
    inner_end: Float[np.ndarray, "3"] | None,
    file: str | Path,
    outer_end: Float[np.ndarray, "3"] | None = None,
) -> Float[np.ndarray, "k 3"]:
    """The wire with its inner end first: as it is, or reversed if only that puts its ends at the marked ones.

    Args:
        wire: the wire line, either way round.
        inner_end: marked, or None.
        file: named in errors.
        outer_end: marked, or None; it decides only where `inner_end` is not marked.

    Raises:
        InputError: neither end is at `inner_end`.
    """
    if inner_end is None:
        reverse = outer_end is not None and _away(wire[0], outer_end) <= END_TOLERANCE < _away(wire[-1], outer_end)
        return wire[::-1].copy() if reverse else wire
    first, last = (_away(end, inner_end) for end in (wire[0], wire[-1]))
    if min(first, last) > END_TOLERANCE:
        cause = f"landmarks.inner_end: {min(first, last):.1f} mm from the nearer end of the wire"
        raise InputError(file, cause, f"Both mark the same point: bring them within {END_TOLERANCE:g} mm")
    return wire if first <= last else wire[::-1].copy()


def _away(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other))


def chord_of(wire: Float[np.ndarray, "k 3"], file: str | Path) -> Float[np.ndarray, "3"]:
    """The unit vector from end to end of a wire that is a bow.

    Args:
        wire: the wire line.
        file: named in errors.

    Raises:
        InputError: it is closed, or straight.
    """
    chord = wire[-1] - wire[0]
    span = float(np.linalg.norm(chord))
    length = polyline_length(wire)
    if span < LEAST_SPAN * length:
        cause = f"wire: its ends are only {span:.1f} mm apart on {length:.0f} mm of length"
        raise InputError(file, cause, "Trace it from the inner to the outer end only, not round the breast")
    y = chord / span
    offset = wire - wire[0]
    height = float(np.linalg.norm(offset - np.outer(offset @ y, y), axis=1).max())
    if height < LEAST_HEIGHT * span:
        cause = f"wire: nearly straight, {height:.1f} mm high on {span:.0f} mm of span"
        raise InputError(file, cause, "Trace the bow in the crease under the breast")
    return y
