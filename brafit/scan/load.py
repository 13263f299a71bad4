"""One scan, read, checked, cleaned and turned into the cup frame."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from brafit.errors import ConfigError, InputError
from brafit.geometry.order import along_curve
from brafit.scan.body import (
    TORSO_SIZE,
    Body,
    apex_of,
    body_from_marks,
    body_of,
    proposed_landmarks,
    wire_about,
    wire_laid,
)
from brafit.scan.checks import check_scan, is_one_breast, polyline_length
from brafit.scan.clean import Cleaning, Tidy, check_settings, finish, tidy
from brafit.scan.crease import Wire
from brafit.scan.crop import facing, neckline_over
from brafit.scan.frame import END_TOLERANCE, CupFrame, frame_from_wire, from_inner_end
from brafit.scan.gaps import Gaps, gaps
from brafit.scan.landmarks import Landmarks, landmarks_path, read_landmarks
from brafit.scan.read import FLAG, MESH_POINTS, MIN_POINTS, READ_SECONDS, Cloud, read_cloud
from brafit.scan.surface import Surface, surface_of
from brafit.scan.symmetry import apart, mirror_of
from brafit.scan.units import MILLIMETRES, NAMES, Units, body_unit, cloud_unit, wire_unit
from brafit.scan.wires import wire_size

REGION = 1.1
"""What lies farther than this many wire lengths from the middle of the wire is not looked at."""
MIRROR_RMS = 3.0
"""Largest rms (mm) between a body and its mirror image at which marks are carried over to its other side."""
WIRE_POINTS = 51
OWN = 1.0
"""A place nearer than this (mm) to a point stands for it, after averaging in voxels."""
DIGITS = 9
"""Digits after the point that coordinates (mm) keep in the cup frame."""
ALIKE, SKETCH = 0.5, 15_000
"""Rms (mm) within which a breast and the other one's mirror image are alike (less than scanners err), and about how
many points of each are compared."""
DOUBT = "give or take 3 mm at the apex, 8 mm at wire ends and strap point, on some bodies 23 mm"
"""How far proposed landmarks lay off those that were given, on clouds of 14 bodies: median, and largest."""
NOISY = 1.0
"""Scatter (mm) of the cleaned points that is said."""
GAPS_SAID, GAPS_MOST = 0.1, 0.6
"""Shares of the surface between wire and upper line without data from which on that is said, and refused."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan, ready to be fitted. Positions are in millimetres, in the cup frame.

    Attributes:
        name: what its results are called.
        path: the cloud's file.
        side: the wearer's `left` or `right` breast; a right one is mirrored here.
        points: the cleaned cloud, in the order of `along_curve`.
        wire: the wire line, inner end first (at the origin).
        neckline: the upper line, inner end first, or None.
        strap_point, apex: marked points, or None.
        frame: leads back to the scan's own frame, still in mm.
        cleaning: what each step of the cleaning took.
        dense: the breast's points before thinning: where there are data.
        units: of the files.
        origin: where wire, neckline and landmarks come from.
        notes: what the user should know of it, a line each.
        assumed: places on the surface that is assumed where the scan has no data, for the fit only.
        removed: what the cleaning took because it lies on no surface.
        gap_share: share of the surface between wire and upper line without data; None without an upper line.
    """

    name: str
    path: Path
    side: str
    points: Float[np.ndarray, "n 3"]
    wire: Float[np.ndarray, "k 3"]
    neckline: Float[np.ndarray, "m 3"] | None
    strap_point: Float[np.ndarray, "3"] | None
    apex: Float[np.ndarray, "3"] | None
    frame: CupFrame
    cleaning: Cleaning
    dense: Float[np.ndarray, "d 3"]
    units: Units
    origin: Origin
    notes: tuple[str, ...] = ()
    assumed: Float[np.ndarray, "g 3"] = field(default_factory=lambda: np.empty((0, 3)))
    removed: Float[np.ndarray, "r 3"] = field(default_factory=lambda: np.empty((0, 3)))
    gap_share: float | None = None

    @property
    def curve(self) -> Float[np.ndarray, "c 3"] | None:
        """The closed curve that bounds the cup: wire and neckline; None without a neckline."""
        return None if self.neckline is None else _closed(self.wire, self.neckline)


@dataclass(frozen=True)
class Origin:
    """Where a scan's lines and marks come from.

    Attributes:
        marks: `given`, `mirrored` (from the other side) or `proposed`.
        wire: `given`, `proposed`, `detected` (the crease) or `size NAME`.
        wire_guessed: share of the wire's length that no crease in the scan shows; None for a given wire.
        neckline: `given`, `proposed`, `built` (from ends and strap point) or `none`.
    """

    marks: str
    wire: str
    wire_guessed: float | None
    neckline: str


def load_scan(
    path: str | Path,
    *,
    points: int | None = 2000,
    outliers: float | None = 3.0,
    neighbours: int = 16,
    name: str | None = None,
    side: str | None = None,
    units: str | None = None,
    wire: str | None = None,
    propose: bool = False,
    symmetry: bool = True,
    bridge: bool = True,
    landmarks: str | Path | None = None,
    read_seconds: float = READ_SECONDS,
    mesh_points: int = MESH_POINTS,
) -> Scan:
    """Load a cloud and the landmark file beside it.

    Args:
        path: the cloud; its landmark file has the same stem and the extension `.json`.
        points, outliers, neighbours: see `brafit.scan.clean` (there `points` is `count`).
        name: name of the scan; the file's stem if None.
        side: the breast to take, `left` or `right`; None: the one that the landmark file marks (first). One that it
            does not mark gets the other's marks, mirrored at the body's plane of symmetry.
        units: unit of cloud and landmark file, one of `brafit.scan.units.MILLIMETRES`; None: what the landmark file
            says, else found.
        wire: None: as the landmark file has it, detected where it has none; `detect`: always detected; a size of
            `brafit.scan.wires`: a wire of that size, placed best.
        propose: propose landmarks where there is no landmark file.
        symmetry: take the points of both breasts of a torso for either cup, where they are mirror images within ALIKE.
        bridge: assume a surface where there are no data (`Scan.assumed`).
        landmarks: the landmark file, if it is not beside the cloud.
        read_seconds, mesh_points: see `read_cloud`.

    Raises:
        InputError: one line naming file, cause and remedy.
        ConfigError: a setting out of its range.
        Open3DError: Open3D cannot be imported.
    """
    path = Path(path)
    check_settings(points, outliers, neighbours)
    _check_choice("side", side, ("left", "right"))
    _check_choice("units", units, tuple(MILLIMETRES))
    if wire not in (None, "detect"):
        wire_size(wire)
    raw = read_cloud(path, seconds=read_seconds, mesh_points=mesh_points)
    cloud, marks, said = _with_marks(
        raw, landmarks_path(path) if landmarks is None else Path(landmarks), side, units, propose
    )
    notes = [f"{path.name}: {note}" for note in _unit_notes(said)]
    marks_origin = _said(marks)
    if side is not None and marks.side != side:
        marks, marks_origin = _other_side(cloud, marks, side), "mirrored"
    check_scan(cloud, marks)
    marks, wire_origin, guessed = _with_wire(cloud, marks, wire)
    line = from_inner_end(_present(marks), marks.points.get("inner_end"), marks.path)
    _check_outer_end(line, marks)
    frame = frame_from_wire(line, marks.side, _front(cloud, marks), marks.path)
    whole = cloud.inside is None and not is_one_breast(cloud.points, line)
    region = _Region(frame.to_cup(line), outliers, neighbours) if whole else None
    placed = _grid(frame.to_cup(cloud.points))
    near, added = placed if region is None else region.of(placed), 0
    elsewhere = len(cloud.points) - len(near)
    if symmetry and region is not None and _size(cloud.points) >= TORSO_SIZE:
        image, rms = _other_breast(cloud.points, frame, region, near)
        if image is not None:
            added, near = len(image), np.concatenate([near, image])
            notes.append(f"{path.name}: the breasts are mirror images within {rms:.2f} mm: both are taken for each cup")
    tidied = tidy(near, cloud.inside, outliers=outliers, neighbours=neighbours)
    neckline, neckline_origin = _neckline(line, marks, frame, tidied)
    if whole and neckline is None:
        raise InputError(
            path,
            "the cloud is more than one breast, and nothing says where the cup ends",
            f"Mark landmarks.strap_point or upper_line, or give the points a property '{FLAG}', 1 on the breast",
        )
    curve = None if neckline is None or cloud.inside is not None else _closed(frame.to_cup(line), neckline)
    cleaned = finish(tidied, curve, count=points, not_finite=cloud.dropped, elsewhere=elsewhere, other_side=added)
    if len(cleaned.points) < min(MIN_POINTS, points or MIN_POINTS):
        kept, read = len(cleaned.points), cleaned.steps.read
        cause = f"only {kept} distinct points are left of {read} after cleaning and cropping"
        remedy = "Check wire and upper line; raise scan.outliers (null keeps all points), or scan more densely"
        raise InputError(path, cause, remedy)
    used = cleaned.points[along_curve(cleaned.points)]
    bare = None if neckline is None else gaps(used, cleaned.dense, _closed(frame.to_cup(line), neckline))
    notes += _gap_notes(path, bare)
    if neckline_origin == "built":
        notes.append(f"{path.name}: no upper line given: it is built from the wire's ends and the strap point")
    scatter = cleaned.steps.scatter_mm
    if scatter is not None and scatter > NOISY:
        notes.append(f"{path.name}: its points scatter by {scatter:.1f} mm about their surface: edges are less certain")
    if marks_origin != "given" or wire_origin != "given":
        how = f"landmarks {marks_origin}, wire {wire_origin}"
        share = "" if guessed is None else f" ({100 * guessed:.0f} % of it guessed)"
        doubt = f", {DOUBT}" if marks_origin == "proposed" else ""
        notes.append(f"{path.name}: {how}{share}{doubt}: look at them, brafit-inspect draws them")
    if marks_origin == "proposed" and side is None:
        notes.append(f"{path.name}: the {marks.side} breast alone is fitted: scan.side=both fits both")
    return Scan(
        name=path.stem if name is None else name,
        path=path,
        side=marks.side,
        points=used,
        wire=frame.to_cup(line),
        neckline=neckline,
        strap_point=_mark(frame, marks, "strap_point"),
        apex=_mark(frame, marks, "apex"),
        frame=frame,
        cleaning=cleaned.steps,
        dense=cleaned.dense,
        units=said,
        origin=Origin(marks_origin, wire_origin, guessed, neckline_origin),
        notes=tuple(notes),
        assumed=bare.places[along_curve(bare.places)] if bare is not None and bridge else np.empty((0, 3)),
        removed=_own(tidied.removed, placed) if added else tidied.removed,
        gap_share=None if bare is None else bare.share,
    )


def _check_choice(key: str, value: str | None, choices: tuple[str, ...]) -> None:
    if value is not None and value not in choices:
        raise ConfigError(f"scan.{key}: {value}, but it must be one of {', '.join(choices)}")


def _with_marks(
    raw: Cloud, path: Path, side: str | None, units: str | None, wanted: bool
) -> tuple[Cloud, Landmarks, Units]:
    """Cloud and marks in millimetres."""
    if not path.exists() and wanted:
        unit = units or body_unit(raw.path, raw.points)
        cloud = _scaled(raw, MILLIMETRES[unit])
        marks = proposed_landmarks(cloud.path, cloud.points)
        return (
            cloud,
            next(mark for mark in marks if mark.side == (side or "left")),
            Units(unit, unit, "" if units else "the depth of the body"),
        )
    if not path.exists():
        remedy = f"Write {path.name} (brafit-inspect proposes one), or set scan.propose=true"
        raise InputError(raw.path, f"no landmark file {path.name} beside the cloud", remedy)
    marks = read_landmarks(path, side)
    declared = marks.units
    unit, found = _marks_unit(raw, marks, units)
    factor = MILLIMETRES[unit]
    marks = marks.mapped(lambda p: p * factor, units="mm")
    placed = marks.positions()
    of_cloud = units or (cloud_unit(raw.points, placed) if len(placed) > 3 else None) or unit
    if of_cloud != unit and declared:
        cause = f"the cloud is in {NAMES[of_cloud]}, its landmark file {path.name} says units {declared!r}"
        remedy = (
            f'Export the cloud in {NAMES[unit]}; or take "units" out of {path.name}, and each file\'s unit is found'
        )
        raise InputError(raw.path, cause, remedy)
    if of_cloud != unit:
        found = "how the landmarks lie on the cloud"
    return _scaled(raw, MILLIMETRES[of_cloud]), marks, Units(of_cloud, unit, found)


def _marks_unit(raw: Cloud, marks: Landmarks, said: str | None) -> tuple[str, str]:
    """The landmark file's unit and what it was found from."""
    said = said or marks.units
    if said:
        return said, ""
    if marks.wire is not None:
        return wire_unit(marks.path, polyline_length(marks.wire)), "the length of the wire"
    return body_unit(raw.path, raw.points), "the depth of the body"


