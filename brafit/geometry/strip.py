"""Developable strips built edge by edge: the Darboux frame of a panel integrated along a given edge, and the next
edge's rates.

Along an edge X(s) runs a reference frame (T, U, V), right-handed, T the unit tangent; its rates are per s:
speed = |X'|, k1 = T'.U, k2 = T'.V, w = U'.V. A panel leaves the edge turned by phi about T: xi = U cos(phi) + V
sin(phi), eta = V cos(phi) - U sin(phi), with rulings d = -T sin(alpha) + xi cos(alpha) of length t. With ' = d/ds,

    omega_xi = k1 sin(phi) - k2 cos(phi),  omega_eta = k1 cos(phi) + k2 sin(phi),  omega_zeta = phi' + w,

and the panel is developable exactly where omega_zeta = -omega_xi tan(alpha), (12), an equation for phi alone. Then d,
d_max = T cos(alpha) + xi sin(alpha) and eta turn as d' = -spin d_max and eta' = bend d_max with spin = alpha' +
omega_eta and bend = omega_xi / cos(alpha), so that

    (X + t d)' = p d + q d_max,  p = t' - speed sin(alpha),  q = speed cos(alpha) - t spin.

With beta = atan2(-p, q) the next edge's frame is T1 = -d sin(beta) + d_max cos(beta), U1 = d cos(beta) + d_max
sin(beta), V1 = eta, and its rates are k1 = spin - beta', k2 = -bend cos(beta), w = -bend sin(beta): a chain of panels
needs scalar functions only.

Functions of s are sampled on Chebyshev nodes. Matrices are applied problem by problem, so that rounding does not
depend on the batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.grid import (
    chebyshev_analysis,
    chebyshev_derivative,
    chebyshev_integral,
    chebyshev_points,
    chebyshev_synthesis,
)

Values = Float[Tensor, "*batch n"]
Vectors = Float[Tensor, "*batch n 3"]


@dataclass(frozen=True)
class Nodes:
    """Operators on functions sampled at n Chebyshev-Lobatto nodes of [0, length].

    Attributes:
        s: the nodes.
        derivative: values -> derivatives by s.
        integral: values -> integrals from the middle of the interval.
        middle: values -> value in the middle.
    """

    s: Float[np.ndarray, " n"]
    derivative: Float[np.ndarray, "n n"]
    integral: Float[np.ndarray, "n n"]

    @staticmethod
    def of(n: int, length: float) -> "Nodes":
        """n nodes on [0, length]."""
        half = length / 2
        integral = chebyshev_integral(n)
        to_middle = chebyshev_synthesis(n, np.zeros(1)) @ chebyshev_analysis(n) @ integral
        return Nodes((chebyshev_points(n) + 1) * half, chebyshev_derivative(n) / half, (integral - to_middle) * half)

    def interpolation(self, s: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m n"]:
        """Values at the nodes -> values at s."""
        x = 2 * s / self.s[-1] - 1
        return chebyshev_synthesis(len(self.s), x.clip(-1, 1)) @ chebyshev_analysis(len(self.s))


def apply(matrix: Float[Tensor, "m n"], values: Float[Tensor, "*batch n k"]) -> Float[Tensor, "*batch m k"]:
    """matrix @ values for every batch item on its own."""
    items = values.reshape(-1, *values.shape[-2:])
    return torch.bmm(matrix.expand(len(items), -1, -1), items).reshape(*values.shape[:-2], -1, values.shape[-1])


def apply_row(matrix: Float[Tensor, "m n"], values: Values) -> Float[Tensor, "*batch m"]:
    """`apply` for scalar functions."""
    return apply(matrix, values[..., None])[..., 0]


@dataclass(frozen=True)
class Rates:
    """Rates of a reference frame along an edge, per s."""

    speed: Values
    k1: Values
    k2: Values
    w: Values


@dataclass(frozen=True)
class Strip:
    """Scalars of one panel along its lower edge, as the module's docstring names them."""

    phi: Values
    alpha: Values
    t: Values
    omega_xi: Values
    omega_eta: Values
    spin: Values
    p: Values
    q: Values
    beta: Values
    speed: Values
    next_speed: Values

    @property
    def opening(self) -> Values:
        """A(0): how fast the rulings leave each other at the lower edge."""
        return self.speed * torch.cos(self.alpha)

    @property
    def bend(self) -> Values:
        return self.omega_xi / torch.cos(self.alpha)


