"""Seam allowances: the line to cut along, around the sewing lines of a piece.

Where an edge bends away tightly, its parallel folds back on itself. The cut line is then the outline of all that lies
within the allowances, its hollows rounded by a rolling disc as scissors would round them: nowhere is the allowance
narrower than asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from shapely import LineString, Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from brafit.geometry.polyline import polyline_length, running_length
from brafit.pattern.curve import (
    TOLERANCE,
    Curve,
    Stretch,
    Trace,
    closed,
    cross,
    curves_through,
    fit_curves,
    offsets,
    right_of,
)
from brafit.remarks import Remark

_FINE = 0.005
"""Tolerance in mm of the polylines that outlines are compared with."""
_NEAR = 0.004
"""A parallel's sample this near (mm) to the outline is part of it."""
_BRIDGE = 1.35
"""A hollow where the allowance is more than this many times as wide as asked for is told: cloth lies double there when
the allowance is turned in. A square inner corner has 1.41."""
_ROUND = 0.5
"""Radius of the disc that rounds hollows of the cut line, in the narrowest allowance."""
_SWING = 1.01
"""A curve that is longer than the polyline that it is drawn through by this factor swings."""
_OVERLAP = 5.0
"""Two parts of a parallel that both draw a bit of the outline where it folds overlap by less than this, mm."""
_CORNER = np.radians(12)


@dataclass(frozen=True)
class Ring:
    """The sewing lines of a piece in a ring.

    Attributes:
        curves: mm.
        widths: the allowance of each, mm.
        outward: 1 where the piece lies to the left of its outline, -1 where it lies to the right.
        seams: of those that are sewn to another piece the seam's name, else empty.
    """

    curves: Sequence[Curve]
    widths: Sequence[float]
    outward: float
    seams: Sequence[str] = ()


def cut_outlines(rings: Sequence[Ring]) -> list[tuple[list[Curve], list[Remark]]]:
    """The cut line around each piece, curves that meet in corners, and what is wrong with it.

    Past its ends the allowance of a seam runs on equally far on both pieces, so that their cut lines end together when
    they are sewn.
    """
    wanted = [
        (curve, ring.outward * width) for ring in rings for curve, width in zip(ring.curves, ring.widths, strict=True)
    ]
    parallels = iter(offsets([curve for curve, _ in wanted], [distance for _, distance in wanted]))
    found = []
    for ring, reaches in zip(rings, _trued(rings), strict=True):
        corners = [_corner(ring, i, reach) for i, reach in enumerate(reaches)]
        plain = _parallel_outline(ring, [next(parallels) for _ in ring.curves], corners)
        found.append((plain, []) if plain is not None else _trimmed_outline(ring, corners))
    return found


Reach = tuple[float, float]
"""How far past their common tip the allowances of two edges run on, mm."""


def _trued(rings: Sequence[Ring]) -> list[list[Reach]]:
    """For each corner of each ring, that after the first edge first, how far the allowances of both edges run on.

    Alone, they run on to where they meet, but no farther than the other is wide; a seam's as far as the shorter of its
    two sides. An allowance whose neighbour ends before they meet ends before that, too.
    """
    meets = [[_meeting(ring, i) for i in range(len(ring.curves))] for ring in rings]
    reaches = [
        [_clipped(both, ring.widths[i], ring.widths[(i + 1) % len(own)]) for i, both in enumerate(own)]
        for ring, own in zip(rings, meets, strict=True)
    ]
    for _ in range(len(rings) + 1):
        least: dict[tuple[str, bool], float] = {}
        for ring, own in zip(rings, reaches, strict=True):
            for key, reach in _seam_ends(ring, own):
                least[key] = min(least.get(key, np.inf), reach)
        for ring, own, met in zip(rings, reaches, meets, strict=True):
            flat = [least.get(key, reach) for key, reach in _seam_ends(ring, own)]
            own[:] = [
                _short_of(reach, meet) for reach, meet in zip(zip(flat[::2], flat[1::2], strict=True), met, strict=True)
            ]
    return reaches


def _clipped(reach: Reach, first: float, second: float) -> Reach:
    """Each no farther than the other's allowance is wide."""
    return float(np.clip(reach[0], 0, second)), float(np.clip(reach[1], 0, first))


