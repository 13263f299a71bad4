"""Is this a breast in millimetres with its wire on it? One error each for what usually goes wrong.

Measured on scans of 14 breasts: wire length 186 to 273 mm; diagonal of the cloud's box 1.0 to 1.3 wire lengths (whole
torsos: 3.8 to 5.3); half of the points within 0.28 to 0.37 wire lengths from the middle of the wire (torsos: 0.9 to
1.4); median distance from wire points to the cloud 0.5 to 2.1 mm, and 7.8 mm or more for a tenth of them where the
breast hides the wire. The bounds here are wide around these.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from brafit.errors import InputError
from brafit.scan.landmarks import POINT_NAMES, Landmarks
from brafit.scan.read import FLAG, MIN_POINTS, Cloud

WIRE_LENGTH = (80.0, 600.0)
"""Lengths of a wire, mm."""
CLOUD_SIZE = (0.6, 8.0)
"""Diagonal of the cloud's box over the wire length; below that the cloud is in another unit."""
TYPICAL_WIRE, TYPICAL_SIZE = 200.0, 1.2
WIRE_DISTANCE = 30.0
"""Largest median distance from wire to cloud, mm."""
MARK_DISTANCE = 50.0
"""Largest distance from a marked point to the cloud, mm."""
BREAST_REACH = 0.6
"""Largest median distance of the points from the middle of the wire, over the wire length."""

UNITS = {"metres": 1000.0, "decimetres": 100.0, "inches": 25.4, "centimetres": 10.0}


def check_scan(cloud: Cloud, landmarks: Landmarks) -> None:
    """Refuse a scan whose cloud and landmarks cannot be what they should be.

    Raises:
        InputError: wire of an impossible length; cloud in another unit than the wire; wire or marks away from the
            cloud; too few points flagged inside; a cloud without the flag that is no single breast.
    """
    length = polyline_length(landmarks.wire)
    _check_wire_length(landmarks.path, length)
    _check_cloud_size(cloud.path, cloud.points, length)
    _check_distances(landmarks, cloud)
    if cloud.inside is None:
        _check_reach(cloud.path, cloud.points, landmarks.wire, length)
    else:
        _check_flag(cloud.path, cloud.inside)


def polyline_length(line: Float[np.ndarray, "k 3"]) -> float:
    """Sum of the lengths of a polyline's segments."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _likely_unit(value: float, low: float, high: float, typical: float) -> tuple[str, float] | None:
    """The unit (name, millimetres) that brings `value` between low and high, and nearest to what is typical."""
    fitting = [(name, factor) for name, factor in UNITS.items() if low <= value * factor <= high]
    return min(fitting, key=lambda unit: abs(math.log(value * unit[1] / typical)), default=None)


def _check_wire_length(file: Path, length: float) -> None:
    low, high = WIRE_LENGTH
    if low <= length <= high:
        return
    unit = _likely_unit(length, low, high, TYPICAL_WIRE)
    cause = f"wire: {length:.4g} mm long, it must be {low:g} to {high:g} mm"
    if unit:
        name, factor = unit
        remedy = f"It looks like {name}: multiply its coordinates by {factor:g}, and the cloud's if it is alike"
    else:
        remedy = "Check the unit, and that the points are in order from the inner to the outer end"
    raise InputError(file, cause, remedy)


def _check_cloud_size(file: Path, points: np.ndarray, length: float) -> None:
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    low, high = CLOUD_SIZE
    if size >= low * length:
        return
    unit = _likely_unit(size / length, low, high, TYPICAL_SIZE) if size else None
    cause = f"the whole cloud is only {size:.3g} mm across, its wire is {length:.0f} mm long"
    if unit:
        name, factor = unit
        raise InputError(file, cause, f"It looks like {name}: multiply the cloud's coordinates by {factor:g}")
    raise InputError(file, cause, "Check that cloud and landmark file belong together and are both in millimetres")


def _check_distances(landmarks: Landmarks, cloud: Cloud) -> None:
    tree = KDTree(cloud.points)
    remedy = f"Check that the landmark file belongs to {cloud.path.name} and is in the same frame"
    away = float(np.median(tree.query(landmarks.wire)[0]))
    if away > WIRE_DISTANCE:
        raise InputError(landmarks.path, f"wire: nowhere near the cloud, {away:.0f} mm away from it", remedy)
    if landmarks.upper_line is not None:
        away = float(np.median(tree.query(landmarks.upper_line)[0]))
        if away > WIRE_DISTANCE:
            raise InputError(landmarks.path, f"upper_line: nowhere near the cloud, {away:.0f} mm away from it", remedy)
    for name in POINT_NAMES:
        if name in landmarks.points:
            away = float(tree.query(landmarks.points[name])[0])
            if away > MARK_DISTANCE:
                raise InputError(landmarks.path, f"landmarks.{name}: {away:.0f} mm away from the cloud", remedy)


def _check_reach(file: Path, points: np.ndarray, wire: np.ndarray, length: float) -> None:
    reach = float(np.median(np.linalg.norm(points - wire.mean(axis=0), axis=1)))
    if reach > BREAST_REACH * length:
        raise InputError(
            file,
            f"the cloud is more than one breast: half of its points lie over {reach:.0f} mm off the middle of its wire",
            f"Cut it along wire and upper line, or mark the breast's points by a property '{FLAG}' of 1, all others 0",
        )


def _check_flag(file: Path, inside: Bool[np.ndarray, " n"]) -> None:
    count = int(inside.sum())
    if count < MIN_POINTS:
        raise InputError(
            file,
            f"only {count} of {len(inside)} points are flagged '{FLAG}', at least {MIN_POINTS} are needed",
            f"Set '{FLAG}' to 1 for the points between wire and upper line, or remove the property to use all points",
        )
