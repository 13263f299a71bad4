"""The figures of a finished cup, measured from its output edges rather than from the model's own derivatives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from brafit.cup.base import Cup
from brafit.cup.edge_gaps import gaps_to_points, nearest_on_polyline, polyline_points
from brafit.cup.names import edge_names, panel_names
from brafit.cup.shape import CupShape
from brafit.fitting.targets import Target
from brafit.geometry.developable import dot, twist_angle
from brafit.geometry.development import FlatPanel, arc_lengths
from brafit.geometry.fairness import EdgeCurvature
from brafit.geometry.grid import sliding_derivative

TWIST_LIMIT = 0.01
"""Largest twist, in degrees, of panels that are to be developable."""
REFINEMENTS = 2
"""How often the grid of the output is refined where panels twist more."""
_ENDS = 0.02
"""Share of the stations at either end where panels shrink to cusps and a ruling's twist means nothing."""


@dataclass(frozen=True)
class Measured:
    """One cup: shape in mm, flat panels, distances and figures."""

    shape: CupShape
    panels: list[FlatPanel]
    distances: Tensor
    figures: dict[str, float]


@torch.no_grad()
def measured_cups(cup: Cup, targets: Sequence[Target], refinements: int = REFINEMENTS) -> list[Measured]:
    """The cups of a batch; those whose panels are to be developable and are not yet, on finer grids.

    Args:
        cup: one cup for each target.
        targets: the scans.
        refinements: how often the grid of the output may yet be refined.
    """
    wire, flat = cup.wire, cup.flatten()
    units = cup.shape_of(flat)
    points = [torch.as_tensor(t.points, dtype=torch.float64) / s for t, s in zip(targets, wire.scale, strict=True)]
    distances = units.distances(pad_sequence(points, batch_first=True), coarse=cup.sketch(flat))
    distances = distances * wire.scale[:, None]
    smooth = wire.sample(wire_places(units.stations))
    results = []
    for k, target in enumerate(targets):
        scale = wire.scale[k].item()
        shape = in_millimetres(units.map(partial(torch.select, dim=0, index=k)), scale)
        flat, own = shape.flat(), distances[k, : len(target.points)]
        neckline = None if target.neckline is None else torch.as_tensor(target.neckline, dtype=torch.float64)
        figures = figures_of(shape, flat, own, neckline, smooth[k] * scale, wire.smoothing[k].item())
        figures["seam_to_apex_mm"] = seam_to_apex(shape, target.bust_point)
        panels = [FlatPanel(*edges) for edges in zip(flat.lower, flat.upper, strict=True)]
        results.append(Measured(shape, panels, own, figures))
    twisted = [k for k, one in enumerate(results) if not one.figures["twist_deg_max"] <= TWIST_LIMIT]
    if cup.developable and twisted and refinements:
        finer = cup.select(torch.tensor(twisted)).refined()
        for k, one in zip(twisted, measured_cups(finer, [targets[k] for k in twisted], refinements - 1), strict=True):
            results[k] = one
    return results


def in_millimetres(shape: CupShape, scale: float) -> CupShape:
    """A shape in solver units, in millimetres, on the CPU in double precision. Tangents are by the wire's arc length
    and keep their size.

    Args:
        shape: one cup, solver units.
        scale: millimetres to a solver unit.
    """
    own = shape.map(lambda value: value.cpu().double())
    return replace(
        own, stations=shape.stations.cpu().double() * scale, edges=own.edges * scale, geodesic=own.geodesic / scale
    )


