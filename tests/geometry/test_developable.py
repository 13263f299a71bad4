from __future__ import annotations

import math

import pytest
import torch
from surfaces import LENSES, Panel, cone, panel, stations

from brafit.geometry.developable import (
    Values,
    Vectors,
    across,
    curvature_vector,
    dot,
    geodesic_curvature,
    normals,
    regularity,
    rib_angle,
    rulings,
    twist_angle,
    twist_determinant,
    unit,
)


@pytest.fixture(params=LENSES)
def exact(request: pytest.FixtureRequest) -> Panel:
    return LENSES[request.param](stations(41))


def close(a: torch.Tensor, b: torch.Tensor, atol: float = 1e-12) -> None:
    torch.testing.assert_close(a, b, rtol=0, atol=atol)


def rib_angle_from_omega(omega: Vectors) -> Values:
    """alpha with tan(alpha) = -omega_zeta / omega_xi, (12), in (-pi/2, pi/2)."""
    xi, _, zeta = omega.unbind(-1)
    return torch.atan2(-zeta * torch.sign(xi), xi.abs())


def omega_from_edge(tangent: Vectors, curvature: Vectors, direction: Vectors) -> Vectors:
    """Rates omega of the Darboux frame along an edge whose panel's rulings are `direction`, (19).

    Args:
        tangent: edge tangents (any length).
        curvature: curvature vector of the edge, d zeta / d arc length.
        direction: unit ruling directions.
    """
    zeta = unit(tangent)
    alpha = rib_angle(tangent, direction)
    bend = dot(torch.linalg.cross(curvature, zeta), direction) / torch.cos(alpha)
    return torch.stack((-bend, dot(curvature, direction) / torch.cos(alpha), bend * torch.tan(alpha)), dim=-1)


def test_rulings_with_their_limits_at_the_ends(exact):
    close(rulings(exact.lower, exact.upper, exact.lower_tangent, exact.upper_tangent), exact.directions)


def test_darboux_frame(exact):
    close(normals(exact.lower_tangent, exact.directions), exact.normals)
    zeta = unit(exact.lower_tangent)
    xi = across(exact.lower_tangent, exact.directions)
    close(xi, torch.linalg.cross(exact.normals, zeta))
    alpha = exact.rib[:, None]
    close(exact.directions, -zeta * torch.sin(alpha) + xi * torch.cos(alpha))


def test_rib_angle_from_the_ruling_18_and_from_the_rates_12(exact):
    close(rib_angle(exact.lower_tangent, exact.directions), exact.rib)
    close(rib_angle_from_omega(exact.omega), exact.rib)


def test_rates_of_an_edge_19(exact):
    curvature = curvature_vector(exact.lower_tangent, exact.lower_second)
    close(curvature, exact.curvature, atol=1e-11)
    close(omega_from_edge(exact.lower_tangent, curvature, exact.directions), exact.omega, atol=1e-11)
    close(geodesic_curvature(exact.lower_tangent, curvature, exact.directions), exact.omega[:, 1], atol=1e-11)


def test_principal_curvature_13(exact):
    xi, _, zeta = omega_from_edge(exact.lower_tangent, exact.curvature, exact.directions).unbind(-1)
    close(-(xi**2 + zeta**2) / xi, exact.principal, atol=1e-11)


def test_m_is_plus_omega_zeta():
    """(8) with the sign of (1), (2): M = xi' . eta, by central differences along a curve on a cone."""
    make, s, h = LENSES["cone, towards the apex"], stations(20)[1:-1], 1e-5

    def xi(s: torch.Tensor) -> torch.Tensor:
        p = make(s)
        return across(p.lower_tangent, p.directions)

    p = make(s)
    turning = (xi(s + h) - xi(s - h)) / (2 * h) / p.lower_tangent.norm(dim=-1, keepdim=True)
    own = omega_from_edge(p.lower_tangent, p.curvature, p.directions)[:, 2]
    close((turning * p.normals).sum(-1), own, atol=1e-8)
    assert own.abs().max() > 0.05


def test_developables_have_no_twist(exact):
    close(twist_determinant(exact.lower_tangent, exact.upper_tangent, exact.directions), torch.zeros_like(exact.s))
    close(twist_angle(exact.lower_tangent, exact.upper_tangent, exact.directions), torch.zeros_like(exact.s))


