"""A standing torso: its axes, and landmarks proposed from its shape alone, for a person to look at and correct.

Rules and figures are those of 14 breasts (parametric bodies, a mean of standing scans, one person).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.signal import find_peaks

from brafit.anatomy.wire_detection import Wire, concavity, laid, plainness, trace
from brafit.cloud.read import MIN_POINTS
from brafit.errors import InputError
from brafit.geometry.polyline import evenly_spaced
from brafit.landmarks.file import SIDES, Landmarks, landmarks_path
from brafit.surface.cleaning import averaged, inliers, tidy
from brafit.surface.cropping import facing, neckline_over
from brafit.surface.normals import Surface, settle, surface_of
from brafit.surface.symmetry import mirror_of

WHOLE, COARSE, DENSE = 60_000, 6_000, 24_000
"""Points that are looked at: of the whole body, about a breast for a first look, and for good."""
GLANCE = 3
"""For the first look every so many points are enough."""
TORSO_SIZE = 450.0
"""Least diagonal (mm) of a torso's box."""
LEAN = np.radians(6.5)
"""The long axis of a standing trunk leans back by so much."""
LEVEL = np.radians(6.0)
"""An axis of the scan that is so near to the vertical found is the vertical: scanners stand level."""
TRUNK = 40.0
"""Half width (mm) of the strip about the mirror plane that holds no arm."""
BREAST_OUT = (25.0, 160.0)
"""Distance of an apex from the mirror plane, mm."""
AROUND, NEAR = (45.0, 5.0), 25.0
"""Distance (mm, give or take) of the ring over which an apex's height is measured, and of the points that say what is
outwards."""
GORE = 20.0
"""Nearer to the mirror plane (mm) a proposed wire is moved outwards, by a quarter of this on the plane itself, so that
it keeps to its side. In 14 breasts wires end 9 to 28 mm from it."""
PROTRUDING = np.array([0.42, 0.09, 0.90])
"""Direction (outwards, up, front) in which an apex sticks out farthest."""
CAP, ABOUT = 2.0, 35.0
"""Height and radius (mm) of the cap that is looked at there."""
AREOLA, SCALE, CONVEX, LEAST = 10.0, 11.0, 0.03, 0.0005
"""About the foremost place: how wide convexity counts (mm, standard deviation), the radius (mm) it is measured in, from
what on it counts, and as what every point counts, so that a flat place keeps to the middle."""
SIDEWAYS, RAISED, NUDGE = (0.21, 3.4), (0.15, 57.0), 6.0
"""Where the wire says that the bust point lies, seen along PROTRUDING: this share of the way to a place so far (mm)
inwards of the wire's middle; higher by this share of the breast's depth over so much (mm); at most NUDGE mm in all.
Each of 14 breasts by the others' rule: within 5.7 mm of the given point, 3.1 RMS; without the wire, 8.0 and 3.4."""
STRAP_UP = 1.002
"""The strap point's height above the wire's bottom, over the span: in 14 breasts within 0.004."""
SHOULDER_OUT, SHOULDER_UP, SHOULDER_BACK = 124.0, (170.0, 240.0), (-230.0, -130.0)
"""The middle of the shoulder, mm: distance from the mirror plane (mean of 14, spread 6), and where it can lie above and
behind the apex."""
BELOW_SHOULDERS = 350.0
"""No apex lies farther below the shoulders, mm."""
LEVELS = 60.0
"""The apexes of both sides lie as high as each other to so many mm; of half a breast beside a whole one, 25."""
CELL, PROMINENCE = 6.0, 2.0
"""Steps of the height (mm) in which the foremost place is sought, and by how much (mm) it is before those above and
below it."""
RISES, RISE_SPREAD = 0.003, 6.0
"""What a millimetre of an apex's height counts in telling front from back, against concavity: breasts rise by 14 mm and
more, shoulder blades by 13 at most. An apex so much (mm) lower than the highest is no breast's."""
NECK = 0.0006
"""What a millimetre of neck counts in telling up from down, against concavity."""
BODY_SIZE = 1100.0
"""Least diagonal (mm) of a body with legs."""
TRUNK_BELOW, TRUNK_ABOVE, TRUNK_WIDTH = 600.0, 150.0, 300.0
"""What is looked at of it: from so far below the shoulders to so far above them, so far to either side (mm)."""
MIN_HOLLOW = 0.012
"""Less concavity along the wire found than this is no breast."""
BREAST_AXES = np.array([[0.18, -0.95, 0.23], [0.88, 0.05, -0.47], [0.43, 0.28, 0.85]])
"""Mean axes x, y, z of the cup frames (left) in the body's (outwards, up, front)."""