def figures_of(
    shape: CupShape,
    flat: FlatPanel,
    distances: Float[Tensor, " n"],
    neckline: Float[Tensor, "m 3"] | None,
    wire: Float[Tensor, "k 3"],
    smoothing: float,
) -> dict[str, float]:
    """The measured figures of one cup in millimetres, degrees and ratios, by their names in `fit.json`.

    Args:
        shape: one cup (no batch dimension), mm.
        flat: its panels laid flat.
        distances: from `CupShape.distances`.
        neckline: the wanted upper edge; `upper_edge_mm` is nan without it.
        wire: the smooth wire at `wire_places` of the cup's stations.
        smoothing: distance of the given wire points from it.
    """
    stations, edges = shape.stations, shape.edges
    size = distances.abs()
    tangents = sliding_derivative(edges, stations)
    margin = math.ceil(_ENDS * (stations.shape[0] - 1))
    inner = slice(margin, -margin)
    lower, upper, ruling = tangents[:-1, inner], tangents[1:, inner], shape.directions[:, inner]
    twist = torch.rad2deg(twist_angle(lower, upper, ruling)).max()
    lengths = arc_lengths(edges, stations)[:, -1]
    flat_lower, flat_upper = arc_lengths(flat.lower, stations)[:, -1], arc_lengths(flat.upper, stations)[:, -1]
    flat_rulings = (flat.upper - flat.lower).norm(dim=-1)
    changes = (
        (flat_lower - lengths[:-1]).abs(),
        (flat_upper - lengths[1:]).abs(),
        (flat_rulings - shape.lengths).abs(),
    )
    seams = (flat_upper[:-1] - flat_lower[1:]).abs()
    return {
        "rms_mm": size.square().mean().sqrt().item(),
        "mean_mm": size.mean().item(),
        "p95_mm": torch.quantile(size, 0.95).item()
        if len(size) < 2**24
        else size.sort().values[-len(size) // 20].item(),
        "max_mm": size.max().item(),
        "upper_edge_mm": math.nan if neckline is None else upper_edge_gap(edges[-1], neckline),
        "wire_length_mm": lengths[0].item(),
        "wire_smoothing_mm": smoothing,
        "wire_drift_mm": (_between(shape) - wire).norm(dim=-1).max().item(),
        "twist_deg_max": twist.item(),
        "regularity_min": shape.margin.min().item(),
        "isometry_mm": max(c.max().item() for c in changes),
        "seam_mismatch_mm": seams.max().item() if len(seams) else 0.0,
    }


def wire_places(stations: Float[Tensor, " n"]) -> Float[Tensor, " 2*n-1"]:
    """Stations, then the middles between them: where the cup's wire edge is compared with the wire."""
    return torch.cat((stations, 0.5 * (stations[:-1] + stations[1:])))


def _distance(points: Tensor, line: Tensor) -> Tensor:
    segment, place = nearest_on_polyline(points[None], line[None])
    delta = points - polyline_points(line[None], segment, place)[0]
    return dot(delta, delta).sqrt()


def upper_edge_gap(edge: Tensor, neckline: Tensor) -> float:
    """Mean distance between upper edge and neckline, both ways: of the given one the figure `upper_edge_mm`, of the
    smoothed one what `condition.neckline_limit` bounds."""
    return 0.5 * (_distance(edge, neckline).mean() + _distance(neckline, edge).mean()).item()


def seam_to_apex(shape: CupShape, apex: Float[np.ndarray, "3"]) -> float:
    """Distance of the nearest ridge from the bust point, mm; nan for a cup of one panel.

    Args:
        shape: one cup, mm.
        apex: the bust point.
    """
    if shape.panels < 2:
        return math.nan
    one, asked = shape.map(lambda value: value[None]), torch.as_tensor(apex, dtype=shape.edges.dtype)[None, None]
    return min(gaps_to_points(one, ridge, asked).vectors.norm().item() for ridge in range(1, shape.panels))


def _between(shape: CupShape) -> Tensor:
    """The cup's wire edge at `wire_places`, as its consumers interpolate it."""
    x, v, h = shape.edges[0], shape.tangents[0], shape.stations.diff()[:, None]
    middle = 0.5 * (x[:-1] + x[1:]) + h / 8 * (v[:-1] - v[1:])
    return torch.cat((x, middle))


@dataclass(frozen=True)
class Bend:
    """The tightest bend of a flat edge, the ends and the strap's corner apart.

    Attributes:
        edge, edges: which of how many, 0 at the wire.
        panel: in which panel, from the wire up.
        radius, arc: its radius and its distance from the edge's inner end, mm.
    """

    edge: int
    panel: int
    edges: int
    radius: float
    arc: float

    def __str__(self) -> str:
        """In the words that stand on the pieces."""
        panels = self.edges - 1
        edge, panel = edge_names(panels)[self.edge], panel_names(panels)[self.panel]
        edge, panel = (name if name[-1].isdigit() else f"the {name}" for name in (edge, panel))
        edge += " edge" * (self.edge == 0)
        return f"{edge} bends with a radius of {self.radius:.1f} mm, {self.arc:.0f} mm from centre front, on {panel}"


def tight_bends(shape: CupShape, panels: Sequence[FlatPanel], strap_point: Float[np.ndarray, "3"] | None) -> list[Bend]:
    """The tightest bend of both edges of every flat panel.

    Args:
        shape: one cup, mm.
        panels: its panels laid flat, mm.
        strap_point: where the upper edge has its corner, which is no bend; None: nowhere.
    """
    bends = []
    for i, panel in enumerate(panels):
        for edge, curve in ((i, panel.lower.numpy()), (i + 1, panel.upper.numpy())):
            corner = None
            if edge == len(panels) and strap_point is not None:
                corner = curve[(shape.edges[-1] - torch.as_tensor(strap_point)).norm(dim=-1).argmin()]
            radius, arc = EdgeCurvature.of(curve, corner).tightest()
            bends.append(Bend(edge, i, len(panels) + 1, radius, arc))
    return bends
