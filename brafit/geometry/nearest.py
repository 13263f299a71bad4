"""Nearest point on a chain of ruled panels, (26)-(31).

Panel i is X(s, u) = (1 - u) a(s) + u b(s) with u = t / t_max in [0, 1], a and b its edges, which run between stations as cubic
Hermite curves. The nearest ruling of each panel is found among the stations, then (s, u) is refined to the foot point by a
safeguarded Newton iteration in s, u being eliminated in closed form (30).

At a foot the derivative of the distance through (s*, u*) vanishes (envelope theorem), so the search runs without gradients and the
distance is differentiated through the surface point at fixed (s*, u*) only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.developable import dot, unit

Points = Float[Tensor, "*batch points 3"]
Edges = Float[Tensor, "*batch edges n 3"]
CHUNK = 1 << 18
"""Distances held at a time in the search, over the whole batch: bounds the memory for any number of points."""


@dataclass(frozen=True)
class Feet:
    """Where on the panels the nearest points lie.

    Attributes:
        panel: index of the nearest panel: 0 is the one at the wire.
        interval: index of the interval between stations.
        tau: place in that interval, in [0, 1].
        u: place on the ruling, 0 at the lower edge and 1 at the upper.
    """

    panel: Int[Tensor, "*batch points"]
    interval: Int[Tensor, "*batch points"]
    tau: Float[Tensor, "*batch points"]
    u: Float[Tensor, "*batch points"]

    def arc(self, stations: Float[Tensor, " n"]) -> Float[Tensor, "*batch points"]:
        """Wire arc length s* of the feet."""
        start = stations[self.interval]
        return start + self.tau * (stations[self.interval + 1] - start)


def hermite(tau: Tensor, h: Tensor) -> Tensor:
    """Weights of (x_k, x_k+1, x'_k, x'_k+1) in the cubic Hermite interpolant."""
    t2, t3 = tau * tau, tau * tau * tau
    return torch.stack((2 * t3 - 3 * t2 + 1, 3 * t2 - 2 * t3, h * (t3 - 2 * t2 + tau), h * (t3 - t2)), dim=-1)


def hermite_slope(tau: Tensor, h: Tensor) -> Tensor:
    """Their derivatives by tau."""
    t2 = tau * tau
    return torch.stack((6 * t2 - 6 * tau, 6 * tau - 6 * t2, h * (3 * t2 - 4 * tau + 1), h * (3 * t2 - 2 * tau)), dim=-1)


def stencil(
    feet: Feet, stations: Float[Tensor, " n"], edge_count: int, slope: bool = False
) -> tuple[Int[Tensor, "*batch points 8"], Float[Tensor, "*batch points 8"]]:
    """The surface points as weighted sums of samples: indices into `sample_table` and weights.

    With `slope`, the weights of the derivative dX/dtau instead of X.
    """
    n = stations.shape[0]
    h = stations[feet.interval + 1] - stations[feet.interval]
    weights = (hermite_slope if slope else hermite)(feet.tau, h)
    lower = feet.panel * n + feet.interval
    tangents = edge_count * n
    own = torch.stack((lower, lower + 1, lower + tangents, lower + tangents + 1), dim=-1)
    u = feet.u[..., None]
    return torch.cat((own, own + n), dim=-1), torch.cat(((1 - u) * weights, u * weights), dim=-1)


def sample_table(edges: Edges, tangents: Edges) -> Float[Tensor, "*batch rows 3"]:
    """Positions of all edges' samples, then their tangents: the rows that `stencil` indexes."""
    return torch.cat((edges.flatten(-3, -2), tangents.flatten(-3, -2)), dim=-2)


def gather_rows(table: Float[Tensor, "*batch rows k"], index: Int[Tensor, "*batch p m"]) -> Float[Tensor, "*batch p m k"]:
    """Rows of each batch item's table, for two trailing dimensions of indices."""
    flat = index.flatten(-2)[..., None].expand(*index.shape[:-2], -1, table.shape[-1])
    return table.gather(-2, flat).unflatten(-2, index.shape[-2:])


