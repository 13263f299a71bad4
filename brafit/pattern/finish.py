"""Pieces as they are cut: allowances, corners, notches, grain line, drill holes and labels around the sewing lines."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Point, Polygon, box, make_valid, unary_union
from shapely.affinity import rotate
from shapely.geometry.base import BaseGeometry
from shapely.ops import polylabel
from shapely.prepared import prep

from brafit.pattern.curve import Curve, right_of
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Hole, Kind, Piece, Side

Move = Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]

_DOUBLE = 3.0
"""Distance in mm of the two cuts of a double notch."""
_APART = 8.0
"""Notches that differ in meaning keep this distance in mm along the edge."""
_FINE = 0.005
"""Tolerance in mm of the polylines that areas and overlaps are found with."""


@dataclass(frozen=True)
class SewLine:
    """One edge of a piece: the line that is sewn, and the allowance beyond it."""

    name: str
    kind: Kind
    curve: Curve
    allowance: float

    @property
    def length(self) -> float:
        return self.curve.length


@dataclass(frozen=True)
class Notch:
    """A notch, or two side by side.

    Attributes:
        edge: name of its edge.
        name: of the landmark it stands for; empty for a matching notch.
        distance: from the edge's inner end along the edge, before ease, mm.
        ticks: for each cut its outer end (on the cut line) and its inner end.
        foot: where it meets the sewing line.
    """

    edge: str
    name: str
    distance: float
    ticks: Float[ndarray, "cuts 2 2"]
    foot: Float[ndarray, "2"]

    def beside(self, distance: float) -> Float[ndarray, "2"]:
        """A point that far inside the sewing line, for its name."""
        inward = self.ticks[0, 1] - self.ticks[0, 0]
        return self.foot + distance * inward / max(float(np.linalg.norm(inward)), 1e-9)


@dataclass(frozen=True)
class CutPiece:
    """A piece ready to be drawn, mm.

    Attributes:
        name: such as `lower panel`.
        side: the wearer's side it is for.
        sew: sewing lines, closing the outline of the finished piece.
        cut: the outline to cut along, smooth curves that meet in corners.
        notches, holes: as above.
        grain: the two ends of the grain line.
        label: lines of text; the first is the piece's name.
        notice: further lines below them: the warnings, wrapped.
        label_at, label_along, label_size: middle of the text, direction of its lines (to the right) and height of its
            letters.
        warnings: what failed a check.
    """

    name: str
    side: Side
    sew: tuple[SewLine, ...]
    cut: tuple[Curve, ...]
    notches: tuple[Notch, ...]
    holes: tuple[Hole, ...]
    grain: Float[ndarray, "2 2"]
    label: tuple[str, ...]
    notice: tuple[str, ...]
    label_at: Float[ndarray, "2"]
    label_along: Float[ndarray, "2"]
    label_size: float
    warnings: tuple[str, ...] = ()

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Lower left and upper right corner of the cut line."""
        outline = self.cut_outline()
        return outline.min(0), outline.max(0)

    def cut_outline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """The closed cut line as a polygon; the first point is not repeated."""
        return closed(self.cut, tolerance)

    def sew_outline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """The closed sewing line as a polygon; the first point is not repeated."""
        return closed([line.curve for line in self.sew], tolerance)

    @property
    def area(self) -> float:
        """Area within the sewing lines in mm^2."""
        return float(_valid(self.sew_outline(_FINE)).area)

    def map(self, move: Move) -> CutPiece:
        """The piece under an isometry; the label stays readable."""
        at = move(self.label_at[None])[0]
        along = move((self.label_at + self.label_along)[None])[0] - at
        return replace(
            self,
            sew=tuple(replace(line, curve=line.curve.map(move)) for line in self.sew),
            cut=tuple(curve.map(move) for curve in self.cut),
            notches=tuple(
                replace(n, ticks=move(n.ticks.reshape(-1, 2)).reshape(-1, 2, 2), foot=move(n.foot[None])[0])
                for n in self.notches
            ),
            holes=tuple(replace(hole, point=move(hole.point[None])[0]) for hole in self.holes),
            grain=move(self.grain),
            label_at=at,
            label_along=along if along[0] >= -1e-9 else -along,
        )

    def mirrored(self) -> CutPiece:
        """The piece for the other side."""
        other: Side = "left" if self.side == "right" else "right"
        label = tuple(f"{other} cup" if line == f"{self.side} cup" else line for line in self.label)
        return replace(self.map(lambda points: points * (-1.0, 1.0)), side=other, label=label)