def roll(
    rates: Rates,
    slope: Values,
    start: Float[Tensor, "*batch"],
    integral: Float[Tensor, "n n"],
    iterations: int = 8,
) -> tuple[Values, Float[Tensor, "*batch"]]:
    """phi along an edge, and the largest residual of its integral equation.

    Solves phi = start + integral of -w - (k1 sin(phi) - k2 cos(phi)) slope by Newton's method; each step's linear
    equation has an integrating factor, hence a closed form. The iterations run without gradients, each problem's until
    its residual is round-off; one more step makes the result differentiable.

    Args:
        slope: tan(alpha).
        start: phi in the middle of the edge.
        integral: from `Nodes`.
    """
    with torch.no_grad():
        fixed = Rates(*(v.detach() for v in (rates.speed, rates.k1, rates.k2, rates.w)))
        phi = start.detach()[..., None].expand_as(slope)
        enough = 500 * torch.finfo(phi.dtype).eps
        for _ in range(iterations):
            moved, off = _newton(phi, fixed, slope.detach(), start.detach(), integral)
            running = off > enough
            if not running.any():
                break
            phi = torch.where(running[..., None], moved, phi)
    return _newton(phi, rates, slope, start, integral)


def _newton(phi: Tensor, rates: Rates, slope: Tensor, start: Tensor, integral: Tensor) -> tuple[Tensor, Tensor]:
    sine, cosine = torch.sin(phi), torch.cos(phi)
    change = -rates.w - (rates.k1 * sine - rates.k2 * cosine) * slope
    with torch.no_grad():
        rate = (rates.k1 * cosine + rates.k2 * sine) * slope
    turned, growth = apply(integral, torch.stack((change, rate), dim=-1)).unbind(-1)
    residual = start[..., None] + turned - phi
    factor = torch.exp(growth.detach().clamp(-40, 40))
    step = residual - apply_row(integral, factor * rate * residual) / factor
    return phi + step.clamp(-1, 1), residual.detach().abs().amax(-1)


def strip(rates: Rates, phi: Values, alpha: Values, alpha_slope: Values, t: Values, t_slope: Values) -> Strip:
    """The panel on an edge, from its roll, rib angle and ruling length and the derivatives of the latter two by s."""
    sine, cosine = torch.sin(phi), torch.cos(phi)
    omega_xi = rates.k1 * sine - rates.k2 * cosine
    omega_eta = rates.k1 * cosine + rates.k2 * sine
    spin = alpha_slope + omega_eta
    p = t_slope - rates.speed * torch.sin(alpha)
    q = rates.speed * torch.cos(alpha) - t * spin
    return Strip(
        phi, alpha, t, omega_xi, omega_eta, spin, p, q, torch.atan2(-p, q), rates.speed, (p * p + q * q).sqrt()
    )


def next_rates(panel: Strip, derivative: Float[Tensor, "n n"]) -> Rates:
    """Rates of the frame (T1, U1, V1 = eta) along the panel's upper edge."""
    bend = panel.bend
    return Rates(
        speed=panel.next_speed,
        k1=panel.spin - apply_row(derivative, panel.beta),
        k2=-bend * torch.cos(panel.beta),
        w=-bend * torch.sin(panel.beta),
    )


def turned(first: Vectors, second: Vectors, angle: Values) -> tuple[Vectors, Vectors]:
    """Two unit vectors at right angles, turned from the first towards the second."""
    sine, cosine = torch.sin(angle)[..., None], torch.cos(angle)[..., None]
    return first * cosine + second * sine, second * cosine - first * sine