def _scaled(cloud: Cloud, factor: float) -> Cloud:
    return cloud if factor == 1 else replace(cloud, points=cloud.points * factor)


def _unit_notes(units: Units) -> list[str]:
    if not units.found or (units.cloud == units.marks == "mm"):
        return []
    files = f"the cloud is in {NAMES[units.cloud]}, the landmarks in {NAMES[units.marks]}"
    same = f"it is in {NAMES[units.cloud]}"
    return [f"{same if units.cloud == units.marks else files}, found from {units.found}"]


def _other_side(cloud: Cloud, marks: Landmarks, side: str) -> Landmarks:
    """The marks of one breast carried over to the other."""
    if _size(cloud.points) < TORSO_SIZE:
        cause = f"side={side}: it marks the {marks.side} breast, and the cloud is no whole torso"
        raise InputError(marks.path, cause, f"Set scan.side={marks.side}, or scan.side=null for what each file marks")
    mirror = mirror_of(cloud.points)
    flipped = marks.mapped(mirror, side=side)
    away = float(np.median(np.linalg.norm(flipped.positions() - marks.positions(), axis=1)))
    if mirror.rms > MIRROR_RMS or away < MIRROR_RMS * 10:
        cause = f"side={side}: it marks the {marks.side} breast only, and the body is not symmetric enough to mirror it"
        raise InputError(marks.path, cause, f"Add the {side} breast to the landmark file: breasts: [...]")
    return flipped


