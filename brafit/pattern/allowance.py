"""Seam allowances: the line to cut along, around the sewing lines of a piece.

Where an edge bends away tightly, its parallel folds back on itself. The cut line is then the outline of all that lies
within the allowances, its hollows rounded by a rolling disc as scissors would round them: nowhere is the allowance
narrower than asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from shapely import LineString, Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from brafit.pattern.curve import TOLERANCE, Curve, Stretch, closed, cross, curves_through, fit_curves, offsets, right_of

_FINE = 0.005
"""Tolerance in mm of the polylines that outlines are compared with."""
_NEAR = 0.004
"""A parallel's sample this near (mm) to the outline is part of it."""
_BRIDGE = 1.35
"""A hollow where the allowance is more than this many times as wide as asked for is told: cloth lies double there when
the allowance is turned in. A square inner corner has 1.41."""
_ROUND = 0.5
"""Radius of the disc that rounds hollows of the cut line, in the narrowest allowance."""
_CORNER = np.radians(12)


Ring = tuple[Sequence[Curve], Sequence[float], float]
"""The sewing lines of a piece in a ring, mm; the allowance of each, mm; and 1 where the piece lies to the left of its
outline, -1 where it lies to the right."""


def cut_outlines(rings: Sequence[Ring]) -> list[tuple[list[Curve], list[str]]]:
    """The cut line around each piece, curves that meet in corners, and what is wrong with it."""
    wanted = [
        (curve, outward * width)
        for curves, widths, outward in rings
        for curve, width in zip(curves, widths, strict=True)
    ]
    parallels = iter(offsets([curve for curve, _ in wanted], [distance for _, distance in wanted]))
    found = []
    for curves, widths, outward in rings:
        plain = _parallel_outline(curves, [next(parallels) for _ in curves], widths, outward)
        found.append((plain, []) if plain is not None else _trimmed_outline(curves, widths, outward))
    return found


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
    curves: Sequence[Curve], parallels: Sequence[Curve | None], widths: Sequence[float], outward: float
) -> list[Curve] | None:
    """Parallel curves joined at the corners; None where that is no simple outline around the piece."""
    kept = [parallel for parallel in parallels if parallel is not None]
    if len(kept) < len(curves):
        return None
    outline: list[Curve] = []
    for i, parallel in enumerate(kept):
        j = (i + 1) % len(curves)
        corner = _corner(curves[i], curves[j], widths[i], widths[j], outward)
        if corner is None:
            return None
        outline.append(parallel)
        points = _distinct(np.vstack((parallel.end, corner, kept[j].start)))
        if len(points) > 1:
            outline.append(Curve.line(*points))
    return outline if _lies_around(closed(outline, _FINE), closed(curves, _FINE)) else None


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


def _corner(before: Curve, after: Curve, a: float, b: float, outward: float) -> Float[ndarray, "n 2"] | None:
    """The cut line's corner points between two parallels; None at a corner that points into the piece.

    Both allowances run straight on past the tip to where they meet or, at a sharp tip, to a straight end at right
    angles to its middle line, as far from the tip as the wider allowance.
    """
    go, come = before.trace(np.array([float(len(before.controls))]))[1][0], after.trace(np.array([0.0]))[1][0]
    first, last = before.end + a * outward * right_of(go), after.start + b * outward * right_of(come)
    turn = outward * (go[0] * come[1] - go[1] * come[0])
    if max(a, b) == 0 or (abs(turn) < 1e-9 and go @ come > 0):
        return np.stack((first, last))
    if turn < 0:
        return None
    # first + along go = last - back come
    along, back = np.linalg.solve(np.stack((go, come), axis=1), last - first) if turn > 1e-9 else (np.inf, np.inf)
    if min(along, back) < 0:
        return None
    middle = (go - come) / np.linalg.norm(go - come)
    tip, reach = (before.end + after.start) / 2, max(a, b)
    if np.isfinite(along) and middle @ (first + along * go - tip) <= reach:
        return np.stack((first, first + along * go, last))
    ahead = max((reach - middle @ (first - tip)) / (middle @ go), 0.0)
    behind = max((reach - middle @ (last - tip)) / -(middle @ come), 0.0)
    return np.stack((first, first + ahead * go, last - behind * come, last))


