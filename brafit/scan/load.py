"""Scans, read, checked, cleaned and turned into the cup frame.

A load goes through stages, each a value made of the one before: `Cloud` (read), `Marked`, `Framed` (a side),
`Gathered`, `Bounded`, `Scan`. What both sides of a body need is found once (`load_sides`).
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from brafit.anatomy.confidence import Confidence
from brafit.cloud.read import FLAG, MESH_POINTS, MIN_POINTS, READ_SECONDS, Cloud, read_cloud
from brafit.cloud.reader import Reader
from brafit.errors import ConfigError, InputError
from brafit.geometry.order import along_curve
from brafit.landmarks.cup_frame import CupFrame
from brafit.landmarks.file import SIDES, Landmarks, landmarks_path
from brafit.landmarks.plausibility import check_whole_wire
from brafit.landmarks.units import MILLIMETRES, Units
from brafit.remarks import Remark
from brafit.scan.framed import Framed, framed
from brafit.scan.marked import Marked, origin_of, with_marks
from brafit.scan.notes import notes_on
from brafit.scan.region import Gathered, Gathering
from brafit.scan.wiring import Wiring
from brafit.surface.cleaning import Cleaned, Cleaning, check_settings, finish
from brafit.surface.cropping import facing, neckline_over
from brafit.surface.gaps import DataGaps, gaps
from brafit.surface.normals import FRONT, surface_of
from brafit.surface.thickness import fills_a_volume
from brafit.underwires.sizes import wire_size

MOSTLY = 0.98
"""Share of a mesh's points elsewhere from which on that is told as the cause: of a whole body, a breast is 2 %."""
GAPS_MOST = 0.6
"""Share of the surface between wire and upper line without data from which on a scan is refused."""


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
        notes: what the user should know of it.
        assumed: places on the surface that is assumed where the scan has no data, for the fit only.
        removed: what the cleaning took because it lies on no surface.
        spacing: of the points, mm (`brafit.surface.coverage.spacing_of`); None: not known, as for other points.
        gap_share: share of the surface between wire and upper line without data; None without an upper line.
        confidence: how far landmarks can be trusted that nobody looked at; None for given ones.
        own_wire: the wire line that the scan has itself, where a wire of a size is laid instead.
        away: how far lines and points that were marked by hand lie from the cloud, by name, mm (root mean square).
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
    notes: tuple[Remark, ...] = ()
    assumed: Float[np.ndarray, "g 3"] = field(default_factory=lambda: np.empty((0, 3)))
    removed: Float[np.ndarray, "r 3"] = field(default_factory=lambda: np.empty((0, 3)))
    spacing: float | None = None
    gap_share: float | None = None
    confidence: Confidence | None = None
    own_wire: Float[np.ndarray, "j 3"] | None = None
    away: Mapping[str, float] = field(default_factory=dict)

    @property
    def curve(self) -> Float[np.ndarray, "c 3"] | None:
        """The closed curve that bounds the cup: wire and neckline; None without a neckline."""
        return None if self.neckline is None else closed(self.wire, self.neckline)


@dataclass(frozen=True)
class Origin:
    """Where a scan's lines and marks come from.

    Attributes:
        marks: `given`, `mirrored` (from the other side) or `proposed`.
        wire: `given`, `mirrored`, `proposed`, `detected` (the crease) or `size NAME`.
        wire_guessed: share of the wire's length that no crease in the scan shows; None for a given wire.
        neckline: `given`, `proposed`, `built` (from ends and strap point) or `none`.
        wire_turned: the wire was given from its outer end.
    """

    marks: str
    wire: str
    wire_guessed: float | None
    neckline: str
    wire_turned: bool = False


@dataclass(frozen=True, eq=False)
class Bounded:
    """What bounds a cup, in the cup frame.

    Attributes:
        neckline: the upper line, inner end first, or None.
        origin: of the neckline: `given`, `proposed`, `built` or `none`.
        curve: the closed curve of wire and neckline, or None.
    """

    neckline: Float[np.ndarray, "m 3"] | None
    origin: str
    curve: Float[np.ndarray, "c 3"] | None