def _with_wire(cloud: Cloud, marks: Landmarks, wire: str | None) -> tuple[Landmarks, str, float | None]:
    """Marks that have a wire, where it comes from and the share of it that is guessed."""
    if wire is None and marks.wire is not None:
        return marks, _said(marks), None
    body, apex = _body_and_apex(cloud, marks)
    ends = [marks.points.get(name) for name in ("inner_end", "outer_end")]
    both = None if ends[0] is None or ends[1] is None else np.stack([ends[0], ends[1]])
    if wire in (None, "detect"):
        found, origin = wire_about(cloud.points, body, marks.side, apex, both), "detected"
    else:
        arc = wire_size(str(wire)).arc(WIRE_POINTS)
        found, origin = wire_laid(cloud.points, body, marks.side, apex, arc, both), f"size {wire}"
    changes = {"inner_end": found.wire[0], "outer_end": found.wire[-1], "apex": apex}
    upper = _joined(marks.upper_line, found)
    return replace(marks, wire=found.wire, upper_line=upper, points={**marks.points, **changes}), origin, found.guessed


def _body_and_apex(cloud: Cloud, marks: Landmarks) -> tuple[Body, np.ndarray]:
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
    if _size(cloud.points) < TORSO_SIZE:
        remedy = "Give wire, or landmarks inner_end, outer_end, apex and strap_point; or scan the whole torso"
        raise InputError(marks.path, "wire: missing, and the cloud is no torso in which to find it", remedy)
    body = body_of(cloud.points)
    return body, apex_of(cloud.points, body, marks.side) if apex is None else apex


