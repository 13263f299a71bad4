"""Pieces as they are cut: allowances, corners, notches, grain line, drill holes and labels around the sewing lines."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Point, Polygon

from brafit.pattern.allowance import Ring, cut_outlines, signed_area, valid_polygon
from brafit.pattern.caption import SeamSide, place_captions
from brafit.pattern.cloth import as_cut, reshaped, unequal
from brafit.pattern.curve import Curve, closed, curves_through, enclosed_area
from brafit.pattern.grain import grain_angle, grain_line, grain_name, too_wide
from brafit.pattern.instructions import label_stages
from brafit.pattern.label import Caption, Label, Sight, place_label
from brafit.pattern.notch import Notch, notch_places, notches_on
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Hole, Kind, Piece, Side, self_crossings
from brafit.remarks import Remark

Move = Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]

CROSSES = "crosses_itself"
"""Code of the warning of a piece that cannot be sewn."""
_HEADS = {
    CROSSES: "the outline crosses itself",
    "seam_sides_differ": "seam sides differ",
    "not_developable": "not truly developable",
}
"""What a label with little room says of some warnings; of the others it says the whole."""
_FINE, _COARSE = 0.005, 0.02
"""Tolerances in mm of the polylines that overlaps are found with, and room for texts."""


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
class CutPiece:
    """A piece ready to be drawn, mm.

    Attributes:
        name: such as `lower panel`.
        side: the wearer's side it is for.
        sew: sewing lines, closing the outline of the finished piece.
        cut: the outline to cut along, smooth curves that meet in corners.
        notches, holes: as above.
        grain: the two ends of the grain line.
        label: what the piece says about itself, with its warnings below.
        captions: names of the ends and of the notches that stand for landmarks.
        warnings: which checks failed.
    """

    name: str
    side: Side
    sew: tuple[SewLine, ...]
    cut: tuple[Curve, ...]
    notches: tuple[Notch, ...]
    holes: tuple[Hole, ...]
    grain: Float[ndarray, "2 2"]
    label: Label
    captions: tuple[Caption, ...] = ()
    warnings: tuple[Remark, ...] = ()

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Lower left and upper right corner of all that is drawn."""
        return self._bounds

    @cached_property
    def _bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        return self.corners.min(0), self.corners.max(0)

    @cached_property
    def corners(self) -> Float[ndarray, "n 2"]:
        """Points whose hull holds all that is drawn."""
        drawn = [self.cut_outline(), self.label.corners, *(caption.corners for caption in self.captions)]
        return np.concatenate(drawn)

    def cut_outline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """The closed cut line as a polygon; the first point is not repeated."""
        return closed(self.cut, tolerance)

    def sew_outline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """The closed sewing line as a polygon; the first point is not repeated."""
        return closed([line.curve for line in self.sew], tolerance)

    @property
    def area(self) -> float:
        """Area within the sewing lines in mm^2."""
        return abs(enclosed_area([line.curve for line in self.sew]))

    def map(self, move: Move) -> CutPiece:
        """The piece under an isometry; the label stays readable."""
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
            label=self.label.map(move),
            captions=tuple(caption.map(move) for caption in self.captions),
        )

    def mirrored(self) -> CutPiece:
        """The piece for the other side."""
        other: Side = "left" if self.side == "right" else "right"
        moved = self.map(lambda points: points * (-1.0, 1.0))
        return replace(moved, side=other, label=_for_side(moved.label, self.side, other))


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
        warnings: which checks failed, of all pieces and of the pattern as a whole.
        fit_warnings: of the scan and of the fit that the pieces come from: whoever cuts them may have no report.
    """

    name: str
    side: Side
    size: str
    date: str
    pieces: tuple[CutPiece, ...]
    options: PatternOptions
    seams: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    warnings: tuple[Remark, ...] = ()
    fit_warnings: tuple[Remark, ...] = ()

    @property
    def drawn(self) -> tuple[tuple[CutPiece, ...], ...]:
        """The columns that files show: these pieces and, if asked for, the other side's."""
        return (self.pieces, tuple(piece.mirrored() for piece in self.pieces)) if self.options.pair else (self.pieces,)

    @property
    def reshaped(self) -> bool:
        """Whether pieces are cut to other sizes than they have when worn, for ease or stretch."""
        return reshaped(self.options)

    @property
    def seam_difference(self) -> float:
        """Largest difference in length of the two sides of a seam as the pieces are cut, mm; 0 without a seam."""
        sides: dict[str, list[float]] = {}
        for line in (line for piece in self.pieces for line in piece.sew):
            sides.setdefault(line.name, []).append(line.length)
        return max((max(lengths) - min(lengths) for lengths in sides.values()), default=0.0)


