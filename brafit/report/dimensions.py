"""Finished dimensions: what a pattern engineer checks a cup by, from the fitted cup and its finished pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.names import edge_names, panel_names
from brafit.fitting.certainty import outline_deviations
from brafit.fitting.result import Survey
from brafit.pattern.finish import Pattern
from brafit.report.measures import BustPoints, Cups, Fitted, over_surface
from brafit.underwires.nearest import wanted_wire

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


CUP, SURFACE = "cup", "over the surface"
"""The parts of the measures of the cup through the air, and of those that a tape takes on it."""
DEPTH = "depth of the cup (out of the wire's plane)"
"""Its dimension that the report has at its head."""
PANELS_AREA = "area of all panels"
"""Its one dimension that is of the pieces."""
MARKS = "bust point mark to strap point mark, through the air"
"""Its one dimension that is of the scan's marks: the cup may pass beside them."""


def measured_on(part: str, name: str) -> str:
    """`as cut` for a dimension of the pieces, `as worn` for one of the cup: ease and stretch make the two differ.

    Args:
        part: of the dimension.
        name: likewise.
    """
    return "as worn" if part in (CUP, SURFACE) and name != PANELS_AREA else "as cut"


def dimensions(
    fit: Fitted,
    pattern: Pattern,
    apex: Float[ndarray, "3"],
    strap_point: Float[ndarray, "3"] | None = None,
    survey: Survey | None = None,
) -> list[Dimension]:
    """Edges, widths and areas of the pieces; depth of the cup and distances from the bust point through the air;
    measures over its surface.

    Args:
        fit: the cup, cup frame, mm, no batch dimension, and its flat panels.
        pattern: its finished pieces; with ease, their lengths are those to cut, not those worn.
        apex: bust point as marked, cup frame.
        strap_point: cup frame, mm; None: there is none, and no distance from it.
        survey: of the cup and its alternatives; None: it is made, of the cup alone.
    """
    known = survey_of(fit, [], apex, strap_point) if survey is None else survey
    found: dict[Key, float] = {}
    for piece in pattern.pieces:
        found |= {(piece.name, line.name): line.length for line in piece.sew}
        width, height = np.ptp(piece.sew_outline(0.001), axis=0)
        found |= {(piece.name, "width"): width, (piece.name, "height"): height, (piece.name, "area"): piece.area / 100}
    found |= {(CUP, name): value for name, value in known.through_air.items()}
    if strap_point is not None:
        found[CUP, MARKS] = float(np.linalg.norm(strap_point - apex))
    found[CUP, PANELS_AREA] = sum(piece.area for piece in pattern.pieces) / 100
    wire = pattern.options.wire
    if wire["play"] or wire["spring"]:
        length, span = wanted_wire(_numbers(fit.shape.edges[0]), wire["play"], wire["spring"])
        found |= {(CUP, "wire wanted, length"): length, (CUP, "wire wanted, end to end when not worn"): span}
    found |= {(SURFACE, name): value for name, value in known.taped.items()}
    return [
        Dimension(
            part, name, float(value), "cm2" if name.startswith("area") else "mm", known.deviation.get((part, name))
        )
        for (part, name), value in found.items()
    ]


def survey_of(
    fit: Fitted,
    alternatives: Sequence[Fitted],
    apex: Float[ndarray, "3"],
    strap_point: Float[ndarray, "3"] | None = None,
) -> Survey:
    """`surveys` of one fit.

    Args:
        fit: the cup.
        alternatives: cups a standard deviation away, in all directions that are kept (`brafit.fitting.certainty`).
        apex: bust point, cup frame, mm.
        strap_point: cup frame, mm, or None.
    """
    strap = None if strap_point is None else strap_point[None]
    return surveys(Cups.of([[fit, *alternatives]]), apex[None], strap)[0]


