"""What the page of a scan opens with: the marks of its landmark file, else proposals, else none; and how it is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.anatomy.body import Body, body_from_marks
from brafit.anatomy.confidence import Confidence
from brafit.anatomy.torso import body_of
from brafit.cloud.read import Cloud
from brafit.errors import InputError
from brafit.landmarks.file import SIDES, Landmarks, landmarks_path
from brafit.landmarks.units import MILLIMETRES, NAMES, body_unit, unit_of
from brafit.scan.framed import framed
from brafit.scan.marked import Marked, Whole, with_marks
from brafit.scan.wiring import Wiring
from brafit.surface.symmetry import Mirror

SIZE_POSSIBLE, SIZE_USUAL = (150.0, 2500.0), (200.0, 450.0)
"""Diagonal (mm) of a scan of one breast or more; of most of one breast."""
BOUNDLESS = 20e3
"""Diagonal (mm) that nothing is scanned with, whatever stands beside the body."""
MIRROR_MOST = 8.0
"""Rms (mm) between a body and its mirror image up to which marks are copied: a person looks at them."""
UPRIGHT = 0.9
"""Cosine from which on an axis of the scan is taken for the vertical that the marks show."""


@dataclass(frozen=True, eq=False)
class Opening:
    """What is known of a scan before a person marks it; lengths in mm.

    Attributes:
        whole: the scan.
        unit: of its file, and of the landmark file to be written.
        unit_from: what the unit was found from; empty if it was said.
        breasts: marks to begin with, each with its wire from the inner to the outer end.
        named: the marked points that the landmark file or the proposal names, by side.
        confidence: of those that nobody looked at, by side.
        detected: sides whose wire the landmark file does not have: it was found in the crease.
        turned: sides whose wire the landmark file has from its outer end.
        sides: breasts that can be marked.
        axes: rows: to the wearer's left, up, out of the chest.
        mirror: the plane between left and right, if the body is symmetric enough to carry marks over.
        faults: why a fit would refuse the marks of a side as they are, or why none are proposed there, by side.
        notes: what else the person should know, a line each.
    """

    whole: Whole
    unit: str
    unit_from: str
    breasts: tuple[Landmarks, ...]
    named: dict[str, dict[str, Float[ndarray, "3"]]]
    confidence: dict[str, Confidence]
    detected: tuple[str, ...]
    turned: tuple[str, ...]
    sides: tuple[str, ...]
    axes: Float[ndarray, "3 3"]
    mirror: Mirror | None
    faults: dict[str, tuple[str, ...]]
    notes: tuple[str, ...]


def opening_of(raw: Cloud, side: str | None = None, units: str | None = None) -> Opening:
    """What the page of a scan opens with.

    Args:
        raw: the scan as its file has it.
        side: the only breast to be marked; None: all that it may hold.
        units: of the scan, where they are said.

    Raises:
        InputError: the landmark file beside it cannot be read; the unit is in doubt.
    """
    file = landmarks_path(raw.path)
    if file.exists():
        marked = with_marks(raw, file, units, propose=False)
        return _marked(marked, side, marked.units.found)
    unit, found = _unit(raw, units)
    try:
        return _marked(with_marks(raw, file, unit, propose=True), side, found)
    except InputError as error:
        return _by_hand(raw, side, unit, found, error)


def _marked(marked: Marked, side: str | None, unit_from: str) -> Opening:
    """Where marks are given or proposed."""
    faults = {one.side: one.faults for one in marked.proposed.values() if one.faults}
    wiring = Wiring(marked, None)
    found = [_breast(wiring, marks, faults) for marks in marked.breasts]
    return Opening(
        whole=marked.whole,
        unit=marked.units.cloud,
        unit_from=unit_from,
        breasts=tuple(one.marks for one in found),
        named={marks.side: marks.points for marks in marked.breasts},
        confidence={one.marks.side: one.confidence for one in found if one.confidence is not None},
        detected=tuple(one.marks.side for one in found if one.origin == "detected"),
        turned=tuple(one.marks.side for one in found if one.turned),
        sides=_sides(marked.whole, side, [marks.side for marks in marked.breasts]),
        axes=_axes(marked, [one.marks for one in found]),
        mirror=_mirror(marked.whole),
        faults=faults,
        notes=(),
    )


@dataclass(frozen=True)
class _Breast:
    """One breast's marks with the wire that a fit takes, where that is from, whether the file has it from its outer
    end, and how far marks that nobody looked at can be trusted.
    """

    marks: Landmarks
    origin: str
    turned: bool
    confidence: Confidence | None


def _breast(wiring: Wiring, marks: Landmarks, faults: dict[str, tuple[str, ...]]) -> _Breast:
    """One breast. Why a fit would refuse its marks is added to the faults."""
    try:
        breast = framed(wiring, marks.side)
    except InputError as error:
        faults[marks.side] = (f"as the page began: {error.cause}",)
        return _Breast(marks, "given", False, wiring.marked.proposed.get(marks.side))
    turned = breast.turned and breast.wire_origin != "detected"
    return _Breast(breast.marks, breast.wire_origin, turned, breast.confidence)


def _by_hand(raw: Cloud, side: str | None, unit: str, found: str, error: InputError) -> Opening:
    """Where nothing is marked and nothing can be proposed."""
    whole = Whole(replace(raw, points=raw.points * MILLIMETRES[unit]))
    body = _body(whole)
    return Opening(
        whole=whole,
        unit=unit,
        unit_from=found,
        breasts=(),
        named={},
        confidence={},
        detected=(),
        turned=(),
        sides=_sides(whole, side, []),
        axes=_facing(whole.cloud.points) if body is None else np.stack([body.left, body.up, body.front]),
        mirror=_mirror(whole),
        faults={},
        notes=(f"Nothing is marked, and nothing could be proposed ({error.cause})",),
    )


def _unit(raw: Cloud, units: str | None) -> tuple[str, str]:
    if said := units or raw.unit:
        _check_said(raw, said)
        return said, ""
    try:
        return body_unit(raw.path, raw.points), "the depth of the body"
    except InputError:
        size = float(np.linalg.norm(np.ptp(raw.points, axis=0)))
        unit = unit_of(size, SIZE_POSSIBLE, SIZE_USUAL)
        if unit is None:
            raise _in_doubt(raw.path, size) from None
        return unit, "the size of the scan"


def _check_said(raw: Cloud, said: str) -> None:
    """Refuse a unit in which a scan can be no body, if it can be one in another. Stray points far away do not count."""
    size = float(np.linalg.norm(np.ptp(np.quantile(raw.points, (0.01, 0.99), axis=0), axis=0)))
    across = size * MILLIMETRES[said]
    other = unit_of(size, SIZE_POSSIBLE, SIZE_USUAL)
    if SIZE_POSSIBLE[0] <= across <= SIZE_POSSIBLE[1] or (other is None and across < BOUNDLESS):
        return
    cause = f"in {NAMES[said]}, as is said, it is {across / 1000:.3g} m across"
    likely = f"; in {NAMES[other]} it would be {size * MILLIMETRES[other] / 1000:.3g} m" if other else ""
    raise InputError(raw.path, cause + likely, f"Say the unit that it has: --units {other or 'UNIT'}")


def _in_doubt(path: Path, size: float) -> InputError:
    choice = ", ".join(MILLIMETRES)
    return InputError(
        path, f"a scan of size {size:.4g} can be in none or in two units", f"Say --units, one of {choice}"
    )


def _sides(whole: Whole, side: str | None, marked: list[str]) -> tuple[str, ...]:
    if side is not None:
        return (side,)
    return tuple(marked) if marked and not whole.is_torso else SIDES


def _mirror(whole: Whole) -> Mirror | None:
    return whole.mirror if whole.is_torso and whole.mirror.rms <= MIRROR_MOST else None


def _axes(marked: Marked, breasts: Sequence[Landmarks]) -> np.ndarray:
    """The body's axes: from the marks, wires from their inner ends, put upright; from its shape, where they say too
    little.
    """
    marks = next((own for own in breasts if own.wire is not None and "apex" in own.points), None)
    if marks is None or marks.wire is None:
        body = _body(marked.whole)
        return _facing(marked.cloud.points) if body is None else np.stack([body.left, body.up, body.front])
    middle = marks.wire[[0, -1]].mean(axis=0)
    rough = body_from_marks(marks.wire[[0, -1]], marks.wire.mean(axis=0) - middle, marks.points["apex"], marks.side)
    left, up = rough.left, rough.up
    mirror = _mirror(marked.whole)
    if mirror is not None:
        left = mirror.normal * np.sign(mirror.normal @ left)
    upright = max((sign * axis for axis in np.eye(3) for sign in (1, -1)), key=lambda axis: float(axis @ up))
    return _orthonormal(left, upright if upright @ up > UPRIGHT else up)


def _body(whole: Whole) -> Body | None:
    try:
        return body_of(whole.cloud.points) if whole.is_torso else None
    except (InputError, ValueError, IndexError, np.linalg.LinAlgError):  # it is no body: it is looked at as it lies
        return None


def _facing(points: np.ndarray) -> np.ndarray:
    """Axes of a scan of which nothing is known: from the side to which it bulges, one of its own axes upwards."""
    centred = points - points.mean(axis=0)
    front = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    height, away = centred @ front, np.linalg.norm(centred - np.outer(centred @ front, front), axis=1)
    inner = away < np.median(away)
    front = front if height[inner].mean() >= height[~inner].mean() else -front
    up = np.eye(3)[1] if abs(front[1]) < UPRIGHT else np.eye(3)[2]
    return _orthonormal(np.cross(up, front), up - (up @ front) * front)


def _orthonormal(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    left = left / np.linalg.norm(left)
    up = up - (up @ left) * left
    up = up / np.linalg.norm(up)
    return np.stack([left, up, np.cross(left, up)])