def warnings_of(patterns: Sequence[Pattern]) -> list[str]:
    """All warnings, those of the fits first, with the patterns' names if there are several."""
    several = len(patterns) > 1
    named = ((pattern, warning) for pattern in patterns for warning in (*pattern.fit_warnings, *pattern.warnings))
    return [f"{pattern.name}: {warning}" if several else str(warning) for pattern, warning in named]


def finish(
    pieces: Sequence[Piece],
    options: PatternOptions,
    *,
    name: str,
    side: Side,
    date: str = "",
    figures: Mapping[str, float] | None = None,
    fit_warnings: Sequence[Remark] = (),
) -> Pattern:
    """Finish the pieces of one cup and check them.

    Args:
        pieces: from `pieces_from_panels`, with the same side.
        options: allowances, notches, labels, limits of the checks.
        name: of the scan.
        side: `left` or `right`, for the labels.
        date: for the labels; empty: none.
        figures: the fit's measured figures; `twist_deg_max` is checked if it is there.
        fit_warnings: of the scan and of its fit, to be told wherever the pattern is printed.
    """
    sewn = _sewn(pieces, options, side)
    seams: dict[str, tuple[float, ...]] = {}
    eased: dict[str, tuple[float, ...]] = {}
    marks: dict[str, dict[str, list[float]]] = {}
    for own in sewn:
        for edge, curve, after in zip(own.piece.edges, own.curves, own.eased, strict=True):
            seams[edge.name] = (*seams.get(edge.name, ()), curve.length)
            eased[edge.name] = (*eased.get(edge.name, ()), after.length)
            for mark in edge.marks:
                marks.setdefault(edge.name, {}).setdefault(mark.name, []).append(mark.distance)
    whole = _unequal_seams(seams, eased, options)
    twist = (figures or {}).get("twist_deg_max", 0.0)
    if twist > options.twist_limit:
        words = f"not truly developable: twist up to {twist:.1f} degrees, the cloth will strain there"
        whole.append(Remark("not_developable", words))
    size = options.size or name
    outlines = cut_outlines([Ring(own.eased, own.widths, own.outward, own.seams) for own in sewn])
    done = []
    for number, (own, (cut, messages)) in enumerate(zip(sewn, outlines, strict=True), start=1):
        elsewhere = set(seams) - {edge.name for edge in own.piece.edges}
        places = {
            edge.name: notch_places(edge.kind, float(np.mean(seams[edge.name])), marks.get(edge.name, {}), options)
            for edge in own.piece.edges
        }
        about = [warning for warning in whole if warning.about not in elsewhere]
        done.append(
            _finish(own, cut, messages, places, options, about, (name, side, f"piece {number} of {len(sewn)}", date))
        )
    own = dict.fromkeys(replace(w, about=piece.name) for piece in done for w in piece.warnings if w not in whole)
    return Pattern(name, side, size, date, tuple(done), options, seams, (*whole, *own), tuple(fit_warnings))


def _unequal_seams(
    seams: Mapping[str, Sequence[float]], eased: Mapping[str, Sequence[float]], options: PatternOptions
) -> list[Remark]:
    """Of seams whose sides differ in length; of what ease and stretch make of them only if they match without."""

    def differing(lengths: Mapping[str, Sequence[float]]) -> dict[str, float]:
        found = {edge: max(sides) - min(sides) for edge, sides in lengths.items()}
        return {seam: by for seam, by in found.items() if by > options.seam_tolerance}

    if found := differing(seams):
        words = "its sides are {:.2f} mm different in length"
        return [Remark("seam_sides_differ", words.format(by), seam) for seam, by in found.items()]
    change, remedy = unequal(options)  # every piece is eased along its own chord
    words = f"with this {change} its sides are {{:.1f}} mm different in length"
    remedy = f"sew notch to notch, or {remedy}"
    return [Remark("seam_sides_differ", words.format(by), seam, remedy) for seam, by in differing(eased).items()]


@dataclass(frozen=True)
class _Sewn:
    """A piece's sewing lines.

    Attributes:
        curves, eased: its edges before and after ease.
        widths: the allowance of each.
        seams: the names of those that are sewn to another piece; empty for the others.
        outline: the polygon that the eased ones make.
        outward: 1 where the cloth lies to the left of the outline, -1 where it lies to the right.
    """

    piece: Piece
    curves: Sequence[Curve]
    eased: Sequence[Curve]
    widths: Sequence[float]
    seams: Sequence[str]
    outline: Float[ndarray, "n 2"]
    outward: float

    @property
    def sides(self) -> list[SeamSide]:
        """The edges that are sewn to another piece, from their inner ends."""
        edges = enumerate(zip(self.seams, self.eased, self.widths, strict=True))
        whole = [
            SeamSide(name, curve.reversed() if i else curve, width, -self.outward if i else self.outward)
            for i, (name, curve, width) in edges
        ]
        return [side for side in whole if side.name]