def surveys(
    cups: Cups,
    apex: Float[ndarray, "fits 3"],
    strap_point: Float[ndarray, "fits 3"] | None = None,
    outlines: bool = False,
) -> list[Survey]:
    """Measures of each fit's own cup, through the air and over its surface, and standard deviations of every dimension
    of pieces and cup, before ease and stretch.

    Args:
        cups: each fit's own, then its alternatives.
        apex: bust points, cup frame, mm.
        strap_point: cup frame, mm, or None.
        outlines: whether those of the outlines are wanted too.
    """
    bust = BustPoints.of(cups, apex)
    taped, over = over_surface(cups, bust, strap_point)
    straight = _of_cup(_numbers(cups.edges), bust.places.reshape(*cups.edges.shape[:2], 3))
    pieces = piece_dimensions(cups)
    varied = {(CUP, name): value for name, value in straight.items()} | pieces
    varied[CUP, PANELS_AREA] = np.sum([value for (_, name), value in pieces.items() if name == "area"], axis=0)
    varied |= {(SURFACE, name): values for name, values in over.items()}
    several = cups.edges.shape[1] > 1
    spread = {
        key: np.sqrt(np.sum((values[:, 1:] - values[:, :1]) ** 2, axis=1)) for key, values in varied.items() if several
    }
    bands = outline_deviations(cups.flat) if outlines and several else [[] for _ in apex]
    return [
        Survey(
            {name: float(values[k]) for name, values in taped.items() if np.isfinite(values[k])},
            {name: float(values[k, 0]) for name, values in straight.items()},
            {key: float(values[k]) for key, values in spread.items() if np.isfinite(values[k])},
            bands[k],
        )
        for k in range(len(apex))
    ]


def piece_dimensions(cups: Cups) -> dict[Key, Float[ndarray, "fits each"]]:
    """Edges, widths and heights (mm) and areas (cm2) of the pieces of every cup, before ease and stretch."""
    fits, each, count = cups.flat.shape[:3]
    seams, measured = edge_names(count), {}
    for i, name in enumerate(panel_names(count)):
        sizes = _of_flat(_numbers(cups.flat[:, :, i].flatten(0, 1)))
        own = {seams[i]: sizes.pop("lower"), seams[i + 1]: sizes.pop("upper"), **sizes}
        measured |= {(name, key): value.reshape(fits, each) for key, value in own.items()}
    return measured


def _numbers(tensor: torch.Tensor) -> ndarray:
    return tensor.detach().cpu().double().numpy()


def _of_flat(edges: Float[ndarray, "cups 2 n 2"]) -> dict[str, Float[ndarray, " cups"]]:
    """Lengths of the lower and the upper edge of flat panels, and their width, height and area as pieces lie."""
    start, chord = edges[:, :1, :1], edges[:, 0, -1] - edges[:, 0, 0]
    x = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
    turn = np.stack((x, np.stack((-x[:, 1], x[:, 0]), axis=-1)), axis=-1)
    level = (edges - start) @ turn[:, None]
    lengths = np.linalg.norm(np.diff(level, axis=2), axis=3).sum(2)
    outline = np.concatenate((level[:, 0], level[:, 1, ::-1]), axis=1)
    after = np.roll(outline, -1, axis=1)
    doubled = (outline[..., 0] * after[..., 1] - outline[..., 1] * after[..., 0]).sum(1)
    width, height = np.ptp(outline, axis=1).T
    sizes = {"width": width, "height": height, "area": np.abs(doubled) / 200}
    return {"lower": lengths[:, 0], "upper": lengths[:, 1], **sizes}


def _of_cup(
    edges: Float[ndarray, "*cups e n 3"], bust: Float[ndarray, "*cups 3"]
) -> dict[str, Float[ndarray, "*cups"]]:
    """Span, depth, and distances from the bust point through the air, mm."""
    wire, upper = edges[..., 0, :, :], edges[..., -1, :, :]
    inner, outer = wire[..., 0, :], wire[..., -1, :]
    lowest = wire[..., 0].argmax(-1)[..., None, None]
    places = {
        "inner end": inner,
        "outer end": outer,
        "bottom of the wire": np.take_along_axis(wire, lowest, axis=-2)[..., 0, :],
    }
    straight = {name: np.linalg.norm(place - bust, axis=-1) for name, place in places.items()}
    straight["nearest point of the upper edge"] = np.linalg.norm(upper - bust[..., None, :], axis=-1).min(-1)
    return {
        "wire span (end to end)": np.linalg.norm(outer - inner, axis=-1),
        DEPTH: edges[..., 2].max((-2, -1)),
        **{f"bust point to {name}, through the air": length for name, length in straight.items()},
    }
