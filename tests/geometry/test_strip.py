from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.interpolate import BarycentricInterpolator

from brafit.geometry.products import apply, apply_row
from brafit.geometry.strip import Angle, Nodes, Rates, next_rates, roll, strip, turned

NODES = Nodes.of(64, math.pi)
S = torch.from_numpy(NODES.s)
INTEGRAL, DERIVATIVE = torch.from_numpy(NODES.integral), torch.from_numpy(NODES.derivative)


def circle_frame() -> tuple[torch.Tensor, ...]:
    """The half circle of radius 1 in z = 0 with V = +z and U towards its centre."""
    zero = torch.zeros_like(S)
    edge = torch.stack((torch.sin(S), 1 - torch.cos(S), zero), dim=-1)
    T = torch.stack((torch.cos(S), torch.sin(S), zero), dim=-1)
    V = torch.stack((zero, zero, zero + 1), dim=-1)
    return edge, T, torch.linalg.cross(V, T), V


def circle_rates() -> Rates:
    one, zero = torch.ones_like(S), torch.zeros_like(S)
    return Rates(one, one, zero, zero)


def test_operators_are_exact_on_polynomials():
    values = S**7
    assert torch.allclose(apply_row(DERIVATIVE, values), 7 * S**6, rtol=0, atol=1e-8)
    assert torch.allclose(apply_row(INTEGRAL, values), (S**8 - (math.pi / 2) ** 8) / 8, rtol=0, atol=1e-9)
    at = np.linspace(0, math.pi, 33)
    assert np.allclose(NODES.interpolation(at) @ values.numpy(), at**7, rtol=0, atol=1e-9)


@pytest.mark.parametrize("lean", [0.0, 0.6, math.pi / 2, 2.0])
def test_straight_rulings_on_a_circle_are_a_cone(lean):
    """All rulings at one angle from the circle's plane meet on its axis, in the cone's tip."""
    edge, _, U, V = circle_frame()
    zero = torch.zeros_like(S)
    phi = roll(circle_rates(), zero, torch.tensor(lean, dtype=torch.float64), INTEGRAL)
    assert torch.allclose(phi, zero + lean, rtol=0, atol=1e-14)
    panel = strip(circle_rates(), Angle.of(phi), Angle.of(zero), zero, zero + 0.25, zero)
    xi, _ = turned(U, V, panel.phi)
    upper = edge + 0.25 * xi
    assert torch.allclose(upper[:, 2], zero + 0.25 * math.sin(lean))
    radius = (upper - torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64))[:, :2].norm(dim=-1)
    assert torch.allclose(radius, zero + 1 - 0.25 * math.cos(lean))
    assert torch.allclose(panel.next_speed, 1 - 0.25 * math.cos(lean) + zero)
    rates = next_rates(panel, DERIVATIVE)
    assert torch.allclose(rates.k1, zero + math.cos(lean))  # a cone's circle turns by the same angle in the plane
    assert torch.allclose(rates.w, zero, atol=1e-14)


def wavy() -> tuple[Rates, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Rates and functions that vary, with a large rib angle."""
    rates = Rates(1 + 0.2 * torch.cos(S), 1 + 0.3 * torch.sin(2 * S), 0.4 * torch.cos(S), 0.2 * torch.sin(S))
    alpha = 1.1 * torch.sin(1.3 * S + 0.4)
    return rates, alpha, 1.1 * 1.3 * torch.cos(1.3 * S + 0.4), torch.tensor(0.9, dtype=torch.float64)


def test_roll_agrees_with_an_independent_integrator():
    rates, alpha, _, start = wavy()
    phi = roll(rates, torch.tan(alpha), start, INTEGRAL, iterations=12)

    def change(s, y):
        k1, k2, w = 1 + 0.3 * np.sin(2 * s), 0.4 * np.cos(s), 0.2 * np.sin(s)
        return -w - (k1 * np.sin(y) - k2 * np.cos(y)) * np.tan(1.1 * np.sin(1.3 * s + 0.4))

    ours = BarycentricInterpolator(NODES.s, phi.numpy())
    for end in (0.0, math.pi):
        other = solve_ivp(change, (math.pi / 2, end), [0.9], rtol=1e-12, atol=1e-12, method="DOP853").y[0, -1]
        assert float(ours(end)) == pytest.approx(other, abs=1e-9)


def test_roll_solves_its_equation_to_rounding():
    rates, alpha, _, start = wavy()
    with torch.no_grad():
        phi = roll(rates, torch.tan(alpha), start, INTEGRAL, iterations=12)
    change = -rates.w - (rates.k1 * torch.sin(phi) - rates.k2 * torch.cos(phi)) * torch.tan(alpha)
    assert (start + apply_row(INTEGRAL, change) - phi).abs().max() < 1e-13


def test_roll_differentiates_like_central_differences():
    rates, alpha, _, start = wavy()
    direction = torch.randn(5, 64, dtype=torch.float64) * torch.linspace(0, 1, 64, dtype=torch.float64)
    direction = apply_row(INTEGRAL, direction)
    turn = torch.randn((), dtype=torch.float64)

    def phi(h: float | torch.Tensor) -> torch.Tensor:
        moved = Rates(rates.speed, *(v + h * d for v, d in zip((rates.k1, rates.k2, rates.w), direction, strict=False)))
        return roll(moved, torch.tan(alpha + h * 0.1 * direction[3]), start + h * turn, INTEGRAL, iterations=12)

    h = 1e-5
    difference = (phi(h) - phi(-h)) / (2 * h)
    zero = torch.zeros((), dtype=torch.float64)
    forward = torch.func.jvp(phi, (zero,), (torch.ones_like(zero),))[1]
    assert torch.allclose(forward, difference, rtol=1e-6, atol=1e-6)


def test_rates_of_the_next_edge_are_the_derivatives_of_its_frame():
    """On the half circle, with rulings that lean and lengths that vary; every frame is differentiated numerically."""
    edge, T, U, V = circle_frame()
    alpha, alpha_slope = 0.4 * torch.sin(S), 0.4 * torch.cos(S)
    t, t_slope = 0.3 + 0.1 * torch.sin(2 * S), 0.2 * torch.cos(2 * S)
    phi = roll(circle_rates(), torch.tan(alpha), torch.tensor(1.0, dtype=torch.float64), INTEGRAL, iterations=12)
    panel = strip(circle_rates(), Angle.of(phi), Angle.of(alpha), alpha_slope, t, t_slope)
    xi, eta = turned(U, V, panel.phi)
    d_max, d = turned(T, xi, panel.alpha)
    upper = edge + t[:, None] * d
    tangent = apply(DERIVATIVE, upper)
    assert torch.allclose(tangent, panel.p[:, None] * d + panel.q[:, None] * d_max, rtol=0, atol=1e-9)
    U1, T1 = turned(d, d_max, panel.beta)
    assert torch.allclose(T1 * panel.next_speed[:, None], tangent, rtol=0, atol=1e-9)
    rates = next_rates(panel, DERIVATIVE)
    turning, rolling = apply(DERIVATIVE, T1), apply(DERIVATIVE, U1)
    for value, true in (
        (rates.k1, (turning * U1).sum(-1)),
        (rates.k2, (turning * eta).sum(-1)),
        (rates.w, (rolling * eta).sum(-1)),
    ):
        assert torch.allclose(value, true, rtol=0, atol=1e-8)
    # developable: the normal is at right angles to the upper edge too
    assert (tangent * eta).sum(-1).abs().max() < 1e-9