@dataclass(frozen=True)
class Preparation:
    """How a cloud becomes a scan: the settings of the group `scan`, but for the side.

    Attributes:
        points: points of the fit at most, evenly spread (`brafit.surface.thinning.thin`); None: all.
        outliers: standard deviations above the mean distance to the neighbours at which a point is one; None: none is.
        neighbours: as many as that distance is taken to.
        units: unit of cloud and landmark file, one of `brafit.landmarks.units.MILLIMETRES`; None: what the landmark
            file says, else found.
        wire: None: as the landmark file has it, detected where it has none; `detect`: always detected; a size of
            `brafit.underwires.sizes`: a wire of that size, placed best.
        propose: propose landmarks where there is no landmark file.
        symmetry: take the points of both breasts of a torso for either cup, where they are mirror images within
            `brafit.surface.symmetry.ALIKE`.
        bridge: assume a surface where there are no data (`Scan.assumed`).
        read_seconds: time limit of the reader, s.
        mesh_points: points to sample on a mesh.
        apart: read the file in a process of its own, see `read_cloud`.
        readers: of other kinds of files, see `read_cloud`.

    Raises:
        ConfigError: a setting out of its range.
    """

    points: int | None = 2000
    outliers: float | None = 3.0
    neighbours: int = 16
    units: str | None = None
    wire: str | None = None
    propose: bool = False
    symmetry: bool = True
    bridge: bool = True
    read_seconds: float = READ_SECONDS
    mesh_points: int = MESH_POINTS
    apart: bool = True
    readers: Sequence[Reader] = ()

    def __post_init__(self) -> None:
        check_settings(self.points, self.outliers, self.neighbours)
        _check_choice("units", self.units, tuple(MILLIMETRES))
        if self.wire not in (None, "detect"):
            wire_size(self.wire)

    def read(self, path: Path) -> Cloud:
        """The cloud of a file, see `read_cloud`."""
        limits = {"seconds": self.read_seconds, "mesh_points": self.mesh_points}
        return read_cloud(path, **limits, apart=self.apart, readers=self.readers)


def load_scan(
    path: str | Path | Cloud,
    *,
    side: str | None = None,
    name: str | None = None,
    landmarks: str | Path | Landmarks | None = None,
    **settings: Any,
) -> Scan:
    """Load a cloud and the landmark file beside it: one breast.

    Args:
        path: the cloud's file, or the cloud where it has been read; its landmark file has the same stem and the
            extension `.json`.
        side: the breast to take, `left` or `right`; None: the one that the landmark file marks (first). One that it
            does not mark gets the other's marks, mirrored at the body's plane of symmetry.
        name: name of the scan; the file's stem if None.
        landmarks: the landmark file, if it is not beside the cloud; or the marks of one breast.
        settings: what `Preparation` takes: `points=500, propose=True`.

    Raises:
        InputError: one line naming file, cause and remedy.
        ConfigError: a setting out of its range.
        Open3DError: Open3D cannot be imported.
    """
    (scan,) = load_sides(path, (side,), name=name, landmarks=landmarks, **settings)
    if isinstance(scan, InputError):
        raise scan
    return scan


def load_sides(
    path: str | Path | Cloud,
    sides: Sequence[str | None] = SIDES,
    *,
    name: str | None = None,
    landmarks: str | Path | Landmarks | None = None,
    **settings: Any,
) -> list[Scan | InputError]:
    """Load breasts of one cloud: it is read once, and what both sides need is found once.

    Args:
        path: the cloud's file, or the cloud where it has been read.
        sides: the breasts to take, each as `side` of `load_scan`.
        name: of all these scans; the file's stem if None.
        landmarks: the landmark file, if it is not beside the cloud; or the marks of one breast.
        settings: what `Preparation` takes.

    Returns:
        for each side what `load_scan` gives, or the error that it raises.

    Raises:
        ConfigError: a setting out of its range.
        Open3DError: Open3D cannot be imported.
    """
    for side in sides:
        _check_choice("side", side, SIDES)
    prepared = _preparation(settings)
    file = path.path if isinstance(path, Cloud) else Path(path)
    marks = landmarks if isinstance(landmarks, Landmarks) else Path(landmarks or landmarks_path(file))
    try:
        raw = path if isinstance(path, Cloud) else prepared.read(file)
        marked = with_marks(raw, marks, prepared.units, prepared.propose)
    except InputError as error:
        return [error] * len(sides)
    wiring = Wiring(marked, prepared.wire)
    gathering = Gathering(marked, prepared.outliers, prepared.neighbours, prepared.symmetry)
    return [_loaded(name or file.stem, side, wiring, gathering, prepared) for side in sides]


def _preparation(settings: Mapping[str, Any]) -> Preparation:
    known = [item.name for item in fields(Preparation)]
    for name in settings:
        if name not in known:
            meant = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {meant[0]}? " if meant else ""
            raise ConfigError(f"scan.{name}: there is no such setting; {hint}known are {', '.join(known)}")
    return Preparation(**settings)


def _loaded(
    name: str, side: str | None, wiring: Wiring, gathering: Gathering, prepared: Preparation
) -> Scan | InputError:
    """A side of a marked scan, through all stages."""
    marked = gathering.marked
    try:
        breast = framed(wiring, side)
        gathered = gathering.about(breast)
        bounded = _bounded(marked, breast, gathered)
        cleaned = _cleaned(marked, gathered, bounded, prepared.points)
        found = _gaps(marked.cloud.path, cleaned, bounded)
    except InputError as error:
        return error
    bridged = found if prepared.bridge else None
    assumed = 0.0 if bridged is None else bridged.share
    notes = notes_on(marked, breast, gathered, bounded.origin, cleaned.steps, assumed, chosen=side is not None)
    return _scan(name, marked, breast, gathered, bounded, cleaned, found, prepared.bridge, notes)


