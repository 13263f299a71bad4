"""Finished dimensions: what a pattern engineer checks a cup by, from the fitted cup and its finished pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.pattern.finish import Pattern


@dataclass(frozen=True)
class Dimension:
    """One measure: what it belongs to, its name, its value and unit (`mm` or `cm2`)."""

    part: str
    name: str
    value: float
    unit: str


def dimensions(
    shape: CupShape,
    pattern: Pattern,
    apex: Float[ndarray, "3"],
    strap_point: Float[ndarray, "3"] | None = None,
) -> list[Dimension]:
    """Edges, widths and areas of the pieces; depth and apex distances (straight) of the cup.

    Args:
        shape: the cup, cup frame, mm, no batch dimension.
        pattern: its finished pieces; with ease, their lengths are those to cut, not those worn.
        apex: bust point, cup frame.
    """
    table = []
    for piece in pattern.pieces:
        table += [Dimension(piece.name, line.name, line.length, "mm") for line in piece.sew]
        outline = piece.sew_outline()
        width, height = np.ptp(outline, axis=0)
        table.append(Dimension(piece.name, "width", float(width), "mm"))
        table.append(Dimension(piece.name, "height", float(height), "mm"))
        table.append(Dimension(piece.name, "area", piece.area / 100, "cm2"))
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
    table.append(Dimension("cup", "wire span (end to end)", float(np.linalg.norm(outer - inner)), "mm"))
    table.append(Dimension("cup", "depth (out of the wire's plane)", float(edges[..., 2].max()), "mm"))
    for name, place in places.items():
        table.append(Dimension("cup", f"apex to {name}", float(np.linalg.norm(place - apex)), "mm"))
    table.append(Dimension("cup", "area of all panels", sum(piece.area for piece in pattern.pieces) / 100, "cm2"))
    return table