@dataclass(frozen=True)
class Pattern:
    """The finished pieces of one cup.

    Attributes:
        name: the scan's name.
        side: the breast that was scanned.
        size, date: as labels show them.
        pieces: for that side, from the wire up.
        options: how they were finished.
        seams: for each edge name the lengths of its sides before ease, from the wire up, mm.
        warnings: what failed a check, of all pieces and of the pattern as a whole.
    """

    name: str
    side: Side
    size: str
    date: str
    pieces: tuple[CutPiece, ...]
    options: PatternOptions
    seams: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def drawn(self) -> tuple[tuple[CutPiece, ...], ...]:
        """The columns that files show: these pieces and, if asked for, the other side's."""
        mirrored = tuple(piece.mirrored() for piece in self.pieces)
        return (self.pieces, mirrored) if self.options.pair else (self.pieces,)


def closed(curves: Sequence[Curve], tolerance: float) -> Float[ndarray, "n 2"]:
    """Curves in a ring as one polygon without repeated points."""
    points = np.concatenate([curve.polyline(tolerance) for curve in curves])
    away = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-7
    return points[away]


def finish(
    pieces: Sequence[Piece],
    options: PatternOptions,
    *,
    name: str,
    side: Side,
    date: str = "",
    figures: Mapping[str, float] | None = None,
) -> Pattern:
    """Finish the pieces of one cup and check them.

    Args:
        pieces: from `pieces_from_panels`, with the same side.
        name: of the scan.
        date: for the labels; empty: none.
        figures: the fit's measured figures; `twist_deg_max` is checked if it is there.
    """
    curves = [[Curve.through(edge.points) for edge in piece.edges] for piece in pieces]
    seams: dict[str, tuple[float, ...]] = {}
    marks: dict[str, dict[str, list[float]]] = {}
    for piece, lines in zip(pieces, curves, strict=True):
        for edge, curve in zip(piece.edges, lines, strict=True):
            seams[edge.name] = (*seams.get(edge.name, ()), curve.length)
            for mark in edge.marks:
                marks.setdefault(edge.name, {}).setdefault(mark.name, []).append(mark.distance)
    whole = [
        f"seam '{edge}': its sides are {max(sides) - min(sides):.2f} mm different in length"
        for edge, sides in seams.items()
        if max(sides) - min(sides) > options.seam_tolerance
    ]
    twist = (figures or {}).get("twist_deg_max", 0.0)
    if twist > options.twist_limit:
        whole.append(f"not truly developable: twist up to {twist:.1f} degrees, the cloth will strain there")
    size = options.size or name
    done = []
    for piece, lines in zip(pieces, curves, strict=True):
        edges = {edge.name for edge in piece.edges}
        places = {
            edge.name: _notch_places(edge.kind, float(np.mean(seams[edge.name])), marks.get(edge.name, {}), options)
            for edge in piece.edges
        }
        about = [w for w in whole if not w.startswith("seam") or any(f"'{e}'" in w for e in edges)]
        done.append(_finish(piece, lines, places, options, about, (name, side, size, date)))
    own = dict.fromkeys(f"{piece.name}: {w}" for piece in done for w in piece.warnings if w not in whole)
    return Pattern(name, side, size, date, tuple(done), options, seams, (*whole, *own))


