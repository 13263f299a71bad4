"""Finished dimensions: what a pattern engineer checks a cup by, from the fitted cup and its finished pieces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel
from brafit.pattern.finish import Pattern
from brafit.pattern.piece import pieces_from_panels

Key = tuple[str, str]
"""Part and name of a dimension."""


@dataclass(frozen=True)
class Dimension:
    """One measure: what it belongs to, its name, its value and unit (`mm` or `cm2`), and its standard deviation over
    scans of the same breast where that is known.
    """

    part: str
    name: str
    value: float
    unit: str
    sd: float | None = None


class Fitted(Protocol):
    """A cup and its flat panels: a fit or one of its alternatives."""

    @property
    def shape(self) -> CupShape: ...

    @property
    def panels(self) -> Sequence[FlatPanel]: ...


def dimensions(
    shape: CupShape,
    pattern: Pattern,
    apex: Float[ndarray, "3"],
    strap_point: Float[ndarray, "3"] | None = None,
    deviation: Mapping[Key, float] | None = None,
) -> list[Dimension]:
    """Edges, widths and areas of the pieces; depth and apex distances (straight) of the cup.

    Args:
        shape: the cup, cup frame, mm, no batch dimension.
        pattern: its finished pieces; with ease, their lengths are those to cut, not those worn.
        apex: bust point, cup frame.
        deviation: from `dimension_deviation`.
    """
    table = []
    for piece in pattern.pieces:
        lines = {line.name: line.length for line in piece.sew}
        table += _of_piece(piece.name, lines, piece.sew_outline(), piece.area)
    table += _of_cup(shape, apex, strap_point)
    table.append(Dimension("cup", "area of all panels", sum(piece.area for piece in pattern.pieces) / 100, "cm2"))
    known = deviation or {}
    return [replace(d, sd=known.get((d.part, d.name))) for d in table]


def dimension_deviation(
    fit: Fitted,
    alternatives: Sequence[Fitted],
    apex: Float[ndarray, "3"],
    strap_point: Float[ndarray, "3"] | None = None,
) -> dict[Key, float]:
    """Standard deviation of every dimension, before ease; empty without alternatives (`brafit.fit.certainty`)."""

    def measured(cup: Fitted) -> dict[Key, float]:
        pieces = pieces_from_panels(cup.panels)
        table = _of_cup(cup.shape, apex, strap_point)
        for piece in pieces:
            lines = {edge.name: edge.length for edge in piece.edges}
            table += _of_piece(piece.name, lines, piece.outline, piece.area)
        table.append(Dimension("cup", "area of all panels", sum(piece.area for piece in pieces) / 100, "cm2"))
        return {(d.part, d.name): d.value for d in table}

    if not alternatives:
        return {}
    best, others = measured(fit), [measured(other) for other in alternatives]
    return {key: math.sqrt(sum((other[key] - value) ** 2 for other in others)) for key, value in best.items()}


def _of_piece(part: str, lines: Mapping[str, float], outline: Float[ndarray, "n 2"], area: float) -> list[Dimension]:
    width, height = np.ptp(outline, axis=0)
    return [
        *(Dimension(part, name, length, "mm") for name, length in lines.items()),
        Dimension(part, "width", float(width), "mm"),
        Dimension(part, "height", float(height), "mm"),
        Dimension(part, "area", area / 100, "cm2"),
    ]


def _of_cup(shape: CupShape, apex: Float[ndarray, "3"], strap_point: Float[ndarray, "3"] | None) -> list[Dimension]:
    edges = shape.edges.detach().cpu().double().numpy()
    inner, outer = edges[0, 0], edges[0, -1]
    places = {
        "inner end": inner,
        "outer end": outer,
        "bottom of the wire": edges[0, edges[0, :, 0].argmax()],
        "nearest point of the upper edge": edges[-1, np.linalg.norm(edges[-1] - apex, axis=1).argmin()],
    }
    if strap_point is not None:
        places["strap point"] = strap_point
    return [
        Dimension("cup", "wire span (end to end)", float(np.linalg.norm(outer - inner)), "mm"),
        Dimension("cup", "depth (out of the wire's plane)", float(edges[..., 2].max()), "mm"),
        *(Dimension("cup", f"apex to {name}", float(np.linalg.norm(p - apex)), "mm") for name, p in places.items()),
    ]
