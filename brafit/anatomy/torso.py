"""A standing torso: its axes, and landmarks proposed from its shape alone, for a person to look at and correct.

Rules and figures are those of 14 breasts (parametric bodies, a mean of standing scans, one person).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.anatomy.apex import COARSE, DENSE, LEVELS, about, apex_on, mound, nudged
from brafit.anatomy.body import (
    SHOULDER_BACK,
    SHOULDER_OUT,
    SHOULDER_UP,
    Body,
    body_from_marks,
    candidates,
    neck_of,
    shoulders,
)
from brafit.anatomy.confidence import Confidence, evidence, refusal
from brafit.anatomy.pair import Breast, are_alike, confidences, one_pair, trunk_of
from brafit.anatomy.wire_detection import FoundWire, concavity, plainness, trace
from brafit.errors import InputError
from brafit.landmarks.file import SIDES, Landmarks, landmarks_path
from brafit.surface.cleaning import inliers
from brafit.surface.cropping import facing, neckline_over
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import Surface, settle
from brafit.surface.symmetry import Mirror, mirror_of
from brafit.surface.thinning import averaged

OF_WIRES = ("wire", "guessed", "inner_out", "inner_usual", "outer_usual")
"""Evidence that is of a wire's shape alone."""
OF_MIDDLE = ("apex_out", "inner_out")
"""Evidence that needs the body's middle."""
WHOLE = 60_000
"""Points of a body that are used, at most."""
GLANCE = 3
"""The first, rough pass uses every third point."""
TORSO_SIZE = 450.0
"""Least diagonal (mm) of a torso's box."""
SAME_WAY = 0.7
"""Least cosine between axes of a body that were found in two ways, if they are to be those of one body."""
GORE = 20.0
"""Nearer to the mirror plane (mm) a proposed wire is moved outwards, by a quarter of this on the plane itself, so that
it keeps to its side. In 14 breasts wires end 9 to 28 mm from it."""
STRAP_UP = 1.002
"""The strap point's height above the wire's bottom, over the span: in 14 breasts within 0.004."""
RISES, RISE_SPREAD, RISEN = 0.003, 6.0, 18.0
"""What a millimetre of an apex's height counts in telling front from back, against concavity: breasts rise by 14 mm and
more, shoulder blades by 13 at most. An apex so much (mm) lower than the highest is no breast's."""
FAR_OUT = 145.0
"""An apex farther from the mirror plane (mm) counts less by what it is farther: breasts' are at 70 to 131, and where an
arm hangs beside the back, the edge between the two rises like a breast."""
NECK = 0.0006
"""What a millimetre of neck counts in telling up from down, against concavity."""
BODY_SIZE = 1100.0
"""Least diagonal (mm) of a body with legs."""
TRUNK_BELOW, TRUNK_ABOVE, TRUNK_WIDTH = 600.0, 150.0, 300.0
"""The part of it that is used as the trunk (mm): down from the shoulders, up from them, and to either side."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Landmarks that were proposed for one breast (mm), and how far they can be trusted."""

    marks: Landmarks
    confidence: Confidence


def proposed_landmarks(path: Path, points: Float[np.ndarray, "n 3"]) -> list[Landmarks]:
    """The landmarks of those breasts of a torso (mm) that there are, see `proposals`.

    Args:
        path: the cloud's file; errors name it, and the landmarks' path is beside it.
        points: of the whole torso, in the scan's frame.

    Raises:
        InputError: it is no torso, or no breast was found.
    """
    found = proposals(path, points)
    possible = [one.marks for one in found if not one.confidence.faults]
    if not possible:
        raise refusal(path, [one.confidence for one in found])
    return possible