def _finish(
    piece: Piece,
    curves: Sequence[Curve],
    places: Mapping[str, list[tuple[str, float, bool]]],
    options: PatternOptions,
    about: Sequence[str],
    names: tuple[str, Side, str, str],
) -> CutPiece:
    stretch = 1 + np.array((options.ease["width"], options.ease["height"])) / 100
    eased = [curve.map(lambda points: points * stretch) for curve in curves]
    widths = [float(options.allowance[edge.kind]) for edge in piece.edges]
    sewn = closed(eased, _FINE)
    outward = (
        1.0 if _signed_area(sewn) > 0 else -1.0
    )  # the cloth lies to the left of outlines that run counter-clockwise
    warnings = list(about)
    crossings = len(replace(piece, edges=_as_edges(piece, eased)).crossings())
    if crossings:
        warnings.append(f"the outline crosses itself {crossings} times: this piece cannot be sewn")
    gap = max(float(np.linalg.norm(a.end - b.start)) for a, b in zip(eased, eased[1:] + eased[:1], strict=True))
    if gap > options.seam_tolerance:
        warnings.append(f"the edges miss each other by {gap:.2f} mm at an end")
    cut = None if crossings else _parallel_outline(eased, widths, outward)
    if cut is None:
        cut, message = _united_outline(eased, widths, outward)
        warnings += [message] if message and not crossings else []
    if clipped := _too_wide(closed(cut, 0.02), options):
        warnings.append(clipped)
    notches = [
        _notch(edge.name, curve, after, width, outward, place, options, reverse=i > 0)
        for i, (edge, curve, after, width) in enumerate(zip(piece.edges, curves, eased, widths, strict=True))
        for place in places[edge.name]
    ]
    inside = _valid(sewn)
    holes = [replace(hole, point=hole.point * stretch) for hole in piece.holes]
    holes = [hole for hole in holes if inside.buffer(-2.0).contains(Point(*hole.point))]
    grain = _grain_line(inside, options.grain, holes)
    label, notice = _label(piece, options, *names), _wrapped(warnings)
    taken = [hole.point for hole in holes] + [notch.beside(3.5) for notch in notches if notch.name]
    label, at, along, height = _label_place(inside, label, notice, grain, taken)
    sew = tuple(SewLine(e.name, e.kind, c, w) for e, c, w in zip(piece.edges, eased, widths, strict=True))
    return CutPiece(
        name=piece.name,
        side=names[1],
        sew=sew,
        cut=tuple(cut),
        notches=tuple(notches),
        holes=tuple(holes),
        grain=grain,
        label=label,
        notice=notice,
        label_at=at,
        label_along=along,
        label_size=height,
        warnings=tuple(warnings),
    )


def _as_edges(piece: Piece, curves: Sequence[Curve]) -> tuple:
    return tuple(replace(edge, points=c.polyline(0.02)) for edge, c in zip(piece.edges, curves, strict=True))


# Allowance


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


def _united_outline(curves: Sequence[Curve], widths: Sequence[float], outward: float) -> tuple[list[Curve], str]:
    """The outline of everything that lies within the allowances, and what is wrong with it."""
    parts: list[BaseGeometry] = [_valid(closed(curves, _FINE))]
    overlap = 0.0
    for i, (curve, width) in enumerate(zip(curves, widths, strict=True)):
        if width == 0:
            continue
        u = np.linspace(0, len(curve.controls), 60 * len(curve.controls) + 1)
        points, tangents = curve.trace(u)
        outer = points + width * outward * right_of(tangents)
        quads = [Polygon(q).convex_hull for q in np.stack((points[:-1], points[1:], outer[1:], outer[:-1]), axis=1)]
        strip = unary_union(quads)
        overlap += sum(q.area for q in quads) - strip.area + strip.intersection(parts[0]).area
        parts.append(strip)
        corner = _corner(curve, curves[(i + 1) % len(curves)], width, widths[(i + 1) % len(curves)], outward)
        if corner is not None:
            parts.append(_valid(np.vstack((curve.end[None], corner))))
    whole = unary_union([part.buffer(1e-6) for part in parts])
    pieces = sorted(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    largest = pieces[-1]
    message = "the allowance overlaps itself and was trimmed" if overlap > 1.0 or len(largest.interiors) else ""
    if len(pieces) > 1 and pieces[-2].area > 1.0:
        message = "the allowance falls into several parts; only the largest is drawn"
    ring = np.asarray(largest.simplify(1e-3).exterior.coords)[:-1]
    return _smooth_portions(ring[::-1] if outward * _signed_area(ring) < 0 else ring), message


def _smooth_portions(ring: Float[ndarray, "n 2"]) -> list[Curve]:
    """A polygon as curves between its corners."""
    ring = ring[np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) > 1e-4]
    go = np.roll(ring, -1, axis=0) - ring
    come = np.roll(go, 1, axis=0)
    turn = np.abs(np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], (come * go).sum(1)))
    corners = np.nonzero(turn > np.radians(12))[0]
    if len(corners) == 0:
        corners = np.array([0])
    ends = np.append(corners[1:], corners[0] + len(ring))
    portions = [ring[np.arange(a, b + 1) % len(ring)] for a, b in zip(corners, ends, strict=True)]
    return [Curve.through(portion) for portion in portions]


