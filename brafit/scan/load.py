"""One scan, read, checked, cleaned and turned into the cup frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.errors import InputError
from brafit.scan.checks import check_scan
from brafit.scan.clean import Cleaning, clean
from brafit.scan.frame import END_TOLERANCE, CupFrame, frame_from_wire, from_inner_end
from brafit.scan.landmarks import Landmarks, landmarks_path, read_landmarks
from brafit.scan.read import MIN_POINTS, Cloud, read_cloud


@dataclass(frozen=True, eq=False)
class Scan:
    """A scan, ready to be fitted. Positions are in millimetres, in the cup frame.

    Attributes:
        name: what its results are called.
        path: the cloud's file.
        side: the wearer's `left` or `right` breast; a right one is mirrored here.
        points: the cleaned cloud.
        wire: the wire line, inner end first (at the origin).
        neckline: the upper line, inner end first, or None.
        strap_point, apex: marked points, or None.
        frame: leads back to the scan's own frame.
        cleaning: what each step of the cleaning took.
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


def load_scan(
    path: str | Path,
    *,
    points: int | None = 2000,
    outliers: float | None = 3.0,
    neighbours: int = 16,
    name: str | None = None,
) -> Scan:
    """Load a cloud and the landmark file beside it.

    Args:
        path: the cloud; its landmark file has the same stem and the extension `.json`.
        points, outliers, neighbours: see `brafit.scan.clean.clean` (there `points` is `count`).
        name: name of the scan; the file's stem if None.

    Raises:
        InputError: one line naming file, cause and remedy.
        ConfigError: a setting out of its range.
        Open3DError: Open3D cannot be imported.
    """
    path = Path(path)
    cloud = read_cloud(path)
    marks = read_landmarks(_existing_landmarks(path))
    check_scan(cloud, marks)
    wire = from_inner_end(marks.wire, marks.points.get("inner_end"), marks.path)
    _check_outer_end(wire, marks)
    frame = frame_from_wire(wire, marks.side, _front(cloud, marks), marks.path)
    kept, cleaning = clean(
        frame.to_cup(cloud.points), cloud.inside, count=points, outliers=outliers, neighbours=neighbours
    )
    if len(kept) < min(MIN_POINTS, points or MIN_POINTS):
        cause = f"only {len(kept)} distinct points are left of {cleaning.read} after cleaning"
        raise InputError(path, cause, "Raise scan.outliers (null keeps all points), or scan more densely")
    neckline = _neckline(wire, marks)
    return Scan(
        name=path.stem if name is None else name,
        path=path,
        side=marks.side,
        points=kept,
        wire=frame.to_cup(wire),
        neckline=None if neckline is None else frame.to_cup(neckline),
        strap_point=_mark(frame, marks, "strap_point"),
        apex=_mark(frame, marks, "apex"),
        frame=frame,
        cleaning=cleaning,
    )


def _existing_landmarks(path: Path) -> Path:
    marks = landmarks_path(path)
    if not marks.exists():
        remedy = f"Write {marks.name} with at least wire and side, see brafit/scan/landmarks.schema.json"
        raise InputError(path, f"no landmark file {marks.name} beside the cloud", remedy)
    return marks


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


def _neckline(wire: np.ndarray, marks: Landmarks) -> np.ndarray | None:
    """The upper line, from the wire's inner to its outer end."""
    line = marks.upper_line
    if line is None:
        return None
    gaps = [max(np.linalg.norm(way[0] - wire[0]), np.linalg.norm(way[-1] - wire[-1])) for way in (line, line[::-1])]
    if min(gaps) > END_TOLERANCE:
        cause = f"upper_line: its ends are up to {min(gaps):.1f} mm from the ends of the wire"
        raise InputError(marks.path, cause, f"Let it start and end at the wire's ends (within {END_TOLERANCE:g} mm)")
    return line if gaps[0] <= gaps[1] else line[::-1].copy()


def _mark(frame: CupFrame, marks: Landmarks, name: str) -> np.ndarray | None:
    point = marks.points.get(name)
    return None if point is None else frame.to_cup(point)
