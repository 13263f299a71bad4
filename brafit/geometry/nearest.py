"""Nearest point on a chain of ruled panels, (26)-(31) and (56)-(58) of docs/formulation.md.

Panel i is X(s, u) = (1 - u) a(s) + u b(s) with u = t / t_max in [0, 1], see `brafit.geometry.panels`. The nearest
ruling of each panel is found among the stations, then (s, u) is refined to the foot point by a safeguarded Newton
iteration in s, u being eliminated in closed form (30): `brafit.geometry.foot`.

At a foot the derivative of the distance through (s*, u*) vanishes (envelope theorem), so the search runs without
gradients and the distance is differentiated through the surface point at fixed (s*, u*) only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.developable import dot, unit
from brafit.geometry.foot import Tables, descended, inner, refined
from brafit.geometry.hermite import Series, columns, cubics
from brafit.geometry.panels import Edges, Feet, Points, surface_normals, surface_points

CHUNK = 1 << 17
"""Distances held at a time in the search, over the whole batch: bounds the memory for any number of points, and fits
caches.
"""
DEVICE = 1 << 9
"""Factor on CHUNK for devices other than the processor, whose time depends on the number of calls."""
Found = Float[Tensor, "10 _"]
"""Feet as `refined` gives them: interval, tau, u, squared distance, difference vector, surface normal."""


def chunk_of(like: Tensor) -> int:
    """Distances held at a time on a tensor's device."""
    return CHUNK if like.device.type == "cpu" else CHUNK * DEVICE


