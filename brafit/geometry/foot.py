"""The foot of a point on a given panel, refined from a ruling nearby: (56) and (57) of docs/formulation.md.

Vectors have their components first, which makes every step a contiguous pass over the points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.hermite import Series, columns, cubics
from brafit.geometry.panels import Edges


@dataclass(frozen=True)
class Tables:
    """What `refined` gathers for every point, problem after problem.

    Attributes:
        cubics: per (panel, interval): power series of the lower edge and of the vector along the ruling.
        samples: per (panel, station): the ruling's lower end, the vector along it, and their derivatives.
        steps: lengths of the intervals.
    """

    cubics: Float[Tensor, "24 rows"]
    samples: Float[Tensor, "12 stations"]
    steps: Float[Tensor, " intervals"]

    @staticmethod
    def of(edges: Edges, tangents: Edges, stations: Tensor) -> "Tables":
        series = cubics(edges, tangents, stations)
        rows = torch.stack((series[:, :-1], series[:, 1:] - series[:, :-1]), dim=-2)
        (x0, x1), (v0, v1) = ((w[:, :-1], w[:, 1:]) for w in (edges, tangents))
        samples = torch.cat((x0, x1 - x0, v0, v1 - v0), dim=-1)
        return Tables(rows.reshape(-1, 24).mT.contiguous(), samples.reshape(-1, 12).mT.contiguous(), stations.diff())


def _cross(a: Float[Tensor, "3 m"], b: Float[Tensor, "3 m"]) -> Float[Tensor, "3 m"]:
    """Vector products of vectors whose components come first."""
    (x, y, z), (u, v, w) = a, b
    return torch.stack((y * w - z * v, z * u - x * w, x * v - y * u))


def inner(a: Float[Tensor, "3 m"], b: Float[Tensor, "3 m"]) -> Float[Tensor, " m"]:
    """Scalar products of vectors whose components come first."""
    return (a * b).sum(0)


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
        length = inner(ruling, ruling).clamp_min(1e-30)
        free = inner(offset, ruling) / length
        u = free.clamp(0, 1)
        return _Foot(u, free, torch.addcmul(offset, u, ruling, value=-1), length)


def _descent(
    p: Float[Tensor, "3 m"], series: Series, tau: Float[Tensor, " m"]
) -> tuple[Float[Tensor, " m"], Float[Tensor, " m"]]:
    """First and second derivative by tau of half the squared distance to the ruling at tau, (57)."""
    (a, g), (a1, g1), (a2, g2) = series.value(tau), series.slope(tau), series.bend(tau)
    foot = _Foot.of(p - a, g)
    along = torch.addcmul(a1, foot.u, g1)
    second = inner(along, along) - inner(foot.delta, torch.addcmul(a2, foot.u, g2))
    mixed = inner(along, g) - inner(foot.delta, g1)
    sliding = torch.addcdiv(second, mixed * mixed, foot.length, value=-1)
    return -inner(foot.delta, along), torch.where(foot.free == foot.u, sliding, second)


def descended(descent: Callable[[Tensor], tuple[Tensor, Tensor]], tau: Tensor, iterations: int) -> Tensor:
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


def refined(
    p: Float[Tensor, "3 m"],
    panel: Int[Tensor, " m"],
    start: Int[Tensor, " m"],
    tau: Float[Tensor, " m"] | None,
    tables: Tables,
    iterations: int,
) -> Float[Tensor, "10 m"]:
    """Foot points in given panels: interval, tau, u, squared distance, difference vector and surface normal.

    They are sought beside given stations; or, with `tau`, from that place in given intervals, which may first step
    over to the next one. Components come first, which makes every step a contiguous pass.
    """
    intervals = len(tables.steps)

    def series(interval: Tensor) -> Series:
        return Series.of(columns(tables.cubics, panel * intervals + interval).view(4, 2, 3, -1))

    if tau is None:
        x, g, v, change = columns(tables.samples, panel * (intervals + 1) + start).view(4, 3, -1)
        # The nearest station is an end of two intervals; the derivative there tells which one holds the minimum.
        foot = _Foot.of(p - x, g)
        uphill = inner(foot.delta, torch.addcmul(v, foot.u, change)) < 0
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
    tau = descended(partial(_descent, p, curves), tau, iterations)
    (a, g), (a1, g1) = curves.value(tau), curves.slope(tau)
    foot = _Foot.of(p - a, g)
    normal = _cross(torch.addcmul(a1, foot.u, g1), g)
    normal = normal / inner(normal, normal).clamp_min(1e-60).sqrt()
    scalars = torch.stack((interval.to(p.dtype), tau, foot.u, inner(foot.delta, foot.delta)))
    return torch.cat((scalars, foot.delta, normal))