def proposals(path: Path, points: Float[np.ndarray, "n 3"], mirror: Mirror | None = None) -> list[Proposal]:
    """Landmarks of both sides of a standing torso (mm), marked as proposed: apex, wire and its ends, strap point, upper
    line. Those of breasts that are alike are mirror images. Where there is no breast they are proposed as well, and
    their confidence says so.

    Args:
        path: the cloud's file; errors name it, and the landmarks' path is beside it.
        points: of the whole torso, in the scan's frame.
        mirror: its plane of symmetry, where that is known already.

    Raises:
        InputError: it is no torso.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if size < TORSO_SIZE:
        cause = f"is {size:.0f} mm across, which is no whole torso: landmarks can be proposed on a torso only"
        remedy = (
            f"Mark it by hand with brafit-mark, which makes its {landmarks_path(path).name}, or scan the whole torso"
        )
        raise InputError(path, cause, remedy)
    body, trunk = body_and_trunk(points)
    found = _breasts(trunk, body)
    trusted = confidences(body, found)
    sound = [breast for breast, one in zip(found, trusted, strict=True) if not one.faults]
    if sound:
        mirror = mirror or mirror_of(points)
        first = sound[0]
        if are_alike(points, mirror, body, first.side, first.apex, first.wire.line):
            found, trusted = one_pair(mirror, body, found, trusted)
            one = _marks(path, found[0], body)
            both = [one, one.mapped(mirror, side=found[1].side)]
            return [Proposal(*pair) for pair in zip(both, trusted, strict=True)]
    marks = [_marks(path, breast, body) for breast in found]
    return [Proposal(*pair) for pair in zip(marks, trusted, strict=True)]


def judged(
    points: Float[np.ndarray, "n 3"], marks: Landmarks, mirror: Mirror | None, *, looked_at: bool
) -> Confidence | None:
    """How far marks can be trusted that were not made on this breast, or that nobody looked at; None for marks without
    wire and apex.

    Args:
        points: of the scan, mm.
        marks: of one breast.
        mirror: the body's plane of symmetry; None: the scan does not show the body's middle, and nothing is judged by
            it.
        looked_at: somebody made them on the other breast, so that the wire itself is not in doubt.
    """
    apex, wire = marks.points.get("apex"), marks.wire
    if apex is None or wire is None:
        return None
    body = _body_about(points, marks.side, apex, wire, mirror, looked_at)
    found = evidence(about(points, apex, body.front, DENSE), body, marks.side, apex, wire)
    unasked = (OF_WIRES if looked_at else ()) + (() if np.isfinite(body.offset) else OF_MIDDLE)
    return Confidence(marks.side, {key: value for key, value in found.items() if key not in unasked})


def _body_about(
    points: np.ndarray, side: str, apex: np.ndarray, wire: np.ndarray, mirror: Mirror | None, looked_at: bool
) -> Body:
    """Axes of the body by a breast's marks and, where the scan shows it, by the plane between left and right."""
    rough = body_from_marks(wire[[0, -1]], wire.mean(axis=0) - (wire[0] + wire[-1]) / 2, apex, side)
    if mirror is None or abs(float(mirror.normal @ rough.left)) < SAME_WAY:  # not a plane between left and right
        return rough
    left = mirror.normal * (1.0 if side == "left" else -1.0)
    left = left * (1.0 if apex @ mirror.normal >= mirror.offset else -1.0)
    front = rough.front - (rough.front @ left) * left
    front /= np.linalg.norm(front)
    body = Body(left, np.cross(front, left), front, mirror.offset * float(left @ mirror.normal))
    if looked_at:
        return body
    whole = body_of(points)  # a wire that is in doubt itself is a poor guide to what is up
    return whole if min(whole.left @ body.left, whole.front @ body.front) > SAME_WAY else body


def _marks(path: Path, breast: Breast, body: Body) -> Landmarks:
    wire = breast.wire.line
    named = {"inner_end": wire[0], "outer_end": wire[-1], "wire_bottom": _lowest(wire, body.up)}
    named |= {"apex": breast.apex, "strap_point": breast.strap}
    return Landmarks(landmarks_path(path), path.stem, breast.side, wire, breast.upper_line, named, "mm", proposed=True)


def body_of(points: Float[np.ndarray, "n 3"]) -> Body:
    """Axes of a standing torso (mm): of the four ways in which up and front can be, the one that shows breasts best."""
    return _best(_sketch(points))


def body_and_trunk(points: Float[np.ndarray, "n 3"]) -> tuple[Body, Float[np.ndarray, "m 3"]]:
    """The same, and the points of its trunk, thinned and without strays. Of a body with legs the trunk alone is used,
    with all the points that it has.
    """
    sketch = _sketch(points)
    body = _best(sketch)
    if float(np.linalg.norm(np.ptp(points, axis=0))) < BODY_SIZE:
        return body, sketch
    rise = points @ body.up - shoulders(body, sketch)
    trunk = (rise > -TRUNK_BELOW) & (rise < TRUNK_ABOVE) & (np.abs(points @ body.left - body.offset) < TRUNK_WIDTH)
    return body, _sketch(points[trunk]) if trunk.sum() > COARSE else sketch


def _sketch(points: np.ndarray) -> np.ndarray:
    """The whole body thinned, without strays."""
    thinned = averaged(points, WHOLE)
    return thinned[inliers(Neighbours.of(thinned, 16), 16, 2.0)]