def _joined(upper: np.ndarray | None, found: Wire) -> np.ndarray | None:
    """A given upper line with its ends brought to the ends of a wire that was found."""
    if upper is None:
        return None
    flipped = np.linalg.norm(upper[0] - found.wire[0]) > np.linalg.norm(upper[0] - found.wire[-1])
    line = upper[::-1].copy() if flipped else upper.copy()
    share = np.linspace(0, 1, len(line))[:, None]
    first, last = np.clip(1 - 3 * share, 0, 1), np.clip(3 * share - 2, 0, 1)
    return line + first * (found.wire[0] - line[0]) + last * (found.wire[-1] - line[-1])


def _present(marks: Landmarks) -> np.ndarray:
    assert marks.wire is not None
    return marks.wire


def _grid(points: np.ndarray) -> np.ndarray:
    """Points rounded so far that nothing later depends on the last digits of a transformation (mm)."""
    return np.round(points, DIGITS)


def _own(removed: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Those of the removed places that stand for points of the scan itself, not of its mirror image."""
    return removed[KDTree(points).query(removed)[0] < OWN] if len(removed) else removed


def _size(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


@dataclass(frozen=True)
class _Region:
    """The part of a torso about a breast (cup frame), and how it is tidied."""

    wire: np.ndarray
    outliers: float | None
    neighbours: int

    def of(self, points: np.ndarray) -> np.ndarray:
        middle, reach = self.wire.mean(axis=0), REGION * polyline_length(self.wire)
        return points[np.linalg.norm(points - middle, axis=1) < reach]

    def sketch(self, points: np.ndarray) -> Surface | None:
        return tidy(points, None, outliers=self.outliers, neighbours=self.neighbours, dense=SKETCH).surface


def _other_breast(
    points: np.ndarray, frame: CupFrame, region: _Region, own: np.ndarray
) -> tuple[np.ndarray | None, float]:
    """The other side's points, mirrored about this breast (cup frame), if they show the same surface as its own; and
    the rms (mm) between the two.
    """
    mirror = mirror_of(points)
    image = region.of(_grid(frame.to_cup(mirror(points))))
    if mirror.rms > MIRROR_RMS or len(image) < MIN_POINTS:
        return None, mirror.rms
    one, other = region.sketch(own), region.sketch(image)
    if one is None or other is None:
        return None, np.inf
    about = np.linalg.norm(one.points - region.wire.mean(axis=0), axis=1) < polyline_length(region.wire) / 2
    rms = apart(one, other, one.points[about])
    return (image, rms) if rms < ALIKE else (None, rms)


def _gap_notes(path: Path, bare: Gaps | None) -> list[str]:
    """What is to be said of a scan's gaps.

    Raises:
        InputError: there is more gap than breast.
    """
    share = 0.0 if bare is None else bare.share
    cause = f"{100 * share:.0f} % of the surface between wire and upper line has no points"
    if share > GAPS_MOST:
        remedy = "Check that the file is complete and that wire and upper line lie on this breast, or scan it again"
        raise InputError(path, cause, remedy)
    return [f"{path.name}: {cause}: the cup is a guess there"] if share > GAPS_SAID else []


def _closed(wire: np.ndarray, neckline: np.ndarray) -> np.ndarray:
    """The closed curve of wire and neckline, which both run from the inner to the outer end."""
    return np.concatenate([wire, neckline[::-1][1:-1]])


def _front(cloud: Cloud, marks: Landmarks) -> np.ndarray:
    """A point in front of the chest: the apex, or else the middle of the breast's points."""
    if "apex" in marks.points:
        return marks.points["apex"]
    chosen = cloud.points if cloud.inside is None else cloud.points[cloud.inside]
    return np.median(chosen, axis=0)


def _check_outer_end(wire: np.ndarray, marks: Landmarks) -> None:
    outer = marks.points.get("outer_end")
    away = 0.0 if outer is None else float(np.linalg.norm(wire[-1] - outer))
    if away > END_TOLERANCE:
        cause = f"landmarks.outer_end: {away:.1f} mm from the outer end of the wire"
        raise InputError(marks.path, cause, f"Both mark the same point: bring them within {END_TOLERANCE:g} mm")


def _neckline(wire: np.ndarray, marks: Landmarks, frame: CupFrame, tidied: Tidy) -> tuple[np.ndarray | None, str]:
    """The upper line in the cup frame, from the wire's inner to its outer end, and where it comes from."""
    line = marks.upper_line
    if line is not None:
        gaps = [max(np.linalg.norm(way[0] - wire[0]), np.linalg.norm(way[-1] - wire[-1])) for way in (line, line[::-1])]
        if min(gaps) > END_TOLERANCE:
            cause = f"upper_line: its ends are up to {min(gaps):.1f} mm from the ends of the wire"
            remedy = f"Let it start and end at the wire's ends (within {END_TOLERANCE:g} mm)"
            raise InputError(marks.path, cause, remedy)
        return frame.to_cup(line if gaps[0] <= gaps[1] else line[::-1].copy()), _said(marks)
    strap = _mark(frame, marks, "strap_point")
    if strap is None:
        return None, "none"
    surface = tidied.surface or surface_of(tidied.points, np.array([0.0, 0.0, 1.0]))
    line = frame.to_cup(wire)
    front = facing(line, np.array([0.0, 0.0, 1.0]))
    return neckline_over(surface, line[0], strap, line[-1], front), "built"


def _said(marks: Landmarks) -> str:
    return "proposed" if marks.proposed else "given"


def _mark(frame: CupFrame, marks: Landmarks, name: str) -> np.ndarray | None:
    point = marks.points.get(name)
    return None if point is None else frame.to_cup(point)