def test_regularity_margin(exact):
    """The surface's speed across a ruling is proportional to the distance from apex or edge of regression."""
    close(regularity(exact.lower_tangent, exact.upper_tangent, exact.directions), exact.margin)


@pytest.mark.parametrize("high", [0.5, 1e-3, -0.5])
def test_regularity_margin_is_linear_to_the_apex_and_negative_beyond(high):
    crossing = panel(cone(0.6), stations(9), lambda s: s, lambda s: 2 + 0 * s, lambda s: 2 * high + 0 * s)
    margin = regularity(crossing.lower_tangent, crossing.upper_tangent, crossing.directions)
    close(margin, torch.full_like(margin, high))


def test_twist_of_a_hyperbolic_paraboloid():
    """z = x y / c between y = 0 and y = w, ruled along y: both measures of its twist in closed form."""
    c, w = 1.5, 0.8
    s = torch.linspace(-1, 2, 13, dtype=torch.float64)
    zero, one = torch.zeros_like(s), torch.ones_like(s)
    lower_tangent = torch.stack((one, zero, zero), dim=-1)
    upper_tangent = torch.stack((one, zero, w / c * one), dim=-1)
    direction = torch.stack((zero, one, s / c), dim=-1) / torch.sqrt(1 + (s / c) ** 2)[:, None]
    lean, turn = 1 + (s / c) ** 2, w / c
    expected = torch.acos(torch.sqrt(lean / (lean + turn**2)))
    close(twist_angle(lower_tangent, upper_tangent, direction), expected)
    expected = -turn / torch.sqrt((1 + turn**2) * lean)
    close(twist_determinant(lower_tangent, upper_tangent, direction), expected)


def test_curvature_vector_for_any_parameter():
    """The circle of radius R run through with any speed: towards its centre, 1 / R long."""
    radius, t = 0.8, torch.linspace(0.2, 2, 11, dtype=torch.float64)
    sin, cos = torch.sin(t**2), torch.cos(t**2)
    zero = torch.zeros_like(t)
    first = 2 * t[:, None] * radius * torch.stack((-sin, cos, zero), dim=-1)
    second = radius * torch.stack((-2 * sin - 4 * t**2 * cos, 2 * cos - 4 * t**2 * sin, zero), dim=-1)
    close(curvature_vector(first, second), torch.stack((-cos, -sin, zero), dim=-1) / radius)


def test_unit_of_zero_is_zero_with_zero_gradient():
    v = torch.tensor([[0.0, 0.0, 0.0], [3.0, 0.0, 4.0]], dtype=torch.float64, requires_grad=True)
    u = unit(v)
    close(u.detach(), torch.tensor([[0.0, 0.0, 0.0], [0.6, 0.0, 0.8]], dtype=torch.float64))
    (gradient,) = torch.autograd.grad(u.sum(), v)
    assert torch.equal(gradient[0], torch.zeros(3, dtype=torch.float64))


def test_any_batch_shape_and_type(dtype):
    lower, upper = torch.randn(2, 2, 3, 7, 3, dtype=dtype)
    d = unit(torch.randn(2, 3, 7, 3, dtype=dtype))
    for function in (twist_angle, twist_determinant, regularity):
        values = function(lower, upper, d)
        assert values.dtype == dtype
        assert torch.equal(values[1, 2], function(lower[1, 2], upper[1, 2], d[1, 2]))


def test_gradients():
    lower, upper, d, bend = (torch.randn(4, 3, dtype=torch.float64, requires_grad=True) for _ in range(4))
    for function in (twist_angle, twist_determinant, regularity):
        assert torch.autograd.gradcheck(lambda a, b, c, f=function: f(a, b, unit(c)), (lower, upper, d))
    assert torch.autograd.gradcheck(lambda a, b, c: omega_from_edge(a, b, unit(c)), (lower, bend, d))


def test_rib_angle_of_a_right_angle_is_finite():
    """A ruling along the edge itself: rounding beyond 1 must not make it nan."""
    tangent = torch.tensor([[1.0, 1.0, 1.0]])
    alpha = rib_angle(tangent, -unit(tangent) * (1 + 1e-6))
    assert alpha.item() == pytest.approx(math.pi / 2)