def _sewn(pieces: Sequence[Piece], options: PatternOptions, side: Side) -> list[_Sewn]:
    curves = iter(curves_through([edge.points for piece in pieces for edge in piece.edges]))
    change, found = as_cut(options, side), []
    for piece in pieces:
        own = [next(curves) for _ in piece.edges]
        eased = own if (change == np.eye(2)).all() else [curve.map(lambda points: points @ change) for curve in own]
        outline = closed(eased, _FINE)
        widths = [options.allowed(edge.kind) for edge in piece.edges]
        seams = [edge.name if edge.kind == "ridge" else "" for edge in piece.edges]
        found.append(_Sewn(piece, own, eased, widths, seams, outline, 1.0 if signed_area(outline) > 0 else -1.0))
    return found


def _finish(
    sewn: _Sewn,
    cut: Sequence[Curve],
    messages: Sequence[Remark],
    places: Mapping[str, list[tuple[str, float, bool]]],
    options: PatternOptions,
    about: Sequence[Remark],
    names: tuple[str, Side, str, str],
) -> CutPiece:
    piece, eased, widths = sewn.piece, sewn.eased, sewn.widths
    name, side, number, date = names
    warnings = list(about)
    coarse = closed(eased, _COARSE)
    crossed = len(self_crossings(coarse))
    if crossed:
        times = f" {crossed} times" * (crossed > 1)
        warnings.append(Remark(CROSSES, f"the outline crosses itself{times}: this piece cannot be sewn"))
    gap = max(float(np.linalg.norm(a.end - b.start)) for a, b in zip(eased, [*eased[1:], eased[0]], strict=True))
    if gap > options.seam_tolerance:
        warnings.append(Remark("edges_apart", f"the edges miss each other by {gap:.2f} mm at an end"))
    warnings += [] if crossed else messages
    outline = closed(cut, _FINE)
    if words := too_wide(outline, options, side):
        warnings.append(Remark("too_wide", words))
    notches = [
        notch
        for i, edge in enumerate(piece.edges)  # the first edge runs from the inner end, the others back to it
        for notch in notches_on(
            edge.name, (sewn.curves[i], eased[i]), i > 0, sewn.outward, outline, widths[i], places[edge.name], options
        )
    ]
    inside = valid_polygon(coarse)
    holes = [replace(hole, point=hole.point @ as_cut(options, side)) for hole in piece.holes]
    holes = [hole for hole in holes if inside.contains(Point(*hole.point).buffer(2.0))]
    grain = grain_line(inside, grain_angle(options, side), holes)
    sight = Sight(inside, Polygon(closed(cut, _COARSE)), [line for notch in notches for line in notch.strokes])
    for hole in holes:
        sight.take(Point(*hole.point).buffer(3.5))
    sight.take(LineString(grain).buffer(1.6))
    named = [(notch.name, notch.foot, notch.inward) for notch in notches if notch.name]
    inner = [(hole.name, hole.point) for hole in holes]
    captions = place_captions(sight, eased, named, inner, (grain_name(options), grain), sewn.sides)
    widest: Side = "right" if options.pair else side  # the label of the mirrored piece needs its room too
    label = place_label(sight, label_stages(piece, options, name, widest, number, date), _notices(warnings))
    label = _for_side(label, widest, side)
    sew = tuple(SewLine(e.name, e.kind, c, w) for e, c, w in zip(piece.edges, eased, widths, strict=True))
    return CutPiece(
        name=piece.name,
        side=side,
        sew=sew,
        cut=tuple(cut),
        notches=tuple(notches),
        holes=tuple(holes),
        grain=grain,
        label=label,
        captions=captions,
        warnings=tuple(warnings),
    )


def _for_side(label: Label, side: Side, other: Side) -> Label:
    """The label with the other side in place of one; a scan's name may hold the same words."""
    own = re.compile(rf"(^|, ){side} cup(?=$|, )")
    lines, whole = (
        tuple(own.sub(rf"\g<1>{other} cup", line) for line in lines) for lines in (label.lines, label.whole)
    )
    return replace(label, lines=lines, whole=whole)


def _notices(warnings: Sequence[Remark]) -> list[tuple[str, ...]]:
    """Warnings as a label says them, in full and then ever shorter; the legend's page has them in full."""
    if not warnings:
        return [()]
    heads = dict.fromkeys(_HEADS.get(w.code, str(w)) for w in warnings)
    texts = [tuple(map(str, warnings)), (f"{'; '.join(heads)}, see legend",)]
    if not any(w.code == CROSSES for w in warnings):  # of which a piece must never be silent
        texts += [("see legend",), ()]
    return [notice(words) for words in texts]


def notice(warnings: Iterable[object], letters: int = 30) -> tuple[str, ...]:
    """Warnings in short lines."""
    return tuple(line for words in warnings for line in textwrap.wrap(f"WARNING: {words}", letters))
