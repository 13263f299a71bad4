"""Is this a breast in millimetres with its wire on it? One error each for what usually goes wrong.

Measured on scans of 14 breasts: wire length 186 to 273 mm; diagonal of the cloud's box 1.0 to 1.3 wire lengths (whole
torsos: 3.8 to 5.3); half of the points within 0.28 to 0.37 wire lengths from the middle of the wire (torsos: 0.9 to
1.4); median distance from wire points to the cloud 0.5 to 2.1 mm, and 7.8 mm or more for a tenth of them where the
breast hides the wire. The bounds here are wide around these.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from brafit.cloud.read import FLAG, MIN_POINTS, Cloud
from brafit.errors import ApartError, InputError, OtherUnitError
from brafit.geometry.polyline import evenly_spaced, polyline_length
from brafit.landmarks.cup_frame import chord_of
from brafit.landmarks.fields import POINT_NAMES
from brafit.landmarks.file import WIRE_POINTS, Landmarks
from brafit.landmarks.units import NAMES, WIRE_USUAL, unit_of
from brafit.surface.neighbours import apart, distances_to, nearest, tree_of

WIRE_LENGTH = (80.0, 600.0)
"""Lengths of a wire, mm."""
CLOUD_SIZE = 0.6
"""Least diagonal of the cloud's box over the wire length."""
WIRE_DISTANCE = 30.0
"""Largest median distance from wire to cloud, mm."""
MARK_DISTANCE = 50.0
"""Largest distance from a marked point to the cloud, mm."""
BREAST_REACH = 0.6
"""Largest median distance of the points from the middle of the wire, over the wire length."""

DISTINCT = 8.0
"""Two marks nearer to each other (mm) are meant for one place: of 14 breasts, 30 and more apart."""
ON_LINE, FAR_OFF = 10.0, 30.0
"""A marked point this near to a line (mm) lies on it, and this far from it on another. Of 18 scans strap points are on
the upper line and wires' bottoms on the wire within 3, and 75 and more from the other."""
ON_SKIN = 5.0
"""Median distance (mm) from which on lines and points lie on the skin."""
SPARSE = 2.0
"""A place of the skin that was scanned is at most so many times as far from a point as points are from one another."""
PARTLY = 0.25
"""Share of a line on the cloud from which on it is the rest that is told."""
TO_AND_FRO = 1.5
"""A line so many times as long as that through the means of its neighbouring points is none: 1.0 of 14 breasts, below
1.3 where only four of their points are left."""
ROUNDABOUT, COARSE = 1.2, 0.04
"""Nor is one so many times as long as the shortest tree that joins its points (1.00 of 18 breasts), taken at steps of
so much of its size, within which a hand may tremble."""

COVERED, COVERED_WITH_MARGIN = 1.5, 1.75
"""Largest size of a breast, and of one with its margin, over the length of a wire that is as flat as half of one. Of 14
breasts 0.9 to 1.1 and 1.0 to 1.3 of the whole wire's length, but 1.8 to 2.3 and 2.1 to 2.6 of a half's."""
BOW = 0.35
"""Height over span from which on a wire is a whole one: 0.44 to 0.59 on those, 0.13 to 0.24 of halves. A line of which
both halves are so is the wires of two breasts."""
ONE_BREAST = 450.0
"""Largest diagonal (mm) of a cloud that holds one breast; those were up to 310 mm, torsos 890 or more."""