@dataclass(frozen=True, eq=False)
class Body:
    """Axes of a standing body: unit vectors to the wearer's left, up and to the front, and the mirror plane's offset
    along the first."""

    left: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    front: Float[np.ndarray, "3"]
    offset: float

    def outwards(self, side: str) -> Float[np.ndarray, "3 3"]:
        """Rows: outwards, up, front, for a side; right-handed for the left one, mirrored for the right one."""
        return np.stack([self.left if side == "left" else -self.left, self.up, self.front])

    def away(self, points: Float[np.ndarray, "*n 3"], side: str) -> Float[np.ndarray, "*n"]:
        """Distances of points from the mirror plane, outwards of a side."""
        return points @ self.outwards(side)[0] - (self.offset if side == "left" else -self.offset)

    def protruding(self, side: str) -> Float[np.ndarray, "3"]:
        """The unit vector PROTRUDING of a side."""
        return PROTRUDING @ self.outwards(side) / np.linalg.norm(PROTRUDING)

    def breast_axes(self, side: str) -> Float[np.ndarray, "3 3"]:
        """Rows: x, y, z of the frame in which `brafit.anatomy.wire_detection` works, about a breast of this side."""
        q, r = np.linalg.qr(BREAST_AXES.T)
        return (q * np.sign(np.diag(r))).T @ self.outwards(side)


@dataclass(frozen=True, eq=False)
class _Breast:
    """What was found of one breast, in the scan's frame."""

    body: Body
    side: str
    apex: np.ndarray
    wire: Wire
    strap: np.ndarray
    upper_line: np.ndarray


