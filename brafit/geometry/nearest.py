"""Nearest point on a chain of ruled panels, (26)-(31) and (56)-(58) of docs/formulation.md.

Panel i is X(s, u) = (1 - u) a(s) + u b(s) with u = t / t_max in [0, 1], a and b its edges, which run between stations
as cubic Hermite curves. The nearest ruling of each panel is found among the stations, then (s, u) is refined to the
foot point by a safeguarded Newton iteration in s, u being eliminated in closed form (30).

At a foot the derivative of the distance through (s*, u*) vanishes (envelope theorem), so the search runs without
gradients and the distance is differentiated through the surface point at fixed (s*, u*) only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.developable import dot, unit
from brafit.geometry.products import weighted_rows

Points = Float[Tensor, "*batch points 3"]
Edges = Float[Tensor, "*batch edges n 3"]
CHUNK = 1 << 17
"""Distances held at a time in the search, over the whole batch: bounds the memory for any number of points, and fits
caches.
"""
DEVICE = 1 << 9
"""Factor on CHUNK for devices other than the processor, whose time depends on the number of calls."""


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

    def on(self, stations: Float[Tensor, " n"], others: Float[Tensor, " m"]) -> "Feet":
        """The same feet on panels that are sampled at other stations."""
        arc = self.arc(stations)
        interval = (torch.searchsorted(others, arc, right=True) - 1).clamp(0, len(others) - 2)
        start = others[interval]
        return Feet(self.panel, interval, ((arc - start) / (others[interval + 1] - start)).clamp(0, 1), self.u)


def chunk_of(like: Tensor) -> int:
    """Distances held at a time on a tensor's device."""
    return CHUNK if like.device.type == "cpu" else CHUNK * DEVICE


def hermite(tau: Tensor, h: Tensor) -> Tensor:
    """Weights of (x_k, x_k+1, x'_k, x'_k+1) in the cubic Hermite interpolant."""
    t2, t3 = tau * tau, tau * tau * tau
    return torch.stack((2 * t3 - 3 * t2 + 1, 3 * t2 - 2 * t3, h * (t3 - 2 * t2 + tau), h * (t3 - t2)), dim=-1)


def hermite_slope(tau: Tensor, h: Tensor) -> Tensor:
    """Their derivatives by tau."""
    t2 = tau * tau
    return torch.stack((6 * t2 - 6 * tau, 6 * tau - 6 * t2, h * (3 * t2 - 4 * tau + 1), h * (3 * t2 - 2 * tau)), dim=-1)


def hermite_bend(tau: Tensor, h: Tensor) -> Tensor:
    """Their second derivatives by tau."""
    return torch.stack((12 * tau - 6, 6 - 12 * tau, h * (6 * tau - 4), h * (6 * tau - 2)), dim=-1)


def stencil(
    feet: Feet, stations: Float[Tensor, " n"], edge_count: int, slope: bool = False
) -> tuple[Int[Tensor, "*batch points 8"], Float[Tensor, "*batch points 8"]]:
    """The surface points as weighted sums of samples: indices into `sample_table` and weights.

    Args:
        feet: where on the panels.
        stations: s of the samples, increasing.
        edge_count: edges, one more than panels.
        slope: the weights of the derivative dX/dtau instead of X.
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


def gather_rows(
    table: Float[Tensor, "*batch rows k"], index: Int[Tensor, "*batch p m"]
) -> Float[Tensor, "*batch p m k"]:
    """Rows of each batch item's table, for two trailing dimensions of indices."""
    flat = index.flatten(-2)[..., None].expand(*index.shape[:-2], -1, table.shape[-1])
    return table.gather(-2, flat).unflatten(-2, index.shape[-2:])


def weighted(weight: Float[Tensor, "*batch p m"], rows: Float[Tensor, "*batch p m k"]) -> Float[Tensor, "*batch p k"]:
    """Weighted sums of rows."""
    return (weight[..., None, :] @ rows)[..., 0, :]