def _short_of(reach: Reach, meet: Reach) -> Reach:
    """Both short of where they meet, if one is."""
    (a, b), (to_a, to_b) = reach, meet
    if a < to_a - 1e-9 and b >= to_b - 1e-9:
        return a, max(b * a / to_a, 0.0)
    if b < to_b - 1e-9 and a >= to_a - 1e-9:
        return max(a * b / to_b, 0.0), b
    return reach


def _seam_ends(ring: Ring, reaches: Sequence[Reach]) -> list[tuple[tuple[str, bool], float]]:
    """Both reaches of every corner, with the seam that each belongs to and whether it is at the outer end."""
    names = [*ring.seams, *[""] * len(ring.curves)][: len(ring.curves)]
    keys = [
        (names[j] or f"none {id(ring)} {i} {j}", i == 0) for i in range(len(names)) for j in (i, (i + 1) % len(names))
    ]
    return list(zip(keys, [reach for pair in reaches for reach in pair], strict=True))


def _widest_at(ring: Ring, index: int) -> float:
    return max(ring.widths[index], ring.widths[(index + 1) % len(ring.curves)])


def _meeting(ring: Ring, index: int) -> Reach:
    """How far past a corner the allowances of both edges run until they meet; without end where they never do."""
    go, come, first, last = _directions(ring, index)
    turn = ring.outward * float(cross(go[None], come[None])[0])
    if turn <= 1e-9:
        return np.inf, np.inf
    along, back = np.linalg.solve(np.stack((go, come), axis=1), last - first)
    return float(along), float(back)


def _directions(ring: Ring, index: int) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """At a corner the directions of the edges before and after it, and the ends of their parallels there."""
    before, after = ring.curves[index], ring.curves[(index + 1) % len(ring.curves)]
    a, b = ring.widths[index], ring.widths[(index + 1) % len(ring.curves)]
    go, come = before.trace(np.array([float(len(before.controls))]))[1][0], after.trace(np.array([0.0]))[1][0]
    return go, come, before.end + a * ring.outward * right_of(go), after.start + b * ring.outward * right_of(come)


def crossings(
    outline: Float[ndarray, "n 2"], points: Float[ndarray, "k 2"], outward: Float[ndarray, "k 2"], width: float
) -> Float[ndarray, "k 2"]:
    """Where normals of a sewing line meet the cut line: `width` away, or farther in a hollow.

    Args:
        outline: the cut line, a polygon.
        points: on the sewing line.
        outward: unit normals there.
        width: of the allowance, mm; 0: the cut line is the sewing line.
    """
    away = np.full(len(points), width)
    if width > 0:
        # along and across each normal, the corners and the steps from them
        a = np.stack([_turned(outline - p, o) for p, o in zip(points, outward, strict=True)])
        step = np.roll(a, -1, axis=1) - a
        across = (a[..., 1] < 0) != (np.roll(a[..., 1], -1, axis=1) < 0)
        share = -a[..., 1] / np.where(across, step[..., 1], 1.0)
        hits = np.where(across, a[..., 0] + share * step[..., 0], np.inf)
        nearest = np.where((hits >= 0.9 * width) & (hits <= 5 * width), hits, np.inf).min(1)
        away = np.where(np.isfinite(nearest) & (nearest > width + 0.02), nearest, away)
    return points + away[:, None] * outward


def signed_area(points: Float[ndarray, "n 2"]) -> float:
    """Area of a polygon, positive where it runs counter-clockwise."""
    x, y = points.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def valid_polygon(points: Float[ndarray, "n 2"]) -> Polygon:
    """The largest proper polygon in an outline that may cross itself."""
    shape = make_valid(Polygon(points))
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, Polygon)]
    parts += [p for part in getattr(shape, "geoms", []) for p in getattr(part, "geoms", []) if isinstance(p, Polygon)]
    return max(parts, key=lambda part: part.area, default=Polygon())


def _turned(points: Float[ndarray, "n 2"], axis: Float[ndarray, "2"]) -> Float[ndarray, "n 2"]:
    """Coordinates along a unit vector and to its left."""
    return points @ np.array(((axis[0], -axis[1]), (axis[1], axis[0])))