def proposed_landmarks(path: Path, points: Float[np.ndarray, "n 3"]) -> list[Landmarks]:
    """Landmarks of both breasts of a standing torso (mm), marked as proposed: apex, wire and its ends, strap point,
    upper line.

    Raises:
        InputError: it is no torso, or no breast was found.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if size < TORSO_SIZE:
        cause = f"is {size:.0f} mm across, which is no whole torso: landmarks can be proposed on a torso only"
        raise InputError(path, cause, f"Write {landmarks_path(path).name} by hand, or scan the whole torso")
    body, points = body_and_trunk(points)
    found = _breasts(points, body)
    return [
        Landmarks(
            path=landmarks_path(path),
            name=path.stem,
            side=breast.side,
            wire=breast.wire.wire,
            upper_line=breast.upper_line,
            points={
                "inner_end": breast.wire.wire[0],
                "outer_end": breast.wire.wire[-1],
                "wire_bottom": _lowest(breast.wire.wire, breast.body.up),
                "apex": breast.apex,
                "strap_point": breast.strap,
            },
            units="mm",
            proposed=True,
        )
        for breast in _checked(path, found)
    ]


def body_from_marks(
    ends: Float[np.ndarray, "2 3"], below: Float[np.ndarray, "3"], front: Float[np.ndarray, "3"], side: str
) -> Body:
    """Axes from a breast's own marks, where there is no whole torso: the wire's ends, a direction that leads down from
    the middle between them, and one that leads out of the chest.

    The cup's mean axes (`BREAST_AXES`) are turned back into the body's.
    """
    y = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    z = front - (front @ y) * y
    z /= np.linalg.norm(z)
    x = below - (below @ y) * y - (below @ z) * z
    x /= np.linalg.norm(x)
    q, r = np.linalg.qr(BREAST_AXES.T)
    outwards, up, forward = (q * np.sign(np.diag(r))) @ np.stack([x, y, z])
    return Body(outwards if side == "left" else -outwards, up, forward, 0.0)


def body_of(points: Float[np.ndarray, "n 3"]) -> Body:
    """Axes of a standing torso (mm): of the four ways in which up and front can be, the one that shows breasts best."""
    return _best(_sketch(points))


def body_and_trunk(points: Float[np.ndarray, "n 3"]) -> tuple[Body, Float[np.ndarray, "m 3"]]:
    """The same, and the points of its trunk, thinned and without strays. Of a body with legs, the trunk is looked at
    alone, with all the points that it has.
    """
    sketch = _sketch(points)
    body = _best(sketch)
    if float(np.linalg.norm(np.ptp(points, axis=0))) < BODY_SIZE:
        return body, sketch
    rise = points @ body.up - _shoulders(body, sketch)
    trunk = (rise > -TRUNK_BELOW) & (rise < TRUNK_ABOVE) & (np.abs(points @ body.left - body.offset) < TRUNK_WIDTH)
    return body, _sketch(points[trunk]) if trunk.sum() > COARSE else sketch


def _sketch(points: np.ndarray) -> np.ndarray:
    """The whole body thinned, without strays."""
    thinned = averaged(points, WHOLE)
    return thinned[inliers(thinned, 16, 2.0)]


def _best(points: np.ndarray) -> Body:
    bodies, points = _candidates(points), points[::GLANCE]
    bodies = [(body, NECK * _neck(body, points)) for body in bodies]
    looks = [(body, neck, side, *_apex(points, body, side, COARSE)) for body, neck in bodies for side in SIDES]
    rises = [_rise(body, side, apex, surface) for body, _, side, apex, surface in looks]

    def shown(k: int) -> float:
        body, neck, side, apex, surface = looks[k]
        crease = plainness(_in_breast_frame(surface, apex, body, side)) + _wire_above(surface, apex, body)
        return crease + RISES * rises[k] + neck

    # The back, whatever its creases, has nothing that rises as a breast does.
    best = max((k for k in range(len(looks)) if rises[k] > max(rises) - RISE_SPREAD), key=shown)
    return looks[best][0]


def _rise(body: Body, side: str, apex: np.ndarray, surface: Surface) -> float:
    """How high (mm) an apex lies over what is about it, less by how much it is beside the trunk."""
    return mound(surface, apex) - float(np.clip(body.away(apex, side) - BREAST_OUT[1], 0, None))


def _wire_above(surface: Surface, apex: np.ndarray, body: Body) -> float:
    """Less, the hollower it is above the breast instead of below it: mean concavity there, negative."""
    away = surface.points - apex
    above = (away @ body.up > 40) & (away @ body.up < 90) & (np.abs(away @ body.left) < 40)
    return -float(np.clip(concavity(surface, 14.0, np.flatnonzero(above)), 0, None).mean()) if above.any() else -1.0


def _checked(path: Path, found: list[_Breast]) -> list[_Breast]:
    if max(breast.wire.hollow for breast in found) < MIN_HOLLOW:
        remedy = "It must be a standing torso, seen from all sides; else mark the landmarks by hand"
        raise InputError(path, "no breast with a crease under it was found", remedy)
    return found


def _candidates(points: np.ndarray) -> list[Body]:
    """Bodies with each choice of up and front."""
    mirror = mirror_of(points)
    left = mirror.normal
    strip = points[np.abs(points @ left - mirror.offset) < TRUNK]
    strip = strip - np.median(strip, axis=0)
    strip = strip - np.outer(strip @ left, left)
    strip = strip[np.linalg.norm(strip, axis=1) < 4 * np.median(np.linalg.norm(strip, axis=1))]
    along = np.linalg.eigh(strip.T @ strip)[1][:, 2]
    bodies = []
    for up_sign in (1.0, -1.0):
        for front_sign in (1.0, -1.0):
            front = front_sign * np.cross(left, along)
            up = up_sign * along
            # The trunk's axis leans back: the vertical is that much farther to the front.
            up = np.cos(LEAN) * up + np.sin(LEAN) * front
            axis = max((s * e for e in np.eye(3) for s in (1, -1)), key=lambda axis: float(axis @ up))
            if axis @ up > np.cos(LEVEL):
                up = axis - (axis @ left) * left
                up = up / np.linalg.norm(up)
            front = front - (front @ up) * up
            front = front / np.linalg.norm(front)
            towards_left = np.cross(up, front)
            bodies.append(Body(towards_left, up, front, float(mirror.offset * (towards_left @ left))))
    return bodies


def _breasts(points: np.ndarray, body: Body) -> list[_Breast]:
    """What there is on both sides, at about the same height: that of the plainer breast."""
    first = {side: _apex(points, body, side) for side in SIDES}
    heights = {side: float(apex @ body.up) for side, (apex, _) in first.items()}
    if abs(heights["left"] - heights["right"]) > LEVELS:
        plain, other = sorted(SIDES, key=lambda side: -mound(first[side][1], first[side][0]))
        first[other] = _apex(points, body, other, level=heights[plain])
    return [_breast(points, body, side, *first[side]) for side in SIDES]


def _breast(points: np.ndarray, body: Body, side: str, apex: np.ndarray, surface: Surface) -> _Breast:
    apex = _nudged(surface, apex, _wire(surface, apex, body, side).wire, body, side)
    wire = _on_its_side(_wire(surface, apex, body, side), body, side)
    front = facing(wire.wire, body.front)
    strap = _strap(surface, wire.wire, apex, _shoulder(points, apex, body, side), front, body)
    upper = neckline_over(surface, wire.wire[0], strap, wire.wire[-1], front)
    return _Breast(body, side, apex, wire, strap, upper)


def _about(points: np.ndarray, place: np.ndarray, outward: np.ndarray, dense: int, radius: float = 190.0) -> Surface:
    """The surface within a radius of a place, in the scan's frame; tidied, but for a first look (COARSE)."""
    near = points[np.linalg.norm(points - place, axis=1) < radius]
    if dense == COARSE and len(near) > MIN_POINTS:
        return surface_of(averaged(near, dense), outward)
    surface = tidy(near, dense=dense).surface
    if surface is None:
        return Surface(near, np.tile(outward, (len(near), 1)), 1.0)
    turned = np.sign(np.median(surface.normals @ outward) or 1.0)
    return Surface(surface.points, turned * surface.normals, surface.spacing)