def closed(wire: Float[np.ndarray, "k 3"], neckline: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "c 3"]:
    """The closed curve of wire and neckline, which both run from the inner to the outer end."""
    return np.concatenate([wire, neckline[::-1][1:-1]])


def _check_choice(key: str, value: str | None, choices: tuple[str, ...]) -> None:
    if value is not None and value not in choices:
        raise ConfigError(f"scan.{key}: {value}, but it must be one of {', '.join(choices)}")


def _bounded(marked: Marked, breast: Framed, gathered: Gathered) -> Bounded:
    """The lines between which the cup lies.

    Raises:
        InputError: nothing says where on a torso the cup ends; the wire is too short for a breast.
    """
    neckline, origin = breast.upper_line(), origin_of(breast.marks)
    strap = breast.mark("strap_point")
    if neckline is None and strap is not None:
        tidied = gathered.tidied
        surface = tidied.surface or surface_of(tidied.points, FRONT)
        front = facing(breast.wire, FRONT)
        neckline, origin = neckline_over(surface, breast.wire[0], strap, breast.wire[-1], front), "built"
    if neckline is not None:
        return Bounded(neckline, origin, closed(breast.wire, neckline))
    if gathered.whole:
        check_whole_wire(breast.marks, marked.cloud.points)
        raise InputError(
            marked.cloud.path,
            "the cloud is more than one breast, and nothing says where the cup ends",
            f"Mark landmarks.strap_point or upper_line, or give the points a property '{FLAG}', 1 on the breast",
        )
    return Bounded(None, "none", None)


def _cleaned(marked: Marked, gathered: Gathered, bounded: Bounded, points: int | None) -> Cleaned:
    """The breast's points, in the order of `along_curve`.

    Raises:
        InputError: too few are left, or they lie on no surface.
    """
    cleaned = finish(
        gathered.tidied,
        bounded.curve if marked.cloud.inside is None else None,
        count=points,
        not_finite=marked.cloud.dropped,
        elsewhere=gathered.elsewhere,
        other_side=gathered.other_side,
    )
    kept = len(cleaned.points)
    if kept < min(MIN_POINTS, points or MIN_POINTS):
        raise _too_few(marked.cloud, cleaned.steps)
    if fills_a_volume(cleaned.dense):
        remedy = "Export the surface that was scanned; noise throughout a volume, or the inside of a body, has no shape"
        raise InputError(marked.cloud.path, "its points lie on no surface: they fill a volume", remedy)
    return replace(cleaned, points=cleaned.points[along_curve(cleaned.points)])


def _too_few(cloud: Cloud, steps: Cleaning) -> InputError:
    """The error of a breast of which hardly a point is left."""
    left, read = f"only {steps.used} distinct points are left", f"{steps.read:,}"
    if cloud.faces and steps.elsewhere > MOSTLY * steps.read:
        cause = f"{left} of {read} sampled on its mesh by area: {steps.elsewhere:,} of them are far from the breast"
        remedy = "Cut off what is no body, such as floor and walls, or raise scan.mesh_points"
        return InputError(cloud.path, cause, remedy)
    remedy = "Check wire and upper line; raise scan.outliers (null keeps all points), or scan more densely"
    return InputError(cloud.path, f"{left} of {read} after cleaning and cropping", remedy)


def _gaps(path: Path, cleaned: Cleaned, bounded: Bounded) -> DataGaps | None:
    """The gaps of a breast that has an upper line.

    Raises:
        InputError: there is more gap than breast.
    """
    found = None if bounded.curve is None else gaps(cleaned.points, cleaned.dense, bounded.curve)
    if found is not None and found.share > GAPS_MOST:
        remedy = "Check that the file is complete and that wire and upper line lie on this breast, or scan it again"
        raise InputError(path, _bare(found), remedy)
    return found


def _bare(found: DataGaps) -> str:
    return f"{100 * found.share:.0f} % of the surface between wire and upper line has no points"


def _scan(
    name: str,
    marked: Marked,
    breast: Framed,
    gathered: Gathered,
    bounded: Bounded,
    cleaned: Cleaned,
    found: DataGaps | None,
    bridge: bool,
    notes: tuple[Remark, ...],
) -> Scan:
    bare = np.empty((0, 3)) if found is None or not bridge else found.places
    return Scan(
        name=name,
        path=marked.cloud.path,
        side=breast.marks.side,
        points=cleaned.points,
        wire=breast.wire,
        neckline=bounded.neckline,
        strap_point=breast.mark("strap_point"),
        apex=breast.mark("apex"),
        frame=breast.frame,
        cleaning=cleaned.steps,
        dense=cleaned.dense,
        units=marked.units,
        origin=Origin(breast.marks_origin, breast.wire_origin, breast.guessed, bounded.origin, breast.turned),
        notes=notes,
        assumed=bare[along_curve(bare)],
        removed=gathered.tidied.removed,
        spacing=None if found is None else found.spacing,
        gap_share=None if found is None else found.share,
        confidence=breast.confidence,
        own_wire=None if breast.own_wire is None else breast.frame.to_cup(breast.own_wire),
        away=breast.away,
    )
