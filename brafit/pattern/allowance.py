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
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Polygon, make_valid, unary_union
from shapely.geometry.base import BaseGeometry

from brafit.pattern.curve import TOLERANCE, Curve, closed, cross, fit_curve, right_of

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


def cut_outline(curves: Sequence[Curve], widths: Sequence[float], outward: float) -> tuple[list[Curve], list[str]]:
    """The cut line around a piece, curves that meet in corners, and what is wrong with it.

    Args:
        curves: the sewing lines in a ring, mm.
        widths: the allowance of each, mm.
        outward: 1 where the piece lies to the left of its outline, -1 where it lies to the right.
    """
    plain = _parallel_outline(curves, widths, outward)
    return (plain, []) if plain is not None else _trimmed_outline(curves, widths, outward)


def crossing(
    ring: LineString, point: Float[ndarray, "2"], outward: Float[ndarray, "2"], width: float
) -> Float[ndarray, "2"]:
    """Where the normal of a sewing line meets the cut line: `width` away, or farther in a hollow.

    Args:
        ring: the cut line.
        point: on the sewing line.
        outward: unit normal there.
    """
    if width > 0:
        ray = LineString((point + 0.9 * width * outward, point + 5 * width * outward))
        hits = shapely.get_coordinates(ray.intersection(ring))
        found = (hits - point) @ outward
        if len(found) and found.min() > width + 0.02:
            return point + found.min() * outward
    return point + width * outward


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


def _parallel_outline(curves: Sequence[Curve], widths: Sequence[float], outward: float) -> list[Curve] | None:
    """Parallel curves joined at the corners; None where that is no simple outline around the piece."""
    offsets = [curve.offset(outward * width) for curve, width in zip(curves, widths, strict=True)]
    parallels = [offset for offset in offsets if offset is not None]
    if len(parallels) < len(curves):
        return None
    outline: list[Curve] = []
    for i, parallel in enumerate(parallels):
        j = (i + 1) % len(curves)
        corner = _corner(curves[i], curves[j], widths[i], widths[j], outward)
        if corner is None:
            return None
        outline.append(parallel)
        points = _distinct(np.vstack((parallel.end, corner, parallels[j].start)))
        if len(points) > 1:
            outline.append(Curve.line(*points))
    around = Polygon(closed(outline, _FINE))
    inner = Polygon(closed(curves, _FINE))
    # the cut line may coincide with the sewing line, so containment is asked with a hair's breadth to spare
    good = around.is_valid and inner.is_valid and around.buffer(1e-3).contains(inner)
    return outline if good else None


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
        u = np.linspace(0, len(curve.controls), 60 * len(curve.controls) + 1)
        points, tangents = curve.trace(u)
        outer = points + width * outward * right_of(tangents)
        quads = np.stack((points[:-1], points[1:], outer[1:], outer[:-1]), axis=1)
        parts.append(unary_union([Polygon(quad).convex_hull for quad in quads]))
        following = (i + 1) % len(curves)
        corner = _corner(curve, curves[following], width, widths[following], outward)
        if corner is not None:
            parts.append(valid_polygon(np.vstack((curve.end[None], corner))))
    whole = unary_union([part.buffer(1e-6) for part in parts])
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


def _widest(curve: Curve, width: float, exterior: LineString) -> float:
    """How far the cut line is from a sewing line at most."""
    points, _ = curve.trace(np.linspace(0, len(curve.controls), 24 * len(curve.controls) + 1))
    return float(shapely.distance(shapely.points(points), exterior).max())


def _traced(
    ring: Float[ndarray, "n 2"], curves: Sequence[Curve], widths: Sequence[float], outward: float
) -> list[Curve]:
    """A polygon as smooth curves: the parallels wherever it follows them, else through its own corners."""
    outline = LineString(np.vstack((ring, ring[:1])))
    total = outline.length
    runs: list[tuple[float, float, Curve]] = []  # place on the ring of start and end, curve
    for curve, width in zip(curves, widths, strict=True):

        def trace(u: ndarray, curve: Curve = curve, width: float = width) -> tuple[ndarray, ndarray]:
            position, tangent = curve.trace(u)
            return position + width * outward * right_of(tangent), tangent

        u = np.linspace(0, len(curve.controls), 80 * len(curve.controls) + 1)
        points, tangents = trace(u)
        on = np.asarray(shapely.distance(shapely.points(points), outline) < _NEAR)
        on[1:-1] &= ((points[2:] - points[:-2]) * tangents[1:-1]).sum(1) > 0  # not where the parallel runs backwards
        edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
        for a, b in edges.reshape(-1, 2):
            part = points[a:b]
            if b - a > 3 and np.linalg.norm(np.diff(part, axis=0), axis=1).sum() > 0.5:
                first, last = (outline.project(shapely.Point(part[k])) for k in (0, -1))
                runs.append((first, last, fit_curve(trace, float(u[a]), float(u[b - 1]), TOLERANCE)))
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
    return [Curve.through(points[a : b + 1]) for a, b in pairwise(corners)]


def _distinct(points: Float[ndarray, "n 2"]) -> Float[ndarray, "m 2"]:
    return points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-5)]