def _foremost(points: np.ndarray, body: Body, side: str, level: float | None = None) -> np.ndarray:
    """About where a breast sticks out farthest: the foremost place that has lower ones both above and below it.

    Args:
        level: its height, where that is known to LEVELS mm.
    """
    out, height = body.away(points, side), points @ body.up
    trunk = np.abs(out) < BREAST_OUT[1]
    low, high = np.quantile(height[trunk], (0.02, 0.98))
    # Within the middle of the height of a torso; of a whole body, so far below the shoulders.
    low, high = max(low + 0.25 * (high - low), _shoulders(body, points) - BELOW_SHOULDERS), float(high)
    if level is not None:
        low, high = max(low, level - LEVELS), min(high, level + LEVELS)
    zone = (out > BREAST_OUT[0]) & (out < BREAST_OUT[1]) & (height > low) & (height < high)
    if not zone.any():
        zone = trunk
    candidate, height = points[zone], height[zone]
    reach = candidate @ body.protruding(side)
    cell = ((height - height.min()) / CELL).astype(int)
    profile = np.full(cell.max() + 1, -np.inf)
    np.maximum.at(profile, cell, reach)
    peaks = find_peaks(ndimage.median_filter(profile, 3, mode="nearest"), prominence=PROMINENCE)[0]
    if len(peaks):  # not what goes on beyond the zone, as a belly does
        near = np.abs(cell - peaks[profile[peaks].argmax()]) <= 4
        candidate, reach = candidate[near], reach[near]
    return np.median(candidate[reach > np.quantile(reach, 0.999) - CAP], axis=0)


def _shoulders(body: Body, points: np.ndarray) -> float:
    """Height of the lower shoulder: the least of the body's tops beside the neck, so that a raised arm does not count."""
    out, height = points @ body.left - body.offset, points @ body.up
    beside = [height[np.abs(out - sign * place) < 5.0] for sign in (1, -1) for place in (105.0, 115.0, SHOULDER_OUT)]
    return min((float(np.quantile(part, 0.99)) for part in beside if len(part) >= 20), default=float(height.max()))