def _parallel_outline(
    ring: Ring, parallels: Sequence[Curve | None], corners: Sequence[Float[ndarray, "_ 2"] | None]
) -> list[Curve] | None:
    """Parallel curves joined at the corners; None where that is no simple outline around the piece."""
    kept = [parallel for parallel in parallels if parallel is not None]
    if len(kept) < len(ring.curves):
        return None
    outline: list[Curve] = []
    for i, parallel in enumerate(kept):
        corner = corners[i]
        if corner is None:
            return None
        outline.append(parallel)
        points = _distinct(np.vstack((parallel.end, corner, kept[(i + 1) % len(kept)].start)))
        if len(points) > 1:
            outline.append(Curve.line(*points))
    return outline if _lies_around(closed(outline, _FINE), closed(ring.curves, _FINE)) else None


def _lies_around(outer: Float[ndarray, "n 2"], inner: Float[ndarray, "m 2"]) -> bool:
    """Whether both are simple polygons and the first holds the second, but for a hair's breadth: they may coincide."""
    around, held = Polygon(outer), Polygon(inner)
    if not (around.is_valid and held.is_valid):
        return False
    shapely.prepare(around)
    shapely.prepare(held)
    out = inner[~shapely.contains_xy(around, inner)]
    within = outer[shapely.contains_xy(held, outer)]
    beyond = shapely.distance(around, shapely.points(out))
    inside = shapely.distance(held.exterior, shapely.points(within))
    return bool(np.max(np.concatenate((beyond, inside)), initial=0.0) <= 1e-3)


def _corner(ring: Ring, index: int, reach: Reach) -> Float[ndarray, "n 2"] | None:
    """The cut line's corner points between two parallels; None at a corner that points into the piece.

    Both allowances run straight on past the tip as far as told, and end in a straight line between.
    """
    go, come, first, last = _directions(ring, index)
    turn = ring.outward * float(cross(go[None], come[None])[0])
    if _widest_at(ring, index) == 0 or (abs(turn) < 1e-9 and go @ come > 0):
        return np.stack((first, last))
    if turn < 0:
        return None
    return np.stack((first, first + reach[0] * go, last - reach[1] * come, last))


def _trimmed_outline(ring: Ring, corners: Sequence[Float[ndarray, "_ 2"] | None]) -> tuple[list[Curve], list[Remark]]:
    """The outline of all that lies within the allowances, hollows rounded, and what is wrong with it."""
    curves, widths, outward = ring.curves, ring.widths, ring.outward
    parts: list[BaseGeometry] = [valid_polygon(closed(curves, _FINE))]
    for i, (curve, width) in enumerate(zip(curves, widths, strict=True)):
        if width == 0:
            continue
        parts += _strip(curve, outward * width)
        corner = corners[i]
        if corner is not None:
            parts.append(valid_polygon(np.vstack((curve.end[None], corner))))
    whole = shapely.union_all(shapely.buffer(parts, 1e-6))
    radius = _ROUND * min(widths)
    if radius > 0:
        whole = whole.buffer(radius, quad_segs=48).buffer(-radius, quad_segs=48)
    pieces = sorted(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    messages = []
    if len(pieces) > 1 and pieces[-2].area > 1.0:
        messages.append(Remark("allowance_apart", "the allowance falls into several parts; only the largest is drawn"))
    if any(Polygon(hole).area > 1.0 for hole in pieces[-1].interiors):
        words = "the allowance closes round a gap in the piece, which is cut off"
        messages.append(Remark("allowance_closes", words))
    exterior = LineString(pieces[-1].exterior.simplify(2e-4).coords)
    for curve, width in zip(curves, widths, strict=True):
        most = _widest(curve, width, exterior)
        if width > 0 and most > _BRIDGE * width:
            cause = f"the allowance bridges a hollow of the sewing line, {most:.1f} mm wide there"
            messages.append(Remark("allowance_bridges", cause, remedy="clip it when sewing"))
    around = np.asarray(exterior.coords)[:-1]
    around = around[::-1] if outward * signed_area(around) < 0 else around
    return _traced(around, curves, widths, outward), messages


def _strip(curve: Curve, distance: float) -> list[BaseGeometry]:
    """What lies between a curve and its parallel to the right: a part of it at a time, and one for each short step
    where the parallel folds back on itself."""
    u = np.linspace(0, len(curve.controls), 60 * len(curve.controls) + 1)
    points, tangents = curve.trace(u)
    outer = points + distance * right_of(tangents)
    quads = np.stack((points[:-1], points[1:], outer[1:], outer[:-1]), axis=1)
    regular = 1 + distance * curve.curvature(u) > 0.02
    regular = regular[1:] & regular[:-1]
    parts: list[BaseGeometry] = []
    folded = ~regular
    for a, b in _runs(regular):
        whole = Polygon(np.vstack((points[a : b + 1], outer[a : b + 1][::-1])))
        if whole.is_valid:
            parts.append(whole)
        else:
            folded[a:b] = True
    return [*parts, *np.asarray(shapely.convex_hull(shapely.polygons(quads[folded])))]


def _runs(mask: Bool[ndarray, " n"]) -> Int[ndarray, "k 2"]:
    """First index and the one after the last of each run of true values."""
    return np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(int))).reshape(-1, 2)