@torch.no_grad()
def sampled_distances(
    points: Points, edges: Edges
) -> tuple[Int[Tensor, "panels *batch points"], Float[Tensor, "panels *batch points"]]:
    """Nearest sampled ruling of every panel, by the closed-form distance to the segments, and the squared distances
    to them.

    Args:
        points: in the unit of the edges; finite.
        edges: positions of all edges at the stations, from the wire up.
    """
    batch, (panels, n) = points.shape[:-2], (edges.shape[-3] - 1, edges.shape[-2])
    # Single precision tells which ruling is nearest; where it cannot, either will do.
    p = points.reshape(math.prod(batch), points.shape[-2], 3).float()
    lower = edges[..., :-1, :, :].reshape(len(p), -1, 3).float()
    ruling = edges[..., 1:, :, :].reshape(len(p), -1, 3).float() - lower
    length = ruling.norm(dim=-1).clamp_min(1e-30)
    d = ruling / length[..., None]
    offset = dot(lower, d)
    square = dot(lower, lower)
    nearest = torch.empty(panels, len(p), p.shape[1], dtype=torch.long, device=p.device)
    least = torch.empty(panels, len(p), p.shape[1], dtype=p.dtype, device=p.device)
    chunk = max(1, chunk_of(p) // max(1, len(p) * panels * n))
    for start in range(0, p.shape[1], chunk):
        q = p[:, start : start + chunk]
        t = torch.baddbmm(-offset[:, None, :], q, d.mT)
        clamped = torch.minimum(t.clamp_min(0), length[:, None, :])
        # |q - x - t d|^2 without |q|^2, which does not depend on the ruling
        squared = torch.baddbmm(square[:, None, :], q, lower.mT, alpha=-2).addcmul_(clamped, clamped.sub(t, alpha=2))
        found, index = squared.unflatten(-1, (panels, n)).min(-1)
        nearest[..., start : start + chunk] = index.movedim(-1, 0)
        least[..., start : start + chunk] = found.movedim(-1, 0)
    least += dot(p, p)
    return nearest.reshape(panels, *batch, -1), least.to(points).reshape(panels, *batch, -1)


@dataclass(frozen=True)
class Projection:
    """Points projected on a cup: their feet, the unit vectors m and the signed distances m . (p - X*), positive
    outside.

    Where the foot lies inside a panel, m is the surface normal; at the rim it is the difference vector's own direction.
    """

    feet: Feet
    directions: Points
    distances: Float[Tensor, "*batch points"]


@torch.no_grad()
def project(
    points: Points,
    edges: Edges,
    tangents: Edges,
    stations: Float[Tensor, " n"],
    iterations: int = 6,
    near: Feet | None = None,
) -> Projection:
    """The nearest point of the whole cup for every point.

    Beside the nearest sampled ruling of the panel that is nearest by its samples, the foot is refined by Newton's
    method with bisection as a safeguard; so it is in those other panels that could still be nearer. The number of
    iterations is fixed, so that a point's foot does not depend on what else is in the batch.

    Args:
        points: in the unit of the edges; finite.
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        iterations: Newton steps within an interval; six are exact to rounding from a search, fewer do beside `near`.
        near: feet on a cup that differs little: they are followed instead of a search, over stations and ridges. A
            foot that would have to leap to another part of the cup is missed.
    """
    batch, count = points.shape[:-2], points.shape[-2]
    cup = _Chain.of(points, edges, tangents, stations, iterations)
    found, panel, again = cup.searched(points) if near is None else cup.followed(near)
    for other, index, crossed in again:
        # On a ridge both panels are as near: the lower one takes the point, whatever the rounding.
        tie = 1e-9 * found[3, index]
        better = torch.where(
            other < panel[index], crossed[3] <= found[3, index] + tie, crossed[3] < found[3, index] - tie
        )
        index = index[better]
        found[:, index] = crossed[:, better]
        panel = panel.index_put((index,), other[better])
    interval, tau, u, squared = found[:4]
    delta, normal = found[4:7], found[7:10]
    size = squared.sqrt()
    along = inner(delta, normal)
    on_surface = (along.abs() >= size * (1 - 1e-6)) | (size < 1e-12)
    sign = torch.where(along < 0, -1.0, 1.0).to(found.dtype)
    away = delta * (sign / size.clamp_min(1e-30))
    directions = torch.where(on_surface, normal, away).mT.reshape(*batch, count, 3)
    distances = torch.where(on_surface, along, sign * size).reshape(*batch, count)
    feet = (panel, interval.long(), tau, u)
    return Projection(Feet(*(w.reshape(*batch, count) for w in feet)), directions, distances)


Crossings = list[tuple[Tensor, Tensor, Found]]
"""Feet of some points in other panels: the panels, the points' indices, the feet."""


@dataclass(frozen=True)
class _Chain:
    """Points of all problems, one after another, and the panels that they are projected on.

    Attributes:
        components: the points, components first.
        problem: for each point the number of its problem's first panel.
        edges: of all problems.
        tables: what refinement gathers.
        iterations: Newton steps.
    """

    components: Float[Tensor, "3 all"]
    problem: Int[Tensor, " all"]
    edges: Float[Tensor, "problems edges n 3"]
    tables: Tables
    iterations: int

    @staticmethod
    def of(points: Points, edges: Edges, tangents: Edges, stations: Tensor, iterations: int) -> "_Chain":
        panels, n = edges.shape[-3] - 1, edges.shape[-2]
        x, v = edges.reshape(-1, panels + 1, n, 3), tangents.reshape(-1, panels + 1, n, 3)
        problem = torch.arange(len(x), device=points.device).repeat_interleave(points.shape[-2]) * panels
        return _Chain(points.reshape(-1, 3).mT.contiguous(), problem, x, Tables.of(x, v, stations), iterations)

    @property
    def panels(self) -> int:
        return self.edges.shape[1] - 1

    def refine(self, index: Tensor | None, panel: Tensor, interval: Tensor, tau: Tensor | None) -> Found:
        """The feet of the points with these indices (None: of all) in these panels."""
        chosen = self.components if index is None else columns(self.components, index)
        row = panel + (self.problem if index is None else self.problem.index_select(0, index))
        parts = []
        size = max(1, chunk_of(self.components) // 16)
        for first in range(0, len(row), size):
            part = slice(first, first + size)
            place = None if tau is None else tau[part]
            parts.append(refined(chosen[:, part], row[part], interval[part], place, self.tables, self.iterations))
        return torch.cat(parts, dim=1) if parts else self.components.new_zeros(10, 0)

    def searched(self, points: Points) -> tuple[Found, Tensor, Crossings]:
        """Feet in the panels that are nearest by their samples, these panels, and feet in others that may be nearer."""
        start, bound = _starts(points, self.edges, self.panels)
        panel = bound.min(0).indices
        found = self.refine(None, panel, start.gather(0, panel[None])[0], None)
        nearer = (bound < found[3]).scatter_(0, panel[None], False)
        other, index = nearer.nonzero().unbind(1)
        crossed, counts = self.refine(index, other, start[other, index], None), nearer.sum(1).tolist()
        again = list(zip(other.split(counts), index.split(counts), crossed.split(counts, dim=1), strict=True))
        return found, panel, again

    def followed(self, near: Feet) -> tuple[Found, Tensor, Crossings]:
        """Feet near given ones, their panels, and feet beyond the ridge of those that came to rest on one."""
        panel, interval, tau = near.panel.reshape(-1), near.interval.reshape(-1), near.tau.reshape(-1)
        found = self.refine(None, panel, interval, tau)
        # A foot that came to rest on a ridge may go on beyond it.
        beyond = panel + (found[2] == 1).long() - (found[2] == 0).long()
        index = ((beyond != panel) & (beyond >= 0) & (beyond < self.panels)).nonzero()[:, 0]
        other = beyond[index]
        return found, panel, [(other, index, self.refine(index, other, found[0, index].long(), found[1, index]))]


def _starts(
    points: Points, edges: Float[Tensor, "problems edges n 3"], panels: int
) -> tuple[Int[Tensor, "panels all"], Float[Tensor, "panels all"]]:
    """Nearest sampled ruling of every panel, and a squared distance below which the panel does not come."""
    start, least = sampled_distances(points.reshape(len(edges), -1, 3), edges)
    # A foot lies at most half the way to the next sampled ruling aside.
    step = edges.diff(dim=2)
    step = dot(step, step)
    step = torch.maximum(torch.nn.functional.pad(step, (1, 0)), torch.nn.functional.pad(step, (0, 1)))
    slack = 0.5 * torch.maximum(step[:, :-1], step[:, 1:]).movedim(1, 0).gather(-1, start)
    return start.reshape(panels, -1), (least - slack).reshape(panels, -1)


@torch.no_grad()
def nearest_on_curve(
    points: Points,
    curve: Float[Tensor, "*batch n 3"],
    tangents: Float[Tensor, "*batch n 3"],
    stations: Float[Tensor, " n"],
    iterations: int = 4,
) -> tuple[Int[Tensor, "*batch points"], Float[Tensor, "*batch points"]]:
    """Interval and place in it, in [0, 1], of the nearest points of a cubic Hermite curve.

    Args:
        points: in the unit of the curve.
        curve: positions at the stations.
        tangents: derivatives by s.
        stations: s of the samples, increasing.
        iterations: Newton steps within an interval.
    """
    batch, n = points.shape[:-2], curve.shape[-2]
    away = torch.baddbmm(
        dot(curve, curve).reshape(-1, 1, n),
        points.reshape(-1, *points.shape[-2:]),
        curve.reshape(-1, n, 3).mT,
        alpha=-2,
    )
    start = away.argmin(-1).reshape(-1)
    p, problem = points.reshape(-1, 3).mT, torch.arange(math.prod(batch), device=points.device)
    problem = problem.repeat_interleave(points.shape[-2])
    x, v = (w.reshape(-1, 3).index_select(0, problem * n + start).mT for w in (curve, tangents))
    back = ((start > 0) & (inner(p - x, v) < 0)) | (start == n - 1)
    interval, tau = start - back.long(), back.to(p.dtype)
    table = cubics(curve, tangents, stations).reshape(-1, 12)
    series = Series.of(columns(table.mT.contiguous(), problem * (n - 1) + interval).view(4, 3, -1))

    def descent(tau: Tensor) -> tuple[Tensor, Tensor]:
        delta, along = p - series.value(tau), series.slope(tau)
        return -inner(delta, along), inner(along, along) - inner(delta, series.bend(tau))

    tau = descended(descent, tau, iterations)
    return interval.reshape(*batch, -1), tau.reshape(*batch, -1)


def nearest_feet(
    points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], iterations: int = 6
) -> Feet:
    """The nearest point of the whole cup for every point, exact to round-off.

    Args:
        points: in the unit of the edges; finite.
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        iterations: Newton steps within an interval.
    """
    return project(points, edges, tangents, stations, iterations).feet


@torch.no_grad()
def foot_directions(points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """Unit vectors m such that m . (p - X*) is the signed distance, positive outside the cup.

    Where the foot lies inside a panel that is the surface normal; at the rim it is the difference vector's own
    direction.

    Args:
        points: in the unit of the edges.
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        feet: of these points on these edges.
    """
    delta = points - surface_points(edges, tangents, stations, feet)
    normal = surface_normals(edges, tangents, stations, feet)
    along, size = dot(delta, normal), delta.norm(dim=-1)
    sign = torch.where(along < 0, -1.0, 1.0).to(points.dtype)
    on_surface = (along.abs() >= size * (1 - 1e-6)) | (size < 1e-12)
    return torch.where(on_surface[..., None], normal, sign[..., None] * unit(delta))


def signed_distance(
    points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet
) -> Float[Tensor, "*batch points"]:
    """Distance of points to their feet, positive outside the cup, with the envelope theorem's gradients.

    Args:
        points: in the unit of the edges.
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        feet: of these points on these edges, from `nearest_feet`.
    """
    direction = foot_directions(points, edges.detach(), tangents.detach(), stations, feet)
    return dot(points - surface_points(edges, tangents, stations, feet), direction)