def _neck(body: Body, points: np.ndarray) -> float:
    """By how much (mm) the body's middle reaches above its shoulders: neck and head do, where it is upside down the
    middle is flat, or there are legs. At most 100 either way.
    """
    middle = points[np.abs(points @ body.left - body.offset) < 30.0] @ body.up
    if len(middle) < 20:
        return 0.0
    return float(np.clip(np.quantile(middle, 0.99) - _shoulders(body, points), -100.0, 100.0))


def _apex(
    points: np.ndarray, body: Body, side: str, dense: int = DENSE, level: float | None = None
) -> tuple[np.ndarray, Surface]:
    """The bust point as the surface about it shows it: the middle of what is convex about the foremost place."""
    direction = body.protruding(side)
    apex = _foremost(points, body, side, level)
    surface = _about(points, apex, body.front, dense)
    reach = surface.points @ direction

    def about(apex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points near the apex, and the area that each stands for."""
        near = np.flatnonzero(((surface.points - apex) ** 2).sum(axis=1) < ABOUT**2)
        crowd = surface.tree.query_ball_point(surface.points[near], max(8.0, 3 * surface.spacing), return_length=True)
        return near, 1 / np.maximum(crowd, 4)

    near, area = about(apex)
    for _ in range(3):
        if len(near) < 20:
            break
        behind = np.clip(np.quantile(reach[near], 0.99) - reach[near], 0, None)
        apex = np.average(surface.points[near], axis=0, weights=area * np.exp(-((behind / CAP) ** 2)))
        near, area = about(apex)
    if len(near):
        convex = -concavity(surface, max(SCALE, 3 * surface.spacing), near)
        away = np.linalg.norm(surface.points[near] - apex, axis=1) / AREOLA
        weights = area * np.clip(convex - CONVEX, LEAST, None) * np.exp(-(away**2) / 2)
        apex = np.average(surface.points[near], axis=0, weights=weights)
    return settle(surface, apex[None], max(6.0, 2 * surface.spacing))[0][0], surface


def _bust_point(points: np.ndarray, body: Body, side: str) -> tuple[np.ndarray, Surface]:
    """The bust point as the surface and the wire found show it, and the surface about it."""
    apex, surface = _apex(points, body, side)
    return _nudged(surface, apex, _wire(surface, apex, body, side).wire, body, side), surface


def mound(surface: Surface, apex: Float[np.ndarray, "3"]) -> float:
    """How high (mm) a place lies over those about it, AROUND mm away from it: the mean of the sides, along the normal
    there. On a sphere of radius R, R - sqrt(R^2 - AROUND^2) and more; on a chest as round as a barrel 3 to 5.
    """
    away = surface.points - apex
    distance = np.linalg.norm(away, axis=1)
    normal = surface.normals[distance < NEAR].sum(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    ring = (np.abs(distance - AROUND[0]) < AROUND[1]) & (surface.normals @ normal > 0)
    if not ring.any():
        return 0.0
    return float(-(away[ring] @ normal).mean())


def _nudged(surface: Surface, apex: np.ndarray, wire: np.ndarray, body: Body, side: str) -> np.ndarray:
    """The bust point as the surface shows it, and as the wire does (see `SIDEWAYS`)."""
    outwards, direction = body.outwards(side)[0], body.protruding(side)
    outwards = outwards - (outwards @ direction) * direction
    outwards /= np.linalg.norm(outwards)
    up = np.cross(direction, outwards)
    up *= np.sign(up @ body.up)
    away = evenly_spaced(wire, 200).mean(axis=0) - apex
    across = SIDEWAYS[0] * (away @ outwards - SIDEWAYS[1])
    rise = RAISED[0] * (-away @ direction - RAISED[1])
    step = across * outwards + rise * up
    apex = apex + step * min(1.0, NUDGE / max(float(np.linalg.norm(step)), 1e-9))
    return settle(surface, apex[None], max(6.0, 2 * surface.spacing))[0][0]


def _wire(surface: Surface, apex: np.ndarray, body: Body, side: str, ends: np.ndarray | None = None) -> Wire:
    """The wire found, in the scan's frame."""
    axes = body.breast_axes(side)
    found = trace(_in_breast_frame(surface, apex, body, side), None if ends is None else (ends - apex) @ axes.T)
    return Wire(found.wire @ axes + apex, found.guessed, found.hollow)


def _on_its_side(wire: Wire, body: Body, side: str) -> Wire:
    """The wire with what comes nearer than GORE to the mirror plane, or across it, moved outwards."""
    out = body.away(wire.wire, side)
    step = np.clip(GORE - out, 0, 2 * GORE) ** 2 / (4 * GORE)
    return replace(wire, wire=wire.wire + step[:, None] * body.outwards(side)[0])


def _in_breast_frame(surface: Surface, apex: np.ndarray, body: Body, side: str) -> Surface:
    axes = body.breast_axes(side)
    return surface.at((surface.points - apex) @ axes.T, surface.normals @ axes.T)


def wire_about(
    points: Float[np.ndarray, "n 3"],
    body: Body,
    side: str,
    apex: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "2 3"] | None = None,
) -> Wire:
    """The wire found in the crease of the breast with this apex (scan's frame, mm)."""
    return _wire(_about(points, apex, body.front, DENSE), apex, body, side, ends)


