"""A chain of developable strips from the wire to the upper edge, made of its series at the nodes of a grid.

See `brafit.geometry.strip` for the equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.corner import beside_corner, cornered
from brafit.cup.shape import CupShape
from brafit.cup.strip_grid import StripGrid
from brafit.cup.wire import LENGTH
from brafit.geometry.fairness import Variation
from brafit.geometry.products import bmm
from brafit.geometry.strip import Angle, Rates, Strip, UpperTurn, next_rates, roll, strip, turned, upper_turn

RIB_LIMIT = 1.3
"""Largest rib angle in radians: alpha = 1.3 tanh(series / 1.3)."""
BUMP_SECOND = -8 / LENGTH**2
"""Second derivative of 1 - x^2 by s."""

Values = Float[Tensor, "batch n"]
Vectors = Float[Tensor, "batch n 3"]


@dataclass(frozen=True)
class ChainPanel:
    """One panel at the nodes of a grid.

    Attributes:
        rates: of its lower edge's reference frame, per s.
        lower: its lower edge.
        bounded: tanh of the rib angle's series over RIB_LIMIT.
        lean_slope: derivative of that series by s.
        t_slope: first derivative of the ruling length by s.
        t_second: second derivative.
        strip: its scalars.
        d: rulings, unit vectors from the lower to the upper edge.
        d_max: unit vectors at right angles to the rulings, in the panel, along the wire.
        eta: normals.
        corner: height, jump and place of its upper edge's corner; None below the last panel, which alone has one.
    """

    rates: Rates
    lower: Vectors
    bounded: Values
    lean_slope: Values
    t_slope: Values
    t_second: Values
    strip: Strip
    d: Vectors
    d_max: Vectors
    eta: Vectors
    corner: Float[Tensor, "batch 3"] | None

    @property
    def upper(self) -> Vectors:
        """Its upper edge."""
        return torch.addcmul(self.lower, self.strip.t[..., None], self.d)

    @property
    def upper_tangent(self) -> Vectors:
        """Derivative of the upper edge by s."""
        return torch.addcmul(self.strip.p[..., None] * self.d, self.strip.q[..., None], self.d_max)

    def upper_turn(self, grid: StripGrid) -> UpperTurn:
        """How its upper edge turns; `grid`: whose nodes these are."""
        return upper_turn(self.strip, self.t_slope, self.t_second, grid.derivative)

    def variations(self, turn: UpperTurn, grid: StripGrid) -> tuple[Variation, Variation]:
        """How the curvature of its lower and of its upper edge varies when it is laid flat, the corner apart.

        Args:
            turn: from `upper_turn`.
            grid: whose nodes these are.
        """
        own, steps = self.strip, grid.s.diff()
        share = 1.0 if self.corner is None else beside_corner(self.corner, grid.x)[0]
        return (
            Variation(own.omega_eta, own.speed, steps),
            Variation(own.spin - turn.beta, own.next_speed, steps, share),
        )


def march(
    grid: StripGrid,
    angle: Float[Tensor, "batch panels"],
    rib: Float[Tensor, "batch panels terms"],
    length: Float[Tensor, "batch panels terms"],
    corner: Float[Tensor, "batch 3"],
) -> Iterator[ChainPanel]:
    """The panels from the wire upwards.

    Args:
        grid: the nodes, and the wires there.
        angle: angle (rad) by which each panel leaves its lower edge's reference frame in the middle.
        rib: series of the rib angle before its bound.
        length: series of the log of ruling length over (1 - x^2).
        corner: height, jump and place of the upper edge's corner.
    """
    panels = angle.shape[1]
    rates = Rates(grid.speed, grid.k1, grid.k2, grid.w)
    edge, T, U, V = grid.edge, grid.T, grid.U, grid.V
    values, slopes, seconds = (v.unbind(1) for v in series(torch.cat((rib, length), dim=1), *grid.bases))
    for i in range(panels):
        own_corner = corner if i == panels - 1 else None
        bounded, lean_slope = torch.tanh(values[i] / RIB_LIMIT), slopes[i]
        logs = tuple(v[panels + i] for v in (values, slopes, seconds))
        t, t_slope, t_second = _ruling_lengths(logs if own_corner is None else cornered(logs, corner, grid.x), grid)
        alpha, saturation = Angle.of(RIB_LIMIT * bounded), 1 - bounded * bounded
        phi = Angle.of(roll(rates, alpha.tangent, angle[:, i], grid.integral))
        panel = strip(rates, phi, alpha, saturation * lean_slope, t, t_slope)
        xi, eta = turned(U, V, phi)
        d_max, d = turned(T, xi, alpha)
        yield ChainPanel(rates, edge, bounded, lean_slope, t_slope, t_second, panel, d, d_max, eta, own_corner)
        edge = edge + t[..., None] * d
        U, T = turned(d, d_max, panel.beta)
        V = eta
        if own_corner is None:
            rates = next_rates(panel, grid.derivative)


def _ruling_lengths(logs: Sequence[Values], grid: StripGrid) -> tuple[Values, Values, Values]:
    """Ruling lengths and their two derivatives by s, from those of log(t / (1 - x^2))."""
    log, log_slope, log_second = logs
    size = torch.exp(log)
    t, t_slope = size * grid.bump, size * torch.addcmul(grid.bump_slope, grid.bump, log_slope)
    t_second = size * (BUMP_SECOND + (2 * grid.bump_slope + grid.bump * log_slope) * log_slope)
    return t, t_slope, torch.addcmul(t_second, t, log_second)


def chain_shape(grid: StripGrid, panels: Sequence[ChainPanel]) -> CupShape:
    """The cups at the nodes.

    Args:
        grid: the nodes, and the wires there.
        panels: from `march`, on the same grid.
    """
    return CupShape(
        stations=grid.s,
        edges=torch.stack([grid.edge, *(panel.upper for panel in panels)], dim=1),
        tangents=torch.stack([grid.T * grid.speed[..., None], *(panel.upper_tangent for panel in panels)], dim=1),
        directions=torch.stack([panel.d for panel in panels], dim=1),
        normals=torch.stack([panel.eta for panel in panels], dim=1),
        geodesic=torch.stack([panel.strip.omega_eta / panel.rates.speed for panel in panels], dim=1),
    )


def series(
    coefficients: Float[Tensor, "batch series terms"], *bases: Float[Tensor, "terms n"]
) -> tuple[Float[Tensor, "batch series n"], ...]:
    """Values of series and their derivatives, one for each basis.

    Args:
        coefficients: of the series.
        bases: from `brafit.cup.strip_grid.chebyshev_bases`.
    """
    every = torch.cat(bases, dim=-1)
    return bmm(coefficients, every.expand(len(coefficients), -1, -1)).chunk(len(bases), dim=-1)
