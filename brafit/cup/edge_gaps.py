"""Gaps between a cup's edges and given points or lines, which a fit drives to zero: (60) of docs/formulation.md."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.cup.shape import CupShape
from brafit.geometry.developable import dot, unit
from brafit.geometry.hermite import hermite, hermite_slope
from brafit.geometry.moving import slid
from brafit.geometry.nearest import nearest_on_curve
from brafit.geometry.panels import gather_rows, weighted

Points = Float[Tensor, "batch m 3"]


@torch.no_grad()
def nearest_on_polyline(
    points: Points, line: Float[Tensor, "batch k 3"]
) -> tuple[Int[Tensor, "batch m"], Float[Tensor, "batch m"]]:
    """Nearest segment of a polyline and the place on it in [0, 1], for every point.

    Args:
        points: any number a batch item.
        line: corners of the polyline; repeated ones do no harm.
    """
    start, step = line[:, :-1], line[:, 1:] - line[:, :-1]
    square = dot(step, step).clamp_min(1e-30)[:, None]
    # (p - start) . step and |p - start|^2 without |p|^2, which does not depend on the segment
    along = torch.baddbmm(-dot(start, step)[:, None], points, step.mT)
    away = torch.baddbmm(dot(start, start)[:, None], points, start.mT, alpha=-2)
    place = (along / square).clamp(0, 1)
    segment = away.addcmul_(place, place * square - 2 * along).argmin(-1, keepdim=True)
    return segment[..., 0], place.gather(-1, segment)[..., 0]


def polyline_points(line: Float[Tensor, "batch k 3"], segment: Tensor, place: Tensor) -> Points:
    """Points of a polyline by segment and place."""
    index = segment[..., None].expand(*segment.shape, 3)
    return torch.lerp(line.gather(1, index), line.gather(1, index + 1), place[..., None])


@dataclass(frozen=True)
class Gaps:
    """Difference vectors between a cup's edges and fixed points, and how they depend on the samples of the cup.

    A gap is the part across `sliding` of (weighted sum of samples - fixed point): where the nearest point lies inside
    a line it may slide along it, and only the component across counts, which has the same length and the envelope
    theorem's gradient.

    Attributes:
        vectors: the gaps, differentiable in the samples.
        index: rows of `brafit.geometry.panels.sample_table`.
        weight: their weights.
        sliding: unit vectors, or 0 where nothing slides.
        own: derivatives of the gaps by the parameters on which the weights depend, the last ones of all; None: there
            are none.
    """

    vectors: Points
    index: Int[Tensor, "batch m k"]
    weight: Float[Tensor, "batch m k"]
    sliding: Points
    own: Float[Tensor, "batch m 3 last"] | None = None

    def part(self, which: slice) -> "Gaps":
        """Some of the gaps."""
        own = None if self.own is None else self.own[:, which]
        return Gaps(self.vectors[:, which], self.index[:, which], self.weight[:, which], self.sliding[:, which], own)

    def columns(
        self, table: Float[Tensor, "batch rows 3 columns"], last: int | None = None
    ) -> Float[Tensor, "batch m 3 columns"]:
        """Derivatives of the gaps from those of the samples. `last`: how many of the parameters of `own`, the last
        ones, are among the table's columns; None: all.
        """
        batch, rows = table.shape[:2]
        offset = torch.arange(batch, device=table.device)[:, None, None] * rows
        index, weight = (self.index + offset).flatten(0, 1), self.weight.flatten(0, 1)
        moved = torch.nn.functional.embedding_bag(
            index, table.reshape(batch * rows, -1), mode="sum", per_sample_weights=weight
        )
        moved = moved.view(batch, -1, *table.shape[2:])
        if self.own is not None:
            last = self.own.shape[-1] if last is None else last
            moved[..., -last:] += self.own[..., -last:]
        sliding = self.sliding[..., None]
        (x, y, z), (a, b, c) = moved.unbind(-2), sliding.unbind(-2)
        along = torch.addcmul(torch.addcmul(x * a, y, b), z, c)[..., None, :]
        return moved.addcmul_(along, sliding, value=-1)


def gaps_to_line(shape: CupShape, edge: int, line: Float[Tensor, "batch k 3"]) -> Gaps:
    """From a polyline to every sample of an edge.

    Args:
        shape: the cups.
        edge: which edge, 0 the wire, -1 the upper edge.
        line: a polyline for each cup, in the unit of the shape.
    """
    points = shape.edges[:, edge]
    with torch.no_grad():
        segment, place = nearest_on_polyline(points, line)
        n = points.shape[1]
        rows = (torch.arange(n, device=points.device) + edge % shape.edges.shape[1] * n).expand(len(points), -1)
    index = segment[..., None].expand(*segment.shape, 3)
    along = unit(line.gather(1, index + 1) - line.gather(1, index))
    sliding = ((place > 0) & (place < 1))[..., None] * along
    offset = points - polyline_points(line, segment, place)
    return Gaps(
        vectors=offset - dot(offset, sliding)[..., None] * sliding,
        index=rows[..., None],
        weight=torch.ones_like(points[..., :1]),
        sliding=sliding,
    )


def gaps_to_sheet(shape: CupShape, edge: int, sheet: Points, normals: Points) -> Gaps:
    """From the nearest of a surface's points to every sample of an edge, across the surface's normal there: what is
    left where the edge has gone beyond the surface's end.

    Args:
        shape: the cups.
        edge: which edge, 0 the wire, -1 the upper edge.
        sheet: points of a surface for each cup, in the unit of the shape.
        normals: unit normals at these points, to either side.
    """
    points = shape.edges[:, edge]
    with torch.no_grad():
        # |x - p|^2 without |x|^2, which does not depend on the point
        away = torch.baddbmm(dot(sheet, sheet)[:, None], points, sheet.mT, alpha=-2)
        index = away.argmin(-1)[..., None].expand(-1, -1, 3)
        n = points.shape[1]
        rows = (torch.arange(n, device=points.device) + edge % shape.edges.shape[1] * n).expand(len(points), -1)
    feet, sliding = sheet.gather(1, index), normals.gather(1, index)
    offset = points - feet
    vectors = offset - dot(offset, sliding)[..., None] * sliding
    return Gaps(vectors, rows[..., None], torch.ones_like(points[..., :1]), sliding)


def gaps_to_points(shape: CupShape, edge: int, points: Points, moving: bool = False) -> Gaps:
    """From given points to the nearest points of an edge, a cubic Hermite curve between its stations.

    With `moving`, the nearest points move along the edge as it and the points do: the gaps' squared lengths, whose
    first derivatives are right anyhow, are so in their second ones as well.

    Args:
        shape: the cups.
        edge: which edge, 0 the wire, -1 the upper edge.
        points: for each cup, in the unit of the shape.
        moving: whether second derivatives are wanted.
    """
    line, tangents, stations = shape.edges[:, edge], shape.tangents[:, edge], shape.stations
    n = line.shape[1]
    own = torch.cat((line, tangents), dim=1)
    with torch.no_grad():
        segment, tau = nearest_on_curve(points, line.detach(), tangents.detach(), stations)
        h = stations[segment + 1] - stations[segment]
        index = torch.stack((segment, segment + 1, segment + n, segment + n + 1), dim=-1)
        weight = hermite(tau, h)
    samples = gather_rows(own, index)
    with torch.no_grad():
        end = ((segment == 0) & (tau == 0)) | ((segment == n - 2) & (tau == 1))
        sliding = torch.where(end[..., None], 0.0, unit(weighted(hermite_slope(tau, h), samples)))
    if moving:
        vectors = weighted(hermite(slid(points, samples, tau, h, ~end), h), samples) - points
    else:
        offset = weighted(weight, samples) - points
        vectors = offset - dot(offset, sliding)[..., None] * sliding
    edges = shape.edges.shape[1]
    first = edge % edges * n
    shift = torch.tensor([first, first, first + (edges - 1) * n, first + (edges - 1) * n], device=index.device)
    return Gaps(vectors, index + shift, weight, sliding)