def check_scan(cloud: Cloud, landmarks: Landmarks) -> dict[str, float]:
    """Refuse a scan whose cloud and landmarks (both in millimetres) cannot be what they should be.

    Returns:
        how far each given line and marked point is off the cloud: root mean square, mm, where what is farther than
        `MARK_DISTANCE` counts as that; less what the distance between the cloud's points explains.

    Raises:
        InputError: two marks in one place; a line whose points are not in order; a wire of an impossible length, that
            is closed or straight, of two breasts, or the upper line, or that covers only a part of the breast's line; a
            marked point away from the line on which it lies; too few points flagged inside.
        ApartError: cloud too small for the wire; wire or marks away from the cloud.
    """
    _check_distinct(landmarks)
    for name, line in (("wire", landmarks.wire), ("upper_line", landmarks.upper_line)):
        if line is not None:
            _check_order(landmarks.path, name, line)
    if landmarks.wire is not None:
        length = polyline_length(landmarks.wire)
        _check_wire_length(landmarks.path, length)
        _check_one_bow(landmarks.path, landmarks.wire)
        _check_cloud_size(cloud.path, cloud.points, length)
    away = _distances(landmarks, cloud)
    _check_lines(landmarks)
    if landmarks.wire is not None:
        _check_covers(landmarks, cloud)
    if cloud.inside is not None:
        _check_flag(cloud.path, cloud.inside)
    return away


def is_one_breast(points: Float[np.ndarray, "n 3"], wire: Float[np.ndarray, "k 3"]) -> bool:
    """Whether a cloud holds a breast and its margin only: half of its points are near the middle of the wire."""
    reach = float(np.median(np.linalg.norm(points - wire.mean(axis=0), axis=1)))
    return reach <= BREAST_REACH * polyline_length(wire)


def _check_wire_length(file: Path, length: float) -> None:
    low, high = WIRE_LENGTH
    if low <= length <= high:
        return
    cause = f"wire: {length:.4g} mm long, it must be {low:g} to {high:g} mm"
    unit = unit_of(length, WIRE_LENGTH, WIRE_USUAL)
    if unit:
        both = f'write "units": "{unit}", or set scan.units={unit}, if the cloud is in {NAMES[unit]} too'
        out = f'take "units" out of {file.name}, and scan.units off the command, if only the landmarks are'
        remedy = f"It looks like {NAMES[unit]}: {both}; {out}"
        raise OtherUnitError(file, cause, remedy, unit)
    remedy = "Check the unit, and that the points are in order from the inner to the outer end"
    raise InputError(file, cause, remedy)


def _check_distinct(landmarks: Landmarks) -> None:
    for one, other in itertools.combinations(landmarks.points, 2):
        between = float(np.linalg.norm(landmarks.points[one] - landmarks.points[other]))
        if between < DISTINCT:
            cause = f"landmarks.{one} and landmarks.{other} are {between:.1f} mm apart, which are two different places"
            raise InputError(landmarks.path, cause, "Correct the one that is wrong, or leave it out")


def _check_lines(landmarks: Landmarks) -> None:
    """Refuse a marked point that is away from its line, lines that are swapped (the points then lie on the other one),
    and an upper line that is the wire.
    """
    lines = {"wire": landmarks.wire, "upper_line": landmarks.upper_line}
    even = {name: evenly_spaced(line, 400) for name, line in lines.items() if line is not None}
    wire, upper = even.get("wire"), even.get("upper_line")
    between = np.inf if wire is None or upper is None else float(np.median(distances_to(wire, upper, np.inf)))
    if between < ON_LINE:
        cause = f"upper_line: it runs along the wire, {between:.1f} mm from it, and leaves no cup between them"
        raise InputError(
            landmarks.path, cause, "Trace the upper edge: from the inner end by the strap to the outer end"
        )
    for name, own, other in (("strap_point", "upper_line", "wire"), ("wire_bottom", "wire", "upper_line")):
        point = landmarks.points.get(name)
        if point is None or own not in even:
            continue
        away = {line: float(distances_to(points, point[None], np.inf)[0]) for line, points in even.items()}
        if away[own] <= FAR_OFF:
            continue
        if away.get(other, np.inf) < ON_LINE:
            cause = f"wire and upper_line seem to be swapped: landmarks.{name} lies on {other}, {away[own]:.0f} mm"
            raise InputError(landmarks.path, f"{cause} from {own}", "Let each stand under the other's name")
        cause = f"landmarks.{name}: {away[own]:.0f} mm from {own}, on which it should lie"
        raise InputError(landmarks.path, cause, f"Correct the point or {own}, or leave the one that is wrong out")