def _too_wide(outline: Float[ndarray, "n 2"], options: PatternOptions) -> str:
    """What to say if the piece does not fit the cloth, its grain line along the selvedge."""
    angle = math.radians(options.grain)
    across = float(np.ptp(outline @ np.array((-math.sin(angle), math.cos(angle)))))
    limit = options.material_width
    return f"{across:.0f} mm across the grain, wider than the material ({limit:.0f} mm)" if across > limit else ""


# Notches


def _notch_places(
    kind: Kind, length: float, marks: Mapping[str, Sequence[float]], options: PatternOptions
) -> list[tuple[str, float, bool]]:
    """Name, distance from the inner end and doubleness of an edge's notches.

    They follow from the seam alone, so that both of its sides get the same. Where a landmark is in the way, a matching
    notch moves towards its own end of the seam.
    """
    named = [(name, float(np.mean(distances))) for name, distances in marks.items()]
    places = [(name, distance, False) for name, distance in named]
    count = 0 if kind == "upper" else options.notches
    for k in range(1, count + 1):
        distance, outer = length * k / (count + 1), 2 * k > count + 1
        for _, other in sorted(named, key=lambda entry: entry[1], reverse=not outer):
            if abs(distance - other) < _APART:
                distance = other + (_APART if outer else -_APART)
        if _APART < distance < length - _APART:
            places.append(("", distance, outer))
    return sorted(places, key=lambda place: place[1])


def _notch(
    edge: str,
    curve: Curve,
    eased: Curve,
    width: float,
    outward: float,
    place: tuple[str, float, bool],
    options: PatternOptions,
    reverse: bool,
) -> Notch:
    name, distance, double = place
    spread = (-_DOUBLE / 2, _DOUBLE / 2) if double else (0.0,)
    depth = min(options.notch_depth, 2 * width / 3) if width > 0 else options.notch_depth
    u = [curve.place(curve.length - distance - d if reverse else distance + d) for d in (0.0, *spread)]
    points, tangents = eased.trace(np.array(u))
    out = outward * right_of(tangents)
    roots = points + width * out
    ticks = np.stack((roots, roots - depth * out), axis=1)[1:]
    return Notch(edge, name, distance, ticks, points[0])


# Grain line and label


def _grain_line(inside: Polygon, angle: float, holes: Sequence[Hole]) -> Float[ndarray, "2 2"]:
    """Along the grain, off the middle of the piece so that the label has room; four fifths of what fits there."""
    along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
    across = np.array((-along[1], along[0]))
    outline = np.asarray(inside.exterior.coords)
    low, high = (outline @ across).min(), (outline @ across).max()
    best, best_length = np.stack((outline[0], outline[0] + along)), 0.0
    for share in (0.25, 0.75, 0.32, 0.68):
        level = low + share * (high - low)
        if any(abs(hole.point @ across - level) < 6 for hole in holes):
            continue
        chord = _longest_chord(outline, along, across, level)
        length = float(np.linalg.norm(chord[1] - chord[0]))
        if length > 1.15 * best_length:
            middle, half = chord.mean(0), min(0.8 * length, 150.0) / 2
            best, best_length = np.stack((middle - half * along, middle + half * along)), length
    return best