def surface_points(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """X(s*, u*): differentiable in the edges, with the feet held fixed."""
    index, weight = stencil(feet, stations, edges.shape[-3])
    return weighted(weight, gather_rows(sample_table(edges, tangents), index))


def surface_normals(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """Unit normals X_s x X_u at the feet, outward for a cup: eta = zeta x xi."""
    rows = sample_table(edges, tangents)
    index, slope = stencil(feet, stations, edges.shape[-3], slope=True)
    samples = gather_rows(rows, index)
    along = weighted(slope, samples)
    h = stations[feet.interval + 1] - stations[feet.interval]
    bare = hermite(feet.tau, h)
    ruling = weighted(bare, samples[..., 4:, :] - samples[..., :4, :])
    return unit(torch.linalg.cross(along, ruling))


@torch.no_grad()
def sampled_distances(
    points: Points, edges: Edges
) -> tuple[Int[Tensor, "panels *batch points"], Float[Tensor, "panels *batch points"]]:
    """Nearest sampled ruling of every panel, by the closed-form distance to the segments, and the squared distances
    to them.
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


def _cubics(
    edges: Float[Tensor, "*batch n 3"], tangents: Float[Tensor, "*batch n 3"], stations: Tensor
) -> Float[Tensor, "*batch intervals 4 3"]:
    """Power-series coefficients of curves over every interval."""
    h = (stations[1:] - stations[:-1])[:, None]
    x0, x1 = edges[..., :-1, :], edges[..., 1:, :]
    v0, v1 = h * tangents[..., :-1, :], h * tangents[..., 1:, :]
    rise = x1 - x0
    return torch.stack((x0, v0, 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise), dim=-2)


@dataclass(frozen=True)
class _Tables:
    """What `_refine` gathers for every point, problem after problem.

    Attributes:
        cubics: per (panel, interval): power series of the lower edge and of the vector along the ruling.
        samples: per (panel, station): the ruling's lower end, the vector along it, and their derivatives.
        steps: lengths of the intervals.
    """

    cubics: Float[Tensor, "24 rows"]
    samples: Float[Tensor, "12 stations"]
    steps: Float[Tensor, " intervals"]

    @staticmethod
    def of(edges: Edges, tangents: Edges, stations: Tensor) -> "_Tables":
        series = _cubics(edges, tangents, stations)
        cubics = torch.stack((series[:, :-1], series[:, 1:] - series[:, :-1]), dim=-2)
        (x0, x1), (v0, v1) = ((w[:, :-1], w[:, 1:]) for w in (edges, tangents))
        samples = torch.cat((x0, x1 - x0, v0, v1 - v0), dim=-1)
        return _Tables(cubics.reshape(-1, 24).mT.contiguous(), samples.reshape(-1, 12).mT.contiguous(), stations.diff())


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
    panels, n = edges.shape[-3] - 1, edges.shape[-2]
    p, x, v = points.reshape(-1, 3), edges.reshape(-1, panels + 1, n, 3), tangents.reshape(-1, panels + 1, n, 3)
    tables = _Tables.of(x, v, stations)
    problem = torch.arange(len(x), device=p.device).repeat_interleave(count) * panels
    components = p.mT.contiguous()

    def refine(index: Tensor | None, panel: Tensor, interval: Tensor, tau: Tensor | None) -> Tensor:
        """Of the points with these indices; None: of all."""
        chosen = components if index is None else _columns(components, index)
        row = panel + (problem if index is None else problem.index_select(0, index))
        parts = []
        size = max(1, chunk_of(p) // 16)
        for first in range(0, len(row), size):
            part = slice(first, first + size)
            place = None if tau is None else tau[part]
            parts.append(_refine(chosen[:, part], row[part], interval[part], place, tables, iterations))
        return torch.cat(parts, dim=1) if parts else p.new_zeros(10, 0)

    if near is None:
        start, bound = _starts(points, x, panels)
        panel = bound.min(0).indices
        found = refine(None, panel, start.gather(0, panel[None])[0], None)
        nearer = (bound < found[3]).scatter_(0, panel[None], False)
        other, index = nearer.nonzero().unbind(1)
        crossed, counts = refine(index, other, start[other, index], None), nearer.sum(1).tolist()
        again = list(zip(other.split(counts), index.split(counts), crossed.split(counts, dim=1), strict=True))
    else:
        panel, interval, tau = near.panel.reshape(-1), near.interval.reshape(-1), near.tau.reshape(-1)
        found = refine(None, panel, interval, tau)
        # A foot that came to rest on a ridge may go on beyond it.
        beyond = panel + (found[2] == 1).long() - (found[2] == 0).long()
        index = ((beyond != panel) & (beyond >= 0) & (beyond < panels)).nonzero()[:, 0]
        other = beyond[index]
        again = [(other, index, refine(index, other, found[0, index].long(), found[1, index]))]
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
    along = _dot(delta, normal)
    on_surface = (along.abs() >= size * (1 - 1e-6)) | (size < 1e-12)
    sign = torch.where(along < 0, -1.0, 1.0).to(p.dtype)
    away = delta * (sign / size.clamp_min(1e-30))
    directions = torch.where(on_surface, normal, away).mT.reshape(*batch, count, 3)
    distances = torch.where(on_surface, along, sign * size).reshape(*batch, count)
    feet = (panel, interval.long(), tau, u)
    return Projection(Feet(*(w.reshape(*batch, count) for w in feet)), directions, distances)


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


def _columns(table: Float[Tensor, "k rows"], index: Int[Tensor, " m"]) -> Float[Tensor, "k m"]:
    """Columns of a table. (Rows gathered and then transposed take twice as long.)"""
    return table.gather(1, index.expand(len(table), -1))


def _cross(a: Float[Tensor, "3 m"], b: Float[Tensor, "3 m"]) -> Float[Tensor, "3 m"]:
    """Vector products of vectors whose components come first."""
    (x, y, z), (u, v, w) = a, b
    return torch.stack((y * w - z * v, z * u - x * w, x * v - y * u))


def _dot(a: Float[Tensor, "3 m"], b: Float[Tensor, "3 m"]) -> Float[Tensor, " m"]:
    """Scalar products of vectors whose components come first."""
    return (a * b).sum(0)


@dataclass(frozen=True)
class _Series:
    """Cubics in tau, one for every point, with components first: value, slope and bend at given places."""

    terms: tuple[Tensor, ...]

    @staticmethod
    def of(terms: Float[Tensor, "4 *components m"]) -> "_Series":
        c0, c1, c2, c3 = terms.unbind(0)
        return _Series((c0, c1, c2, c3, 2 * c2, 3 * c3))

    def value(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        c0, c1, c2, c3, _, _ = self.terms
        return torch.addcmul(c0, torch.addcmul(c1, torch.addcmul(c2, c3, tau), tau), tau)

    def slope(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        _, c1, _, _, twice, thrice = self.terms
        return torch.addcmul(c1, torch.addcmul(twice, thrice, tau), tau)

    def bend(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        *_, twice, thrice = self.terms
        return torch.addcmul(twice, thrice, tau, value=2)


@dataclass(frozen=True)
class _Foot:
    """The nearest points of given rulings: u*, what it would be on endless rulings, the vectors from them to the
    points, and the squared lengths of the rulings.
    """

    u: Float[Tensor, " m"]
    free: Float[Tensor, " m"]
    delta: Float[Tensor, "3 m"]
    length: Float[Tensor, " m"]

    @staticmethod
    def of(offset: Float[Tensor, "3 m"], ruling: Float[Tensor, "3 m"]) -> "_Foot":
        """From the vectors from the rulings' lower ends to the points, and those along the rulings."""
        length = _dot(ruling, ruling).clamp_min(1e-30)
        free = _dot(offset, ruling) / length
        u = free.clamp(0, 1)
        return _Foot(u, free, torch.addcmul(offset, u, ruling, value=-1), length)


def _descent(
    p: Float[Tensor, "3 m"], series: _Series, tau: Float[Tensor, " m"]
) -> tuple[Float[Tensor, " m"], Float[Tensor, " m"]]:
    """First and second derivative by tau of half the squared distance to the ruling at tau, (57)."""
    (a, g), (a1, g1), (a2, g2) = series.value(tau), series.slope(tau), series.bend(tau)
    foot = _Foot.of(p - a, g)
    along = torch.addcmul(a1, foot.u, g1)
    second = _dot(along, along) - _dot(foot.delta, torch.addcmul(a2, foot.u, g2))
    mixed = _dot(along, g) - _dot(foot.delta, g1)
    sliding = torch.addcdiv(second, mixed * mixed, foot.length, value=-1)
    return -_dot(foot.delta, along), torch.where(foot.free == foot.u, sliding, second)


def _descended(descent: Callable[[Tensor], tuple[Tensor, Tensor]], tau: Tensor, iterations: int) -> Tensor:
    """Minima in [0, 1] by Newton's method, with bisection where its step is of no use.

    `descent` gives the first and second derivative at tau.
    """
    low, high = torch.zeros_like(tau), torch.ones_like(tau)
    for _ in range(iterations):
        first, second = descent(tau)
        high = torch.where(first > 0, tau, high)
        low = torch.where(first < 0, tau, low)
        newton = tau - first / second
        usable = (second > 0) & (newton >= low) & (newton <= high)
        tau = torch.where(usable, newton, 0.5 * (low + high))
    return tau


def _refine(
    p: Float[Tensor, "3 m"],
    panel: Int[Tensor, " m"],
    start: Int[Tensor, " m"],
    tau: Float[Tensor, " m"] | None,
    tables: _Tables,
    iterations: int,
) -> Float[Tensor, "10 m"]:
    """Foot points in given panels: interval, tau, u, squared distance, difference vector and surface normal.

    They are sought beside given stations; or, with `tau`, from that place in given intervals, which may first step
    over to the next one. Components come first, which makes every step a contiguous pass.
    """
    intervals = len(tables.steps)

    def series(interval: Tensor) -> _Series:
        return _Series.of(_columns(tables.cubics, panel * intervals + interval).view(4, 2, 3, -1))

    if tau is None:
        x, g, v, change = _columns(tables.samples, panel * (intervals + 1) + start).view(4, 3, -1)
        # The nearest station is an end of two intervals; the derivative there tells which one holds the minimum.
        foot = _Foot.of(p - x, g)
        uphill = _dot(foot.delta, torch.addcmul(v, foot.u, change)) < 0
        back = ((start > 0) & uphill) | (start == intervals)
        interval = start - back.long()
        tau = back.to(p.dtype)
        curves = series(interval)
    else:
        curves = series(start)
        first, second = _descent(p, curves, tau)
        tau = tau - torch.where(second > 0, first / second, 0.0).clamp(-1, 1)
        aside = (tau > 1).long() - (tau < 0).long()
        interval = (start + aside).clamp(0, intervals - 1)
        moved = interval != start
        scale = tables.steps.index_select(0, start) / tables.steps.index_select(0, interval)
        there = torch.where(aside > 0, (tau - 1) * scale, 1 + tau * scale)
        tau = torch.where(moved, there, tau).clamp(0, 1)
        if moved.any():
            curves = series(interval)
    tau = _descended(partial(_descent, p, curves), tau, iterations)
    (a, g), (a1, g1) = curves.value(tau), curves.slope(tau)
    foot = _Foot.of(p - a, g)
    normal = _cross(torch.addcmul(a1, foot.u, g1), g)
    normal = normal / _dot(normal, normal).clamp_min(1e-60).sqrt()
    scalars = torch.stack((interval.to(p.dtype), tau, foot.u, _dot(foot.delta, foot.delta)))
    return torch.cat((scalars, foot.delta, normal))


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
    back = ((start > 0) & (_dot(p - x, v) < 0)) | (start == n - 1)
    interval, tau = start - back.long(), back.to(p.dtype)
    table = _cubics(curve, tangents, stations).reshape(-1, 12)
    series = _Series.of(_columns(table.mT.contiguous(), problem * (n - 1) + interval).view(4, 3, -1))

    def descent(tau: Tensor) -> tuple[Tensor, Tensor]:
        delta, along = p - series.value(tau), series.slope(tau)
        return -_dot(delta, along), _dot(along, along) - _dot(delta, series.bend(tau))

    tau = _descended(descent, tau, iterations)
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


@dataclass(frozen=True)
class Sums:
    """Signed distances m . (p - X*) as sums over coordinates of samples, the feet held: what depends on the cup is the
    sum over k of weight[k] * coordinate[index[k]], from `sample_table` with its last two dimensions as one.

    Attributes:
        index, weight: of each point's 24 coordinates.
    """

    index: Int[Tensor, "*batch points 24"]
    weight: Float[Tensor, "*batch points 24"]

    @staticmethod
    def of(directions: Points, feet: Feet, stations: Float[Tensor, " n"], edge_count: int) -> "Sums":
        """`directions`: unit vectors m from `project` or `foot_directions`."""
        index, weight = stencil(feet, stations, edge_count)
        components = torch.arange(3, device=index.device, dtype=torch.int32)
        # 32 bits are enough for the rows of any table that fits into memory, and half the traffic.
        index = (index.int() * 3)[..., None] + components
        return Sums(index.flatten(-2), (weight[..., None] * -directions[..., None, :]).flatten(-2))

    def part(self, which: tuple[slice, slice]) -> "Sums":
        """Those of some problems and points."""
        return Sums(self.index[which], self.weight[which])

    def gradient(
        self, force: Float[Tensor, "*batch points"], table_jacobian: Float[Tensor, "*batch rows 3 size"]
    ) -> Float[Tensor, "*batch size"]:
        """Gradient of the sum of force * distance by the parameters, without a row for each point."""
        *batch, rows, _, size = table_jacobian.shape
        problem = 3 * rows * torch.arange(math.prod(batch), device=force.device).view(*batch, 1, 1)
        pull = force.new_zeros(math.prod(batch) * 3 * rows)
        pull.scatter_add_(0, (self.index + problem).flatten(), (force[..., None] * self.weight).flatten())
        table = table_jacobian.reshape(-1, 3 * rows, size)
        return weighted_rows(pull.view(-1, 3 * rows), table).view(*batch, size)

    def jacobian(self, table_jacobian: Float[Tensor, "*batch rows 3 size"]) -> Float[Tensor, "*batch points size"]:
        """Derivatives of the distances by the parameters, in the precision of the table's derivatives."""
        *batch, rows, _, size = table_jacobian.shape
        problem = 3 * rows * torch.arange(math.prod(batch), device=self.index.device, dtype=torch.int32)
        bags = torch.nn.functional.embedding_bag(
            (self.index + problem.view(*batch, 1, 1)).reshape(-1, 24),
            table_jacobian.reshape(-1, size),
            mode="sum",
            per_sample_weights=self.weight.to(table_jacobian).reshape(-1, 24),
        )
        return bags.view(*batch, -1, size)
