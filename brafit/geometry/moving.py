"""Nearest points that move with the cup and the points, (77) of docs/formulation.md.

`brafit.geometry.nearest` finds nearest points and holds them; here they are differentiable as the places of minima.

The squared distance E(x, data) of a point has its minimum in the place x*. With x* held, the first derivatives of the
least distance by the data are right (envelope theorem), the second are not: the place moves, by -E_xx^-1 E_xd. One step
of Newton's method from x*, in which E_xx is held, stays in the place and has that derivative, and with it the least
distance has the right second derivatives.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from brafit.geometry.developable import dot
from brafit.geometry.hermite import hermite, hermite_bend, hermite_slope
from brafit.geometry.panels import Edges, Feet, Points, gather_rows, sample_table, stencil, weighted

_FLAT = 1e-9
"""Where a minimum is so flat across some direction, in parts of what it could be, its place is held: at the cusps."""


def slid(
    points: Points,
    samples: Float[Tensor, "*batch points 4 3"],
    tau: Float[Tensor, "*batch points"],
    h: Float[Tensor, "*batch points"],
    free: Bool[Tensor, "*batch points"],
) -> Float[Tensor, "*batch points"]:
    """Places in intervals of a cubic Hermite curve, nearest to points, that move with the curve and the points.

    Args:
        points: as many as places.
        samples: of each interval: both ends, and the derivatives there.
        tau: the places, in [0, 1].
        h: lengths of the intervals.
        free: where the place can move: not at the curve's ends.
    """
    apart = weighted(hermite(tau, h), samples) - points
    along = weighted(hermite_slope(tau, h), samples)
    with torch.no_grad():
        second = dot(along, along) + dot(apart, weighted(hermite_bend(tau, h), samples))
        inverse = torch.where(free & (second > 0), 1 / second, 0.0)
    return tau - inverse * dot(apart, along)


def moving_gaps(points: Points, edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """Vectors from the nearest points of a cup to points, with feet that move: their squared lengths are twice
    differentiable in the points, edges and tangents.

    A foot on a panel's edge stays on the edge, and one in an end of the wire stays there.

    Args:
        points: in the unit of the edges.
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        feet: exact, of these points on these edges.
    """
    tau, u = feet.tau, feet.u
    h = stations[feet.interval + 1] - stations[feet.interval]
    index, _ = stencil(feet, stations, edges.shape[-3])
    lower, upper = gather_rows(sample_table(edges, tangents), index).split(4, dim=-2)
    rise = upper - lower

    def across(weights: Tensor) -> tuple[Tensor, Tensor]:
        """The curve that the place on the rulings draws, and the vector along the rulings, or their derivatives."""
        own = weighted(weights, rise)
        return weighted(weights, lower) + u[..., None] * own, own

    place, ruling = across(hermite(tau, h))
    along, turning = across(hermite_slope(tau, h))
    apart = place - points
    with torch.no_grad():
        bend, _ = across(hermite_bend(tau, h))
        last = len(stations) - 2
        end = ((feet.interval == 0) & (tau == 0)) | ((feet.interval == last) & (tau == 1))
        tt = dot(along, along) + dot(apart, bend)
        tu = dot(along, ruling) + dot(apart, turning)
        uu = dot(ruling, ruling)
        free_u = (u > 0) & (u < 1) & ~end
        tu = torch.where(free_u, tu, 0.0)
        uu = torch.where(free_u, uu, 1.0)
        det = tt * uu - tu * tu
        sound = ~end & (det > _FLAT * tt * uu) & (tt > 0)
        scale = torch.where(sound, 1 / det, 0.0)
    by_tau, by_u = dot(apart, along), torch.where(free_u, dot(apart, ruling), 0.0)
    moved_tau = tau - scale * (uu * by_tau - tu * by_u)
    moved_u = u - scale * (tt * by_u - tu * by_tau)
    weights = hermite(moved_tau, h)
    return points - weighted(weights, lower) - moved_u[..., None] * weighted(weights, rise)