def _check_order(file: Path, name: str, line: np.ndarray) -> None:
    """Refuse a line whose points jump to and fro, or stand in the wrong order."""
    smooth = np.concatenate([line[:1], (line[:-2] + 2 * line[1:-1] + line[2:]) / 4, line[-1:]])
    coarse = _coarse(line)
    tree = float(minimum_spanning_tree(cdist(coarse, coarse)).sum())
    for length, plain, most in (
        (polyline_length(line), polyline_length(smooth), TO_AND_FRO),
        (polyline_length(coarse), tree, ROUNDABOUT),
    ):
        if length > most * plain:
            long = f"{length:.0f} mm from point to point, {plain:.0f} mm as a smooth line"
            remedy = "List them in order from the inner to the outer end, and without jumps"
            raise InputError(file, f"{name}: its points run to and fro: {long}", remedy)


def _coarse(line: np.ndarray) -> np.ndarray:
    """Those points of a line that are a step (`COARSE`) and more from the one before."""
    step, kept = COARSE * float(np.linalg.norm(np.ptp(line, axis=0))), [line[0]]
    for point in line[1:]:
        if np.linalg.norm(point - kept[-1]) >= step:
            kept.append(point)
    return np.stack(kept)


def _check_one_bow(file: Path, wire: np.ndarray) -> None:
    """Refuse a wire that is closed or straight, or two bows, as of two breasts."""
    even = evenly_spaced(wire, 201)
    chord_of(even, file)
    if min(_bow(even[:101]), _bow(even[100:])) >= BOW:
        cause = "wire: it is two bows, as if the wires of both breasts were one line"
        raise InputError(file, cause, "Give one breast's wire; both stand in breasts, each with its side")


def _check_cloud_size(file: Path, points: np.ndarray, length: float) -> None:
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if size < CLOUD_SIZE * length:
        distinct = len(np.unique(points, axis=0))
        if distinct < MIN_POINTS:
            cause = f"only {distinct} of its {len(points)} points are distinct"
            raise InputError(file, cause, "Export the cloud again, or scan again")
        cause = f"the whole cloud is only {size:.3g} mm across, its wire is {length:.0f} mm long"
        remedy = "Check that cloud and landmark file belong together, and their units (scan.units)"
        raise ApartError(file, cause, remedy)


def _distances(landmarks: Landmarks, cloud: Cloud) -> dict[str, float]:
    """What `check_scan` returns; an `ApartError` if a line or a point lies too far away."""
    remedy = f"Check that the landmark file belongs to {cloud.path.name} and is in the same frame"
    lines = {"wire": landmarks.wire, "upper_line": landmarks.upper_line}
    marks = {f"landmarks.{name}": landmarks.points[name][None] for name in POINT_NAMES if name in landmarks.points}
    given = {name: line for name, line in lines.items() if line is not None} | marks
    if not given:
        return {}
    given = {name: evenly_spaced(line, 100) if name in lines else line for name, line in given.items()}
    places = np.concatenate(list(given.values()))
    ends = np.cumsum([len(line) for line in given.values()])[:-1]
    found, explained = dict[str, float](), SPARSE * _apart(cloud.points, places)
    for name, away in zip(given, np.split(distances_to(cloud.points, places, MARK_DISTANCE), ends), strict=True):
        limit = WIRE_DISTANCE if name in lines else MARK_DISTANCE
        if np.median(away) > limit:
            if (away < ON_LINE).mean() > PARTLY and name in lines:
                raise InputError(landmarks.path, *_partly(name, away, cloud.path))
            far = float(np.median(distances_to(cloud.points, given[name], np.inf)))
            where = f"{far:.0f} mm away from the cloud"
            if name in lines:
                where = f"nowhere near the cloud, {far:.0f} mm away from it"
            if len(places) > WIRE_POINTS and (axes := _axes_between(cloud.points, places)):
                remedy = f"Export cloud and landmarks with the same axes: with {axes} for x, y, z they lie on it"
            raise ApartError(landmarks.path, f"{name}: {where}", remedy)
        found[name] = float(np.sqrt(max(0.0, np.mean(np.minimum(away, MARK_DISTANCE) ** 2) - explained**2)))
    return found


