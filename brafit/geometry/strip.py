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
needs scalar functions only. Derived in docs/formulation.md, (64)-(66).

Functions of s are sampled on Chebyshev nodes. Matrices are applied problem by problem, so that rounding does not
depend on the batch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.developable import heading
from brafit.geometry.grid import (
    chebyshev_analysis,
    chebyshev_derivative,
    chebyshev_integral,
    chebyshev_points,
    chebyshev_synthesis,
)
from brafit.geometry.products import apply, apply_row

Values = Float[Tensor, "*batch n"]
Vectors = Float[Tensor, "*batch n 3"]


@dataclass(frozen=True)
class Nodes:
    """Operators on functions sampled at n Chebyshev-Lobatto nodes of [0, length].

    Attributes:
        s: the nodes.
        derivative: values -> derivatives by s.
        integral: values -> integrals from the middle of the interval.
    """

    s: Float[np.ndarray, " n"]
    derivative: Float[np.ndarray, "n n"]
    integral: Float[np.ndarray, "n n"]

    @staticmethod
    @lru_cache(maxsize=16)
    def of(n: int, length: float) -> "Nodes":
        """n nodes on [0, length]."""
        half = length / 2
        integral = chebyshev_integral(n)
        to_middle = chebyshev_synthesis(n, np.zeros(1)) @ chebyshev_analysis(n) @ integral
        return Nodes((chebyshev_points(n) + 1) * half, chebyshev_derivative(n) / half, (integral - to_middle) * half)

    def interpolation(self, s: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m n"]:
        """Values at the nodes -> values at s."""
        x = 2 * s / self.s[-1] - 1
        return _interpolation(len(self.s), x.clip(-1, 1).tobytes())


@lru_cache(maxsize=16)
def _interpolation(n: int, x: bytes) -> Float[np.ndarray, "m n"]:
    """Values at n Chebyshev points -> values at x. Every cup asks for the same."""
    return chebyshev_synthesis(n, np.frombuffer(x)) @ chebyshev_analysis(n)


@dataclass(frozen=True)
class Rates:
    """Rates of a reference frame along an edge, per s."""

    speed: Values
    k1: Values
    k2: Values
    w: Values


@dataclass(frozen=True)
class Angle:
    """An angle in radians with its sine and cosine."""

    value: Values
    sine: Values
    cosine: Values

    @staticmethod
    def of(value: Values) -> "Angle":
        return Angle(value, torch.sin(value), torch.cos(value))

    @property
    def tangent(self) -> Values:
        return self.sine / self.cosine


@dataclass(frozen=True)
class Strip:
    """Scalars of one panel along its lower edge, as the module's docstring names them."""

    phi: Angle
    alpha: Angle
    t: Values
    omega_xi: Values
    omega_eta: Values
    spin: Values
    p: Values
    q: Values
    beta: Angle
    speed: Values
    next_speed: Values

    @property
    def opening(self) -> Values:
        """A(0): how fast the rulings leave each other at the lower edge."""
        return self.speed * self.alpha.cosine

    @property
    def bend(self) -> Values:
        return self.omega_xi / self.alpha.cosine


def roll(
    rates: Rates,
    slope: Values,
    start: Float[Tensor, "*batch"],
    integral: Float[Tensor, "n n"],
    iterations: int = 8,
) -> Values:
    """phi along an edge, (64): solves phi = start + integral of -w - (k1 sin(phi) - k2 cos(phi)) slope by Newton's
    method.

    Each step's linear equation has an integrating factor, hence a closed form. The iterations run without gradients.
    A step all but squares the error (what the grid does not resolve leaves some of it): a problem's last one is that
    which begins with two thirds of the digits right. In grad mode two more make the result twice differentiable.

    Args:
        rates: of the edge's reference frame, per s.
        slope: tan(alpha).
        start: phi in the middle of the edge.
        integral: from `Nodes`.
        iterations: Newton steps at most.
    """
    equation = _Roll(rates.k1 * slope, rates.k2 * slope, rates.w, start[..., None], integral)
    with torch.no_grad():
        fixed = equation.detached()
        phi, running = fixed.start.expand_as(slope), None
        enough = torch.finfo(phi.dtype).eps ** (2 / 3)
        for _ in range(iterations):
            moved, residual = fixed.newton(phi)
            phi = moved if running is None else torch.where(running, moved, phi)
            wrong = residual.abs().amax(-1, keepdim=True) > enough
            running = wrong if running is None else running & wrong
            if not running.any():
                break
    if not torch.is_grad_enabled():
        return phi
    # from a fixed phi one step is right in its first derivatives; the next one, from there, in its second as well
    return equation.newton(equation.newton(phi)[0])[0]


@dataclass(frozen=True)
class _Roll:
    """The integral equation of `roll`: phi = start + integral of (b cos(phi) - a sin(phi) - w)."""

    a: Values
    b: Values
    w: Values
    start: Float[Tensor, "*batch 1"]
    integral: Float[Tensor, "n n"]

    def detached(self) -> "_Roll":
        return _Roll(*(v.detach() for v in (self.a, self.b, self.w, self.start, self.integral)))

    def newton(self, phi: Values) -> tuple[Values, Values]:
        """phi after one step, and the residual before it."""
        sine, cosine = torch.sin(phi), torch.cos(phi)
        change = torch.addcmul(self.b * cosine, self.a, sine, value=-1) - self.w
        rate = torch.addcmul(self.a * cosine, self.b, sine).detach()
        turned, growth = apply(self.integral, torch.stack((change, rate), dim=-1)).unbind(-1)
        residual = self.start + turned - phi
        factor = torch.exp(growth.detach().clamp(-40, 40))
        step = residual - apply_row(self.integral, factor * rate * residual) / factor
        return phi + step.clamp(-1, 1), residual


def strip(rates: Rates, phi: Angle, alpha: Angle, alpha_slope: Values, t: Values, t_slope: Values) -> Strip:
    """The panel on an edge, from its roll, rib angle and ruling length and the derivatives of the latter two by s.

    Args:
        rates: of the lower edge's reference frame, per s.
        phi: the roll, from `roll`.
        alpha: the rib angle.
        alpha_slope: its derivative by s.
        t: ruling lengths, in the unit of s.
        t_slope: their derivatives by s.
    """
    omega_xi = torch.addcmul(rates.k1 * phi.sine, rates.k2, phi.cosine, value=-1)
    omega_eta = torch.addcmul(rates.k1 * phi.cosine, rates.k2, phi.sine)
    spin = alpha_slope + omega_eta
    p = torch.addcmul(t_slope, rates.speed, alpha.sine, value=-1)
    q = torch.addcmul(rates.speed * alpha.cosine, t, spin, value=-1)
    speed = torch.addcmul(p * p, q, q).sqrt()
    beta = Angle(heading(-p, q, speed), -p / speed, q / speed)
    return Strip(phi, alpha, t, omega_xi, omega_eta, spin, p, q, beta, rates.speed, speed)


def next_rates(panel: Strip, derivative: Float[Tensor, "n n"]) -> Rates:
    """Rates of the frame (T1, U1, V1 = eta) along the panel's upper edge.

    Args:
        panel: from `strip`.
        derivative: from `Nodes`.
    """
    bend, beta = panel.bend, panel.beta
    return Rates(
        speed=panel.next_speed,
        k1=panel.spin - apply_row(derivative, beta.value),
        k2=-bend * beta.cosine,
        w=-bend * beta.sine,
    )


@dataclass(frozen=True)
class UpperTurn:
    """How a panel's upper edge turns: derivatives by s of spin, p, q and beta."""

    spin: Values
    p: Values
    q: Values
    beta: Values


def upper_turn(panel: Strip, t_slope: Values, t_second: Values, derivative: Float[Tensor, "n n"]) -> UpperTurn:
    """Derivatives along a panel's upper edge, from the first and second derivative of its ruling length.

    Only what is smooth is differentiated on the grid: a corner of the ruling length spoils nothing beside it.

    Args:
        panel: from `strip`.
        t_slope: first derivative of the ruling length by s.
        t_second: second derivative.
        derivative: from `Nodes`.
    """
    smooth = torch.stack((panel.speed * panel.alpha.sine, panel.opening, panel.spin), dim=-1)
    back, opening, spin = apply(derivative, smooth).unbind(-1)
    p = t_second - back
    q = opening - t_slope * panel.spin - panel.t * spin
    return UpperTurn(spin, p, q, (panel.p * q - panel.q * p) / panel.next_speed.square())


def turned(first: Vectors, second: Vectors, angle: Angle) -> tuple[Vectors, Vectors]:
    """Two unit vectors at right angles, turned from the first towards the second.

    Args:
        first: unit vectors.
        second: unit vectors at right angles to the first.
        angle: of the turn.
    """
    sine, cosine = angle.sine[..., None], angle.cosine[..., None]
    return torch.addcmul(first * cosine, second, sine), torch.addcmul(second * cosine, first, sine, value=-1)