def _longest_chord(outline: ndarray, along: ndarray, across: ndarray, level: float) -> Float[ndarray, "2 2"]:
    """The longest part inside a polygon of the line at `level` across."""
    side = outline @ across - level
    i = np.nonzero((side[:-1] < 0) != (side[1:] < 0))[0]
    share = side[i] / (side[i] - side[i + 1])
    hits = np.sort((outline[i] + share[:, None] * (outline[i + 1] - outline[i])) @ along)
    pairs = hits[: len(hits) // 2 * 2].reshape(-1, 2)
    if len(pairs) == 0:
        return np.stack((level * across, level * across))
    ends = pairs[np.diff(pairs, axis=1)[:, 0].argmax()]
    return ends[:, None] * along + level * across


def _label(piece: Piece, options: PatternOptions, name: str, side: Side, size: str, date: str) -> tuple[str, ...]:
    kinds = dict.fromkeys(edge.kind for edge in piece.edges)
    allowances = {kind: options.length(options.allowance[kind]) for kind in kinds}
    same = len(set(allowances.values())) == 1
    allowance = next(iter(allowances.values())) if same else ", ".join(f"{k} {v}" for k, v in allowances.items())
    ease = ", ".join(f"{way} {value:+g} %" for way, value in options.ease.items() if value)
    count = options.quantity
    lines = [piece.name, name, f"{side} cup", f"size {size}", f"cut {count}" + (f" + {count} mirrored" * options.pair)]
    lines += [f"allowance {allowance}", f"ease {ease}" if ease else "no ease", date]
    return tuple(" ".join(line.split()) for line in lines if line.strip())


def _wrapped(warnings: Sequence[str]) -> tuple[str, ...]:
    return tuple(line for words in warnings for line in textwrap.wrap(f"WARNING: {words}", 30))


LINE = 1.3
"""Distance of the lines of a label, in heights of its letters."""
LETTER = 0.55
"""Width of a letter of a sans-serif face, in its height."""
_LARGEST, _READABLE, _SMALLEST = 5.0, 2.5, 1.0


def _label_place(
    inside: Polygon,
    label: tuple[str, ...],
    notice: tuple[str, ...],
    grain: Float[ndarray, "2 2"],
    others: Sequence[Float[ndarray, "2"]],
) -> tuple[tuple[str, ...], Float[ndarray, "2"], Float[ndarray, "2"], float]:
    """The label and where it fits best: middle, direction and height of the letters.

    On a narrow piece where upright lines would become too small to read, lines are joined and turned.
    """
    taken: list[BaseGeometry] = [Point(*point).buffer(4.0) for point in others]
    taken.append(LineString(grain).buffer(2.0))
    free = inside.buffer(-1.5).difference(unary_union(taken))
    best = (*_roomiest(free, inside, (*label, *notice)), np.array((1.0, 0.0)), label)
    if best[1] < _READABLE:
        joined = tuple(", ".join(label[i : i + 3]) for i in range(0, len(label), 3))
        for angle in (0, 90, 30, -30, 60, -60):
            along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
            turned = rotate(free, -angle, origin=(0, 0)), rotate(inside, -angle, origin=(0, 0))
            at, size = _roomiest(*turned, (*joined, *notice))
            if size > best[1]:
                best = (at[0] * along + at[1] * np.array((-along[1], along[0])), size, along, joined)
    at, size, along, lines = best
    return lines, at, along, size


def _roomiest(free: BaseGeometry, inside: Polygon, lines: Sequence[str]) -> tuple[Float[ndarray, "2"], float]:
    """Middle and height of the letters of level lines of text, as large as fits."""
    wide, high = LETTER * max(len(line) for line in lines), LINE * len(lines)
    prepared = prep(free)
    parts = [part for part in getattr(free, "geoms", [free]) if part.area > 0] or [inside]
    low, high_corner = np.array(inside.bounds[:2]), np.array(inside.bounds[2:])
    grid = [low + (high_corner - low) * (x, y) for x in np.linspace(0.1, 0.9, 17) for y in np.linspace(0.15, 0.85, 11)]
    centres = [np.array(polylabel(part, 1.0).coords[0]) for part in parts] + grid
    best, size = centres[0], _SMALLEST
    for centre in centres:
        while True:
            larger = size * 1.05
            half = np.array((wide, high)) * larger / 2
            if larger > _LARGEST or not prepared.contains(box(*centre - half, *centre + half)):
                break
            best, size = centre, larger
    return best, size


# Polygons


def _signed_area(points: Float[ndarray, "n 2"]) -> float:
    x, y = points.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def _valid(points: Float[ndarray, "n 2"]) -> Polygon:
    """The largest proper polygon in an outline that may cross itself."""
    shape = make_valid(Polygon(points))
    parts = [part for part in getattr(shape, "geoms", [shape]) if isinstance(part, Polygon)]
    parts += [p for part in getattr(shape, "geoms", []) for p in getattr(part, "geoms", []) if isinstance(p, Polygon)]
    return max(parts, key=lambda part: part.area, default=Polygon())


def _distinct(points: Float[ndarray, "n 2"]) -> Float[ndarray, "m 2"]:
    return points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6)]