def wire_laid(
    points: Float[np.ndarray, "n 3"],
    body: Body,
    side: str,
    apex: Float[np.ndarray, "3"],
    arc: Float[np.ndarray, "k 2"],
    ends: Float[np.ndarray, "2 3"] | None = None,
) -> Wire:
    """A rigid planar wire (depth below its chord, place along it) laid best under this apex (scan's frame, mm)."""
    surface, axes = _about(points, apex, body.front, DENSE), body.breast_axes(side)
    found = laid(_in_breast_frame(surface, apex, body, side), arc, None if ends is None else (ends - apex) @ axes.T)
    return Wire(found.wire @ axes + apex, found.guessed, found.hollow)


def apex_of(points: Float[np.ndarray, "n 3"], body: Body, side: str) -> Float[np.ndarray, "3"]:
    """The bust point of a side, as the surface and the wire found show it."""
    return _bust_point(_sketch(points), body, side)[0]


def _lowest(wire: np.ndarray, up: np.ndarray) -> np.ndarray:
    return wire[(wire @ up).argmin()]


def _shoulder(points: np.ndarray, apex: np.ndarray, body: Body, side: str) -> np.ndarray:
    """The middle of the shoulder: the top of the body there."""
    outwards, up, front = body.outwards(side)
    out = body.away(points, side)
    away = points - apex
    rise, depth = away @ up, away @ front
    there = np.abs(out - SHOULDER_OUT) < 10.0
    there &= (rise < SHOULDER_UP[1] + 20) & (depth > SHOULDER_BACK[0] - 20) & (depth < SHOULDER_BACK[1] + 20)
    top, back = np.mean(SHOULDER_UP), np.mean(SHOULDER_BACK)
    if there.sum() >= 20:
        top = np.quantile(rise[there], 0.99)
        back = np.median(depth[there & (rise > top - 4)])
    beyond = SHOULDER_OUT - float(body.away(apex, side))
    return apex + beyond * outwards + np.clip(top, *SHOULDER_UP) * up + np.clip(back, *SHOULDER_BACK) * front


def _strap(
    surface: Surface, wire: np.ndarray, apex: np.ndarray, shoulder: np.ndarray, front: np.ndarray, body: Body
) -> np.ndarray:
    """Where the strap meets the upper line: STRAP_UP of the span above the wire's bottom, in the plane through apex and
    the middle of the shoulder that holds the direction `front`, which a strap follows.
    """
    span = float(np.linalg.norm(wire[-1] - wire[0]))
    height = float(_lowest(wire, body.up) @ body.up) + STRAP_UP * span
    way = shoulder - apex
    place = apex + (height - apex @ body.up) / (way @ body.up) * way
    for _ in range(6):
        away = surface.points - place
        ahead = away @ front
        aside = np.linalg.norm(away - ahead[:, None] * front, axis=1)
        ray = (aside < max(8.0, 3 * surface.spacing)) & (surface.normals @ front > 0)
        if not ray.any():
            return surface.points[surface.tree.query(place)[1]]
        step = np.median(ahead[ray][ahead[ray] > ahead[ray].max() - 8.0]) * front
        # Along the plane, then back to the height within it.
        place = place + step - (step @ body.up) / (way @ body.up) * way
    return settle(surface, place[None], max(6.0, 2 * surface.spacing))[0][0]