def _trimmed_outline(curves: Sequence[Curve], widths: Sequence[float], outward: float) -> tuple[list[Curve], list[str]]:
    """The outline of all that lies within the allowances, hollows rounded, and what is wrong with it."""
    parts: list[BaseGeometry] = [valid_polygon(closed(curves, _FINE))]
    for i, (curve, width) in enumerate(zip(curves, widths, strict=True)):
        if width == 0:
            continue
        parts += _strip(curve, outward * width)
        following = (i + 1) % len(curves)
        corner = _corner(curve, curves[following], width, widths[following], outward)
        if corner is not None:
            parts.append(valid_polygon(np.vstack((curve.end[None], corner))))
    whole = shapely.union_all(shapely.buffer(parts, 1e-6))
    radius = _ROUND * min(widths)
    if radius > 0:
        whole = whole.buffer(radius, quad_segs=48).buffer(-radius, quad_segs=48)
    pieces = sorted(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    messages = []
    if len(pieces) > 1 and pieces[-2].area > 1.0:
        messages.append("the allowance falls into several parts; only the largest is drawn")
    if any(Polygon(hole).area > 1.0 for hole in pieces[-1].interiors):
        messages.append("the allowance closes round a gap in the piece, which is cut off")
    exterior = LineString(pieces[-1].exterior.simplify(2e-4).coords)
    for curve, width in zip(curves, widths, strict=True):
        most = _widest(curve, width, exterior)
        if width > 0 and most > _BRIDGE * width:
            words = f"the allowance bridges a hollow of the sewing line, {most:.1f} mm wide there; clip it when sewing"
            messages.append(words)
    ring = np.asarray(exterior.coords)[:-1]
    ring = ring[::-1] if outward * signed_area(ring) < 0 else ring
    return _traced(ring, curves, widths, outward), messages


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
    outline = LineString(np.vstack((ring, ring[:1])))
    shapely.prepare(outline)
    total = outline.length
    ends: list[tuple[float, float]] = []  # places on the ring of start and end of what is drawn as one curve
    stretches: list[Stretch] = []
    for curve, width in zip(curves, widths, strict=True):
        trace = curve.parallel(outward * width)
        u = np.linspace(0, len(curve.controls), 80 * len(curve.controls) + 1)
        points, tangents = trace(u)
        on = np.asarray(shapely.dwithin(shapely.points(points), outline, _NEAR))
        on[1:-1] &= ((points[2:] - points[:-2]) * tangents[1:-1]).sum(1) > 0  # not where the parallel runs backwards
        for a, b in _runs(on):
            part = points[a:b]
            if b - a > 3 and np.linalg.norm(np.diff(part, axis=0), axis=1).sum() > 0.5:
                first, last = np.asarray(shapely.line_locate_point(outline, shapely.points(part[[0, -1]])))
                ends.append((float(first), float(last)))
                stretches.append(Stretch(trace, float(u[a]), float(u[b - 1])))
    runs = [(*places, curve) for places, curve in zip(ends, fit_curves(stretches, TOLERANCE), strict=True)]
    if not runs:
        return _portions(np.vstack((ring, ring[:1])))
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(np.vstack((ring, ring[:1])), axis=0), axis=1)))[:-1]
    joined: list[Curve] = []
    for (_, left, run), (reached, _, after) in pairwise([*runs, runs[0]]):
        joined.append(run)
        gap = (reached - left) % total
        if gap > total / 2:  # they overlap by a hair
            gap = 0.0
        beyond = (along - left) % total
        between = (beyond > 1e-3) & (beyond < gap - 1e-3)
        way = ring[between][np.argsort(beyond[between])]
        points = _distinct(np.vstack((run.end, way, after.start)))
        if len(points) > 1:
            joined += _portions(points)
    return joined


def _portions(points: Float[ndarray, "n 2"]) -> list[Curve]:
    """A polyline as curves between its corners."""
    step = np.diff(points, axis=0)
    turn = np.abs(np.arctan2(cross(step[:-1], step[1:]), (step[:-1] * step[1:]).sum(1)))
    corners = [0, *(np.flatnonzero(turn > _CORNER) + 1), len(points) - 1]
    return curves_through([points[a : b + 1] for a, b in pairwise(corners)])


def _distinct(points: Float[ndarray, "n 2"]) -> Float[ndarray, "m 2"]:
    return points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-5)]