def _axes_between(points: np.ndarray, places: np.ndarray) -> str:
    """The axes of the places, exchanged or turned about, that a cloud has as x, y and z, where they then lie on it."""
    tree, found = tree_of(points), dict[str, float]()
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            turned = places[:, order] * signs
            words = ", ".join("-"[: sign < 0] + "xyz"[k] for k, sign in zip(order, signs, strict=True))
            found[words] = float(np.median(nearest(tree, turned, 1, MARK_DISTANCE)[0]))
    best = min(found, key=lambda words: found[words])
    return best if found[best] < ON_SKIN and best != "x, y, z" else ""


def _partly(name: str, away: np.ndarray, cloud: Path) -> tuple[str, str]:
    """Cause and remedy of a line of which a part lies on the cloud, and the rest far away from it."""
    rest = 100 * (away >= ON_LINE).mean()
    remedy = f"Check that {cloud.name} is complete, and that the line follows the skin of this breast"
    return f"{name}: {rest:.0f} % of it is away from the cloud, the rest lies on it", remedy


def _apart(points: np.ndarray, places: np.ndarray) -> float:
    """How far points near some places are from one another."""
    low, high = places.min(axis=0) - FAR_OFF, places.max(axis=0) + FAR_OFF
    found = apart(points[((points >= low) & (points <= high)).all(axis=1)])
    return found if np.isfinite(found) else 0.0


def _check_covers(landmarks: Landmarks, cloud: Cloud) -> None:
    assert landmarks.wire is not None
    if cloud.inside is None or not cloud.inside.any():
        check_whole_wire(landmarks, cloud.points, COVERED_WITH_MARGIN)
    else:
        check_whole_wire(landmarks, cloud.points[cloud.inside], COVERED)


def check_whole_wire(landmarks: Landmarks, points: Float[np.ndarray, "n 3"], largest: float = 0.0) -> None:
    """Refuse a wire that covers only a part of the line under a breast.

    Args:
        landmarks: with a wire.
        points: of one breast, if they are no more than that (`ONE_BREAST`).
        largest: size of a breast over the length of its wire that is possible.

    Raises:
        InputError: the wire is too flat and too short for the points.
    """
    assert landmarks.wire is not None
    size, length = float(np.linalg.norm(np.ptp(points, axis=0))), polyline_length(landmarks.wire)
    if largest * length < size <= ONE_BREAST and _bow(landmarks.wire) < BOW:
        what = f"it is {length:.0f} mm long and hardly bent, the points reach over {size:.0f} mm"
        remedy = "Trace the whole crease, from its inner to its outer end"
        raise InputError(landmarks.path, f"wire: it covers only a part of the breast's line: {what}", remedy)


def _bow(wire: np.ndarray) -> float:
    """Height of a line above its chord, over the chord's length."""
    offset, chord = wire - wire[0], wire[-1] - wire[0]
    span = max(float(np.linalg.norm(chord)), 1e-9)
    return float(np.linalg.norm(offset - np.outer(offset @ chord, chord) / span**2, axis=1).max()) / span


def _check_flag(file: Path, inside: Bool[np.ndarray, " n"]) -> None:
    count = int(inside.sum())
    if count < MIN_POINTS:
        raise InputError(
            file,
            f"only {count} of {len(inside)} points are flagged '{FLAG}', at least {MIN_POINTS} are needed",
            f"Set '{FLAG}' to 1 for the points between wire and upper line, or remove the property to use all points",
        )
