"""Notches: where they lie on an edge, and how they are cut."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.pattern.allowance import crossings
from brafit.pattern.curve import Curve, right_of
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Kind

MARK = "mark"
"""The form of a notch on an edge without allowance: a drawn tick, as a cut would be in the finished piece."""
_DOUBLE = 3.0
"""Distance in mm of the two cuts of a double notch, and what is left between wide ones."""
_APART = 15.0
"""Notches that differ in meaning keep this distance in mm along the edge: no two of them read as a double one."""


@dataclass(frozen=True)
class Notch:
    """A notch, or two side by side.

    Attributes:
        edge: name of its edge.
        name: of the landmark it stands for; empty for a matching notch.
        distance: from the edge's inner end along the edge, before ease, mm.
        ticks: for each cut or drawn tick its outer end (on the cut line) and its inner end.
        foot: where it meets the sewing line.
        form, width: how it is cut, see `PatternOptions.notch_form`, or `MARK`; mm.
    """

    edge: str
    name: str
    distance: float
    ticks: Float[ndarray, "cuts 2 2"]
    foot: Float[ndarray, "2"]
    form: str = "slit"
    width: float = 0.0

    @property
    def is_cut(self) -> bool:
        return self.form != MARK

    @property
    def inward(self) -> Float[ndarray, "2"]:
        """Unit vector across the edge into the piece."""
        inward = self.ticks[0, 1] - self.ticks[0, 0]
        return inward / max(float(np.linalg.norm(inward)), 1e-9)

    @property
    def strokes(self) -> list[Float[ndarray, "k 2"]]:
        """The lines of all cuts."""
        across = self.width / 2 * np.array((-self.inward[1], self.inward[0]))
        lines = []
        for root, inner in self.ticks:
            if self.form == "v":
                lines.append(np.stack((root - across, inner, root + across)))
            else:
                lines.append(np.stack((root, inner)))
            if self.form == "t":
                lines.append(np.stack((inner - across, inner + across)))
        return lines


def notch_places(
    kind: Kind, length: float, marks: Mapping[str, Sequence[float]], options: PatternOptions
) -> list[tuple[str, float, bool]]:
    """Name, distance from the inner end and doubleness of an edge's notches.

    They follow from the seam alone, so that both of its sides get the same. Where a landmark is in the way, a matching
    notch moves towards its own end of the seam.
    """
    named = [(name, float(np.mean(distances))) for name, distances in marks.items()]
    if kind == "wire" and options.wire["play"] > 0:
        named += [("wire end", options.wire["play"]), ("wire end", length - options.wire["play"])]
    places = [(name, distance, False) for name, distance in named]
    count = 0 if kind == "upper" else options.notches
    for k in range(1, count + 1):
        distance, outer = length * k / (count + 1), 2 * k > count + 1
        for _, other in sorted(named, key=lambda entry: entry[1], reverse=not outer):
            if abs(distance - other) < _APART:
                distance = other + (_APART if outer else -_APART)
        if _APART / 2 < distance < length - _APART / 2:
            places.append(("", distance, outer))
    return sorted(places, key=lambda place: place[1])


def notches_on(
    edge: str,
    curves: tuple[Curve, Curve],
    reverse: bool,
    outward: float,
    outline: Float[ndarray, "n 2"],
    width: float,
    places: Sequence[tuple[str, float, bool]],
    options: PatternOptions,
) -> list[Notch]:
    """The notches of one edge.

    Args:
        edge: its name.
        curves: the edge before and after ease.
        reverse: whether it runs from the outer end to the inner.
        outward: 1 where the cloth lies to its left, -1 where it lies to its right.
        outline: the cut line.
        width: of the allowance, mm.
        places: from `notch_places`.
        options: depth, form and width of the notches.
    """
    if not places:
        return []
    form = options.notch_form if width > 0 else MARK
    wide = options.notch_width if form in ("v", "t") else 0.0
    curve, eased = curves
    depth = min(options.notch_depth, 2 * width / 3) if width > 0 else options.notch_depth
    half = (_DOUBLE + wide) / 2
    spreads = [(0.0, *((-half, half) if double else (0.0,))) for _, _, double in places]
    along = np.array([distance + d for (_, distance, _), spread in zip(places, spreads, strict=True) for d in spread])
    points, tangents = eased.trace(curve.places(curve.length - along if reverse else along))
    out = outward * right_of(tangents)
    roots = crossings(outline, points, out, width)
    ticks = np.stack((roots, roots - depth * out), axis=1)
    notches, first = [], 0
    for (name, distance, _), spread in zip(places, spreads, strict=True):
        own = ticks[first + 1 : first + len(spread)]
        notches.append(Notch(edge, name, distance, own, points[first], form, wide))
        first += len(spread)
    return notches
