"""A cloud with the marks of its breasts, in millimetres: read, proposed, or carried over from the other side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from brafit.anatomy.confidence import Confidence, refusal
from brafit.anatomy.foreign import foreign_cause
from brafit.anatomy.torso import TORSO_SIZE, judged, proposals
from brafit.cloud.read import Cloud
from brafit.errors import InputError
from brafit.geometry.polyline import polyline_length
from brafit.landmarks.file import Landmarks, read_breasts
from brafit.landmarks.units import (
    LENGTH_OVER_SPAN,
    MILLIMETRES,
    NAMES,
    WIRE_POSSIBLE,
    WIRE_USUAL,
    Units,
    body_unit,
    cloud_unit,
    torso_unit,
    unit_of,
    wire_unit,
)
from brafit.surface.symmetry import SYMMETRIC, Mirror, mirror_of

SIDES_APART = 30.0
"""Marks that their mirror image is nearer to (mm, median) are not those of a breast."""


SIDEWAYS = 0.5
"""Least cosine between the line from end to end of a wire and the direction across the body: 0.8 to 0.95 of 14."""


@dataclass(frozen=True, eq=False)
class Whole:
    """A whole scan, in millimetres, and what is known of it as a body."""

    cloud: Cloud

    @cached_property
    def is_torso(self) -> bool:
        """Whether it is large enough for a body with two sides."""
        return float(np.linalg.norm(np.ptp(self.cloud.points, axis=0))) >= TORSO_SIZE

    @cached_property
    def mirror(self) -> Mirror:
        """The plane of best symmetry: between left and right, where the scan has both."""
        return mirror_of(self.cloud.points)

    @property
    def has_middle(self) -> bool:
        """Whether it shows where the middle between left and right is: a crop does not."""
        return self.is_torso and self.mirror.rms <= SYMMETRIC


@dataclass(frozen=True, eq=False)
class Marked:
    """A scan and its marks, in millimetres.

    Attributes:
        whole: the scan.
        breasts: the marks of one breast or both; the first is the one that is meant if no side is named.
        units: of the files.
        proposed: how far marks that were proposed just now can be trusted, by side; sides whose marks are impossible
            are not among `breasts`.
    """

    whole: Whole
    breasts: tuple[Landmarks, ...]
    units: Units
    proposed: Mapping[str, Confidence] = field(default_factory=dict)

    @property
    def cloud(self) -> Cloud:
        """All points of the scan."""
        return self.whole.cloud

    def of(self, side: str | None) -> tuple[Landmarks, str]:
        """The marks of a side (None: the first), and where they are from: `given`, `proposed` or `mirrored`.

        Raises:
            InputError: the side is not marked, and its marks cannot be carried over from the other.
        """
        known = self.proposed.get(side) if side is not None else None
        if known is not None and known.faults:
            raise refusal(self.cloud.path, [known])
        found = next((marks for marks in self.breasts if side in (None, marks.side)), None)
        if found is not None:
            return found, origin_of(found)
        return self._mirrored(self.breasts[0], str(side)), "mirrored"

    def confidence(self, marks: Landmarks, origin: str) -> Confidence | None:
        """How far marks can be trusted that nobody made or looked at on this breast; None for given ones.

        Raises:
            InputError: they cannot be this breast's.
        """
        if origin == "given":
            return None
        known = self.proposed.get(marks.side) if any(marks is own for own in self.breasts) else None
        middle = self.whole.mirror if self.whole.has_middle else None
        found = known or judged(self.cloud.points, marks, middle, looked_at=origin == "mirrored")
        if found is not None and found.faults:
            raise refusal(self.cloud.path, [found], origin)
        return found

    def _mirrored(self, marks: Landmarks, side: str) -> Landmarks:
        if not self.whole.is_torso:
            cause = f"it marks the {marks.side} breast only, and the cloud is no whole torso: it has no {side} breast"
            remedy = f"Leave scan.side out, and the {marks.side} breast is fitted, as the file marks it"
            raise InputError(marks.path, cause, remedy)
        flipped = marks.mapped(self.whole.mirror, side=side)
        if fault := self._mirror_fault(marks, flipped):
            cause = f"side={side}: it marks the {marks.side} breast only, and {fault}"
            raise InputError(marks.path, cause, f"Add the {side} breast to the landmark file: breasts: [...]")
        return flipped

    def _mirror_fault(self, marks: Landmarks, flipped: Landmarks) -> str:
        """Why marks of one breast cannot be mirrored onto the other; empty if they can."""
        line = marks.wire if marks.wire is not None else np.empty((0, 3))
        if len(line) and abs(float(_direction(line) @ self.whole.mirror.normal)) < SIDEWAYS:
            return "the plane in which the scan is symmetric does not part left from right"
        away = float(np.median(np.linalg.norm(flipped.positions() - marks.positions(), axis=1)))
        if not self.whole.has_middle or away < SIDES_APART:
            return "the body is not symmetric enough to mirror it"
        return ""


def _direction(line: np.ndarray) -> np.ndarray:
    """The unit vector from end to end."""
    chord = line[-1] - line[0]
    return chord / max(float(np.linalg.norm(chord)), 1e-9)


def origin_of(marks: Landmarks) -> str:
    """`given` or `proposed`."""
    return "proposed" if marks.proposed else "given"


def with_marks(raw: Cloud, marks: Path | Landmarks, units: str | None, propose: bool) -> Marked:
    """A cloud as it was read, and the marks in its landmark file.

    Args:
        raw: the cloud.
        marks: the landmark file, or the marks themselves.
        units: the unit of both, if it is said.
        propose: propose marks where there is no such file.

    Raises:
        InputError: there are no marks; they cannot be read; the files' units are in doubt or contradict each other.
    """
    if isinstance(marks, Landmarks):
        return _given(raw, [marks], units)
    if marks.exists():
        return _given(raw, read_breasts(marks), units)
    if not propose:
        remedy = f"Write {marks.name} (by hand on a page of brafit-mark), or set scan.propose=true"
        raise InputError(raw.path, f"no landmark file {marks.name} beside the cloud", remedy)
    stated = units or raw.unit
    unit = stated or torso_unit(raw.path, raw.points)
    whole = _scaled(raw, unit)
    found = proposals(raw.path, whole.cloud.points, whole.mirror if whole.is_torso else None)
    confidence = {one.marks.side: one.confidence for one in found}
    breasts = tuple(one.marks for one in found if not one.confidence.faults)
    if not breasts:
        raise _no_breasts(whole, list(confidence.values()))
    return Marked(whole, breasts, Units(unit, unit, "" if stated else "the depth of the body"), confidence)


def _no_breasts(whole: Whole, found: list[Confidence]) -> InputError:
    """The error of a scan on which no possible marks were found."""
    if seen := foreign_cause(whole.cloud.points):
        cause, remedy = seen
        return InputError(whole.cloud.path, f"no breast was found, and {cause}", f"{remedy}, or mark it by hand")
    if whole.has_middle:
        return refusal(whole.cloud.path, found)
    apart = f"no plane parts it into two sides that are alike (at best they are {whole.mirror.rms:.0f} mm apart)"
    cause = f"it seems to be a part of a torso: {apart}, and landmarks are proposed on a whole torso only"
    return InputError(whole.cloud.path, cause, "Mark it by hand, on a page of brafit-mark, or scan the whole torso")


def _given(raw: Cloud, breasts: list[Landmarks], units: str | None) -> Marked:
    path, declared = breasts[0].path, breasts[0].units
    _check_said(raw.path, breasts, units)
    unit, found = _marks_unit(raw, breasts, units or declared)
    breasts = [marks.mapped(lambda p: p * MILLIMETRES[unit], units="mm") for marks in breasts]
    placed = np.concatenate([marks.positions() for marks in breasts])
    lying = None if units or len(placed) < 2 else cloud_unit(raw.points, placed)
    of_cloud = units or raw.unit or lying or unit
    if of_cloud != unit and declared:
        says = f"its header says units {of_cloud!r}" if raw.unit else f"the cloud is in {NAMES[of_cloud]}"
        cause = f"{says}, its landmark file {path.name} says units {declared!r}"
        remedy = (
            f'Export the cloud in {NAMES[unit]}; or take "units" out of {path.name}, and each file\'s unit is found'
        )
        raise InputError(raw.path, cause, remedy)
    if raw.unit and not units and lying not in (None, raw.unit):
        cause = (
            f"its header says units {raw.unit!r}, but the landmarks of {path.name} lie on it as if in {NAMES[lying]}"
        )
        raise InputError(raw.path, cause, "Correct the one that is wrong, or say the unit of both: scan.units=UNIT")
    if of_cloud != unit:
        found = "its header" if raw.unit else "how the landmarks lie on the cloud"
    return Marked(_scaled(raw, of_cloud), tuple(breasts), Units(of_cloud, unit, found))


def _check_said(cloud: Path, breasts: list[Landmarks], setting: str | None) -> None:
    """Refuse a unit that was said and in which a wire, or the distance between its ends, is that of none, but that is
    right in another unit. (A given wire that is too short is left to `brafit.landmarks.plausibility`.)

    Raises:
        InputError: names the setting or the landmark file, whichever says it.
    """
    said = setting or breasts[0].units
    wire, span = _wire_length(breasts), _span(breasts)
    length = wire if wire is not None else span and span * LENGTH_OVER_SPAN
    if said is None or length is None:
        return
    like = unit_of(length, WIRE_POSSIBLE, WIRE_USUAL)
    least, most = (0.0 if wire is not None else WIRE_POSSIBLE[0]), WIRE_POSSIBLE[1]
    if like is None or least <= length * MILLIMETRES[said] <= most:
        return
    would = f"the wire would be {length * MILLIMETRES[said]:.0f} mm long"
    if wire is None and span is not None:
        would = f"the wire's ends would be {span * MILLIMETRES[said]:.1f} mm apart"
    is_so = f"{would}: it looks like {NAMES[like]}, not {NAMES[said]}"
    if setting:
        cause = f"scan.units={said}: {is_so}"
        raise InputError(cloud, cause, "Take scan.units away, and the units are found; or say the right one")
    cause = f'units: "{said}", but {is_so}'
    raise InputError(breasts[0].path, cause, f'Take "units" out, and they are found; or write "{like}"')


def _marks_unit(raw: Cloud, breasts: list[Landmarks], said: str | None) -> tuple[str, str]:
    """The landmark file's unit and what it was found from."""
    if said:
        return said, ""
    length, span = _wire_length(breasts), _span(breasts)
    if length is not None:
        return wire_unit(breasts[0].path, length), "the length of the wire"
    unit = None if span is None else unit_of(span * LENGTH_OVER_SPAN, WIRE_POSSIBLE, WIRE_USUAL)
    if unit is not None:
        return unit, "the distance between the wire's ends"
    of_cloud, found = (
        (raw.unit, "its header") if raw.unit else (body_unit(raw.path, raw.points), "the depth of the body")
    )
    placed = np.concatenate([marks.positions() for marks in breasts])
    lying = [unit for unit, factor in MILLIMETRES.items() if cloud_unit(raw.points, placed * factor) == of_cloud]
    return (lying[0] if len(lying) == 1 else of_cloud), found


def _wire_length(breasts: list[Landmarks]) -> float | None:
    """Length of the wire that is given, in its file's unit; None without one."""
    return next((polyline_length(marks.wire) for marks in breasts if marks.wire is not None), None)


def _span(breasts: list[Landmarks]) -> float | None:
    """Distance between the ends of a wire that is not given, in its file's unit; None if they are not marked either."""
    for marks in breasts:
        ends = [marks.points[name] for name in ("inner_end", "outer_end") if name in marks.points]
        if len(ends) < 2 and marks.upper_line is not None:
            ends = [marks.upper_line[0], marks.upper_line[-1]]
        if len(ends) == 2:
            return float(np.linalg.norm(ends[0] - ends[1]))
    return None


def _scaled(cloud: Cloud, unit: str) -> Whole:
    return Whole(cloud if unit == "mm" else replace(cloud, points=cloud.points * MILLIMETRES[unit]))