def surface_points(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """X(s*, u*): differentiable in the edges, with the feet held fixed."""
    index, weight = stencil(feet, stations, edges.shape[-3])
    return (gather_rows(sample_table(edges, tangents), index) * weight[..., None]).sum(-2)


def surface_normals(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """Unit normals X_s x X_u at the feet, outward for a cup: eta = zeta x xi."""
    rows = sample_table(edges, tangents)
    index, slope = stencil(feet, stations, edges.shape[-3], slope=True)
    samples = gather_rows(rows, index)
    along = (samples * slope[..., None]).sum(-2)
    h = stations[feet.interval + 1] - stations[feet.interval]
    bare = hermite(feet.tau, h)[..., None]
    ruling = (samples[..., 4:, :] * bare).sum(-2) - (samples[..., :4, :] * bare).sum(-2)
    return unit(torch.linalg.cross(along, ruling))


@torch.no_grad()
def nearest_stations(points: Points, edges: Edges) -> Int[Tensor, "*batch panels points"]:
    """Index of the nearest sampled ruling of every panel, by the closed-form distance to the segments."""
    batch, (panels, n) = points.shape[:-2], (edges.shape[-3] - 1, edges.shape[-2])
    p = points.reshape(-1, points.shape[-2], 3)
    lower = edges[..., :-1, :, :].reshape(len(p), -1, 3)
    ruling = edges[..., 1:, :, :].reshape(len(p), -1, 3) - lower
    length = ruling.norm(dim=-1).clamp_min(1e-30)
    d = ruling / length[..., None]
    offset = dot(lower, d)
    square = dot(lower, lower)
    nearest = torch.empty(len(p), panels, p.shape[1], dtype=torch.long, device=p.device)
    chunk = max(1, CHUNK // max(1, len(p) * panels * n))
    for start in range(0, p.shape[1], chunk):
        q = p[:, start : start + chunk]
        t = torch.baddbmm(-offset[:, None, :], q, d.mT)
        clamped = torch.minimum(t.clamp_min(0), length[:, None, :])
        # |q - x - t d|^2 without |q|^2, which does not depend on the ruling
        squared = torch.baddbmm(square[:, None, :], q, lower.mT, alpha=-2).addcmul_(clamped, clamped - 2 * t)
        nearest[..., start : start + chunk] = squared.unflatten(-1, (panels, n)).argmin(-1).mT
    return nearest.reshape(*batch, panels, -1)


def _cubics(edges: Edges, tangents: Edges, stations: Tensor) -> Float[Tensor, "*batch rows 24"]:
    """Power-series coefficients of both edges over every interval of every panel; rows run over (panel, interval)."""
    h = (stations[1:] - stations[:-1])[:, None]
    x0, x1 = edges[..., :-1, :], edges[..., 1:, :]
    v0, v1 = h * tangents[..., :-1, :], h * tangents[..., 1:, :]
    rise = x1 - x0
    series = torch.stack((x0, v0, 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise), dim=-2).flatten(-2)
    return torch.cat((series[..., :-1, :, :], series[..., 1:, :, :]), dim=-1).flatten(-3, -2)


@torch.no_grad()
def refine(
    points: Points,
    edges: Edges,
    tangents: Edges,
    stations: Float[Tensor, " n"],
    start: Int[Tensor, "*batch panels points"],
    iterations: int = 6,
) -> tuple[Feet, Float[Tensor, "*batch panels points"]]:
    """Foot points in every panel beside the sampled rulings `start`, and the squared distances to them.

    The number of iterations is fixed, so that a point's foot does not depend on what else is in the batch.
    """
    panels, intervals = edges.shape[-3] - 1, edges.shape[-2] - 1
    panel = torch.arange(panels, device=points.device)[:, None].expand_as(start)
    table = _cubics(edges, tangents, stations)
    p = points.movedim(-1, 0)[..., None, :].contiguous()

    def series_of(interval: Tensor) -> Tensor:
        """(4 powers, 2 edges, 3 components, *batch, panels, points): components first keeps every step a contiguous pass."""
        rows = gather_rows(table, panel * intervals + interval)
        return rows.unflatten(-1, (2, 4, 3)).movedim((-2, -3, -1), (0, 1, 2)).contiguous()

    def evaluate(c: Tensor, tau: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """u*, first and second derivative by tau of half the squared distance, and the squared distance."""
        value = torch.addcmul(c[0], torch.addcmul(c[1], torch.addcmul(c[2], c[3], tau), tau), tau)
        slope = torch.addcmul(c[1], torch.addcmul(2 * c[2], 3 * c[3], tau), tau)
        bend = torch.addcmul(2 * c[2], 6 * c[3], tau)
        a, g, g1 = value[0], value[1] - value[0], slope[1] - slope[0]
        gg = (g * g).sum(0).clamp_min(1e-30)
        offset = p - a
        free = (offset * g).sum(0) / gg
        u = free.clamp(0, 1)
        delta = torch.addcmul(offset, u, g, value=-1)
        along = torch.addcmul(slope[0], u, g1)
        first = -(delta * along).sum(0)
        second = (along * along).sum(0) - (delta * torch.addcmul(bend[0], u, bend[1] - bend[0])).sum(0)
        mixed = (along * g).sum(0) - (delta * g1).sum(0)
        second = torch.where(free == u, second - mixed * mixed / gg, second)
        return u, first, second, (delta * delta).sum(0)

    # The nearest station is an end of two intervals; the derivative there tells which one holds the minimum.
    at_end = start == intervals
    interval = torch.where(at_end, start - 1, start)
    tau = at_end.to(points.dtype)
    slope = evaluate(series_of(interval), tau)[1]
    back = (slope > 0) & (start > 0) & ~at_end
    interval = torch.where(back, interval - 1, interval)
    series = series_of(interval)
    tau = torch.where(back, torch.ones_like(tau), tau)
    low, high = torch.zeros_like(tau), torch.ones_like(tau)
    for _ in range(iterations):
        _, first, second, _ = evaluate(series, tau)
        high = torch.where(first > 0, tau, high)
        low = torch.where(first < 0, tau, low)
        newton = tau - first / second
        usable = (second > 0) & (newton >= low) & (newton <= high)
        middle = torch.where(first == 0, tau, 0.5 * (low + high))
        tau = torch.where(usable, newton, middle)
    u, _, _, squared = evaluate(series, tau)
    return Feet(panel, interval, tau, u), squared


@torch.no_grad()
def nearest_feet(
    points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], iterations: int = 6
) -> Feet:
    """The nearest point of the whole cup for every point, exact to round-off."""
    panels = edges.shape[-3] - 1
    batch = edges.shape[:-3].numel()
    chunk = max(1, CHUNK // max(1, batch * panels))
    parts = []
    for q in points.split(chunk, dim=-2):
        feet, squared = refine(q, edges, tangents, stations, nearest_stations(q, edges), iterations)
        best = squared.argmin(-2, keepdim=True)
        parts.append([x.gather(-2, best).squeeze(-2) for x in (feet.panel, feet.interval, feet.tau, feet.u)])
    return Feet(*(torch.cat(field, dim=-1) for field in zip(*parts)))


@torch.no_grad()
def foot_directions(
    points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet
) -> Points:
    """Unit vectors m such that m . (p - X*) is the signed distance, positive outside the cup.

    Where the foot lies inside a panel that is the surface normal; at the rim it is the difference vector's own direction.
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
    """Distance of points to their feet, positive outside the cup, with the envelope theorem's gradients."""
    direction = foot_directions(points, edges.detach(), tangents.detach(), stations, feet)
    return dot(points - surface_points(edges, tangents, stations, feet), direction)


def distance_jacobian(
    directions: Points,
    feet: Feet,
    stations: Float[Tensor, " n"],
    edge_count: int,
    table_jacobian: Float[Tensor, "*batch rows 3 size"],
) -> Float[Tensor, "*batch points size"]:
    """Derivatives of the signed distances by the parameters: -m . dX(s*, u*) / da.

    Args:
        directions: from `foot_directions`.
        table_jacobian: derivatives of `sample_table` by the parameters.

    One fused pass: each row is a weighted sum of 24 rows of the table's derivative.
    """
    index, weight = stencil(feet, stations, edge_count)
    *batch, rows, _, size = table_jacobian.shape
    count = index.shape[-2]
    problem = torch.arange(math.prod(batch), device=index.device).view(*batch, 1, 1) * rows
    components = torch.arange(3, device=index.device)
    index = ((index + problem)[..., None] * 3 + components).reshape(-1, 24)
    weight = (weight[..., None] * -directions[..., None, :]).reshape(-1, 24)
    bags = torch.nn.functional.embedding_bag(
        index, table_jacobian.reshape(-1, size), mode="sum", per_sample_weights=weight
    )
    return bags.view(*batch, count, size)