def _best(points: np.ndarray) -> Body:
    bodies, points = candidates(points), points[::GLANCE]
    bodies = [(body, NECK * neck_of(body, points)) for body in bodies]
    looks = [(body, neck, side, *apex_on(points, body, side, COARSE)) for body, neck in bodies for side in SIDES]
    rises = [_rise(body, side, apex, surface) for body, _, side, apex, surface in looks]

    def shown(k: int) -> float:
        body, neck, side, apex, surface = looks[k]
        crease = plainness(_in_breast_frame(surface, apex, body, side)) + _wire_above(surface, apex, body)
        return crease + RISES * rises[k] + neck

    # The back, whatever its creases, has nothing that rises as a breast does.
    best = max((k for k in range(len(looks)) if rises[k] > max(rises) - RISE_SPREAD), key=shown)
    return looks[best][0]


def _rise(body: Body, side: str, apex: np.ndarray, surface: Surface) -> float:
    """How high (mm) an apex lies over what is about it, less by what it is beyond FAR_OUT. More than RISEN says no
    more: the edge of a scan may look so.
    """
    return min(mound(surface, apex), RISEN) - max(float(body.away(apex[None], side)[0]) - FAR_OUT, 0.0)


def _wire_above(surface: Surface, apex: np.ndarray, body: Body) -> float:
    """Minus the mean positive concavity 40 to 90 mm above the apex; -1 without points there. It lowers the score of a
    body that is taken upside down, whose crease lies above the breast.
    """
    away = surface.points - apex
    above = (away @ body.up > 40) & (away @ body.up < 90) & (np.abs(away @ body.left) < 40)
    return -float(np.clip(concavity(surface, 14.0, np.flatnonzero(above)), 0, None).mean()) if above.any() else -1.0


def _breasts(points: np.ndarray, body: Body) -> list[Breast]:
    """What there is on both sides, at about the same height: that of the plainer breast."""
    first = {side: apex_on(points, body, side) for side in SIDES}
    heights = {side: float(apex @ body.up) for side, (apex, _) in first.items()}
    if abs(heights["left"] - heights["right"]) > LEVELS:
        plain, other = sorted(SIDES, key=lambda side: -mound(first[side][1], first[side][0]))
        first[other] = apex_on(points, body, other, level=heights[plain])
    return [_breast(points, body, side, *first[side]) for side in SIDES]


def _breast(points: np.ndarray, body: Body, side: str, apex: np.ndarray, surface: Surface) -> Breast:
    apex = nudged(surface, apex, _wire(surface, apex, body, side).line, body, side)
    wire = _on_its_side(_wire(surface, apex, body, side), body, side)
    front = facing(wire.line, body.front)
    trunk = trunk_of(surface, wire.line, body, side)
    strap = _strap(trunk, wire.line, apex, _shoulder(points, apex, body, side), front, body)
    upper = neckline_over(trunk, wire.line[0], strap, wire.line[-1], front)
    return Breast(side, apex, wire, strap, upper, surface)


def _bust_point(points: np.ndarray, body: Body, side: str) -> tuple[np.ndarray, Surface]:
    """The bust point as the surface and the wire found show it, and the surface about it."""
    apex, surface = apex_on(points, body, side)
    return nudged(surface, apex, _wire(surface, apex, body, side).line, body, side), surface


def _wire(surface: Surface, apex: np.ndarray, body: Body, side: str, ends: np.ndarray | None = None) -> FoundWire:
    """The wire found, in the scan's frame."""
    axes = body.breast_axes(side)
    found = trace(_in_breast_frame(surface, apex, body, side), None if ends is None else (ends - apex) @ axes.T)
    return FoundWire(found.line @ axes + apex, found.guessed, found.hollow)


def _on_its_side(wire: FoundWire, body: Body, side: str) -> FoundWire:
    """The wire with what comes nearer than GORE to the mirror plane, or across it, moved outwards."""
    out = body.away(wire.line, side)
    step = np.clip(GORE - out, 0, 2 * GORE) ** 2 / (4 * GORE)
    return replace(wire, line=wire.line + step[:, None] * body.outwards(side)[0])


def _in_breast_frame(surface: Surface, apex: np.ndarray, body: Body, side: str) -> Surface:
    axes = body.breast_axes(side)
    return surface.at((surface.points - apex) @ axes.T, surface.normals @ axes.T)


def wire_about(
    points: Float[np.ndarray, "n 3"],
    body: Body,
    side: str,
    apex: Float[np.ndarray, "3"],
    ends: Float[np.ndarray, "2 3"] | None = None,
) -> FoundWire:
    """The wire found in the crease of the breast with this apex (scan's frame, mm).

    Args:
        points: of the torso or the breast.
        body: axes of the torso.
        side: the wearer's `left` or `right`.
        apex: the bust point.
        ends: inner and outer end where they are marked; the wire keeps them.
    """
    return _wire(about(points, apex, body.front, DENSE), apex, body, side, ends)


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
    beyond = SHOULDER_OUT - float(body.away(apex[None], side)[0])
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