def _widest(curve: Curve, width: float, exterior: LineString) -> float:
    """How far the cut line is from a sewing line at most."""
    points, _ = curve.trace(np.linspace(0, len(curve.controls), 24 * len(curve.controls) + 1))
    return float(shapely.distance(shapely.points(points), exterior).max())


def _traced(
    ring: Float[ndarray, "n 2"], curves: Sequence[Curve], widths: Sequence[float], outward: float
) -> list[Curve]:
    """A polygon as smooth curves: the parallels wherever it follows them, else through its own corners."""
    around = np.vstack((ring, ring[:1]))
    outline = LineString(around)
    shapely.prepare(outline)
    total = outline.length
    drawn: list[tuple[Trace, ndarray, ndarray]] = []  # of what is one curve: trace, parameters, and places on the ring
    for curve, width in zip(curves, widths, strict=True):
        trace = curve.parallel(outward * width)
        u = np.linspace(0, len(curve.controls), 80 * len(curve.controls) + 1)
        points, tangents = trace(u)
        on = np.asarray(shapely.dwithin(shapely.points(points), outline, _NEAR))
        on[1:-1] &= ((points[2:] - points[:-2]) * tangents[1:-1]).sum(1) > 0  # not where the parallel runs backwards
        for a, b in _runs(on):
            part = points[a:b]
            if b - a > 3 and polyline_length(part) > 0.5:
                drawn.append((trace, u[a:b], np.asarray(shapely.line_locate_point(outline, shapely.points(part)))))
    if len(drawn) > 1:
        begun = [_from(before[2][-1], after, total) for before, after in pairwise([*drawn[-1:], *drawn])]
        drawn = [run for run in begun if len(run[1]) > 3]
    stretches = [Stretch(trace, float(own[0]), float(own[-1])) for trace, own, _ in drawn]
    fitted = fit_curves(stretches, TOLERANCE)
    runs = [(float(places[0]), float(places[-1]), curve) for (*_, places), curve in zip(drawn, fitted, strict=True)]
    if not runs:
        return _portions(around)
    along = running_length(around)[:-1]
    joined: list[Curve] = []
    for (_, left, run), (reached, _, after) in pairwise([*runs, runs[0]]):
        joined.append(run)
        gap = (reached - left) % total
        if gap > total - _OVERLAP:  # they overlap by a hair
            gap = 0.0
        beyond = (along - left) % total
        between = (beyond > 1e-3) & (beyond < gap - 1e-3)
        way = ring[between][np.argsort(beyond[between])]
        points = _distinct(np.vstack((run.end, way, after.start)))
        if len(points) > 1:
            joined += _portions(points)
    return joined


def _from(end: float, run: tuple[Trace, ndarray, ndarray], total: float) -> tuple[Trace, ndarray, ndarray]:
    """A run without what lies before the end of the one before it: where a parallel folds, both draw the same bit."""
    trace, own, places = run
    behind = (end - places[0]) % total
    first = int(np.searchsorted((places - places[0]) % total, behind)) if behind < _OVERLAP else 0
    return trace, own[first:], places[first:]


def _portions(points: Float[ndarray, "n 2"]) -> list[Curve]:
    """A polyline as curves between its corners."""
    step = np.diff(points, axis=0)
    turn = np.abs(np.arctan2(cross(step[:-1], step[1:]), (step[:-1] * step[1:]).sum(1)))
    corners = [0, *(np.flatnonzero(turn > _CORNER) + 1), len(points) - 1]
    parts = [points[a : b + 1] for a, b in pairwise(corners)]
    curves = curves_through(parts)
    # between long steps and short ones a spline may swing far out
    return [
        curve if curve.length <= _SWING * polyline_length(part) else Curve.line(*part)
        for curve, part in zip(curves, parts, strict=True)
    ]


def _distinct(points: Float[ndarray, "n 2"]) -> Float[ndarray, "m 2"]:
    return points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-5)]
