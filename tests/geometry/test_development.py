from __future__ import annotations

import math

import pytest
import torch
from surfaces import LENSES, Panel, cone, cylinder, panel, stations

from brafit.geometry.development import FlatPanel, arc_lengths, develop


def laid_flat(p: Panel) -> FlatPanel:
    return develop(p.s, p.lower_tangent.norm(dim=-1), p.omega[:, 1], p.rib, p.lengths)


@pytest.fixture(params=LENSES)
def exact(request: pytest.FixtureRequest) -> Panel:
    return LENSES[request.param](stations(201))


def test_flat_panels_are_the_known_ones(exact):
    flat = laid_flat(exact)
    torch.testing.assert_close(flat.lower, exact.flat_lower, rtol=0, atol=1e-9)
    torch.testing.assert_close(flat.upper, exact.flat_upper, rtol=0, atol=1e-9)


def test_chord_lies_on_the_v_axis_24(exact):
    lower = laid_flat(exact).lower
    assert torch.equal(lower[0], torch.zeros(2, dtype=torch.float64))
    assert lower[-1, 0] > 0
    assert abs(lower[-1, 1].item()) < 1e-12


def test_lengths_and_angles_are_kept(exact):
    flat = laid_flat(exact)
    for curve, space in ((flat.lower, exact.lower), (flat.upper, exact.upper)):
        torch.testing.assert_close(arc_lengths(curve, exact.s), arc_lengths(space, exact.s), rtol=0, atol=1e-8)
    ruling = flat.upper - flat.lower
    torch.testing.assert_close(ruling.norm(dim=-1), exact.lengths)
    inner = slice(1, -1)
    step, flat_step = exact.lower_tangent[inner], flat.lower[2:] - flat.lower[:-2]
    angle = torch.acos((step * exact.directions[inner]).sum(-1) / step.norm(dim=-1))
    own = (flat_step * ruling[inner]).sum(-1) / flat_step.norm(dim=-1) / ruling[inner].norm(dim=-1)
    torch.testing.assert_close(torch.acos(own), angle, rtol=0, atol=1e-3)


def test_a_cone_becomes_a_sector():
    """Between the circles at distances 2 and 1.2 from the apex: concentric arcs of those radii, one plane angle."""
    half_angle, turn = 0.5, 4.0
    s = torch.linspace(0, turn * math.sin(half_angle), 101, dtype=torch.float64)
    flat = laid_flat(panel(cone(half_angle), s, lambda s: s, lambda s: 2 + 0 * s, lambda s: 1.2 + 0 * s))
    angle = s[-1].item()
    centre = torch.tensor([2 * math.sin(angle / 2), 2 * math.cos(angle / 2)], dtype=torch.float64)
    for arc, radius in ((flat.lower, 2.0), (flat.upper, 1.2)):
        torch.testing.assert_close((arc - centre).norm(dim=-1), torch.full_like(s, radius))
        chord = (arc[-1] - arc[0]).norm().item()
        assert chord == pytest.approx(2 * radius * math.sin(angle / 2), rel=1e-12)


def test_a_cylinder_becomes_a_rectangle():
    s = stations(31)
    flat = laid_flat(panel(cylinder(1.7), s, lambda s: s, lambda s: 0 * s, lambda s: 0.9 + 0 * s))
    torch.testing.assert_close(flat.lower, torch.stack((1.7 * s, 0 * s), dim=-1))
    torch.testing.assert_close(flat.upper, torch.stack((1.7 * s, 0.9 + 0 * s), dim=-1))


def test_batch_type_and_gradients(dtype):
    s = stations(21, dtype)
    speed, geodesic, rib, lengths = torch.rand(4, 2, 3, 21, dtype=dtype)
    flat = develop(s, speed, geodesic, rib, lengths)
    assert flat.upper.shape == (2, 3, 21, 2)
    assert flat.upper.dtype == dtype
    own = develop(s, speed[1, 2], geodesic[1, 2], rib[1, 2], lengths[1, 2])
    torch.testing.assert_close(flat.upper[1, 2], own.upper)
    if dtype == torch.float64:
        inputs = [x[0, 0, :9].clone().requires_grad_() for x in (speed, geodesic, rib, lengths)]
        assert torch.autograd.gradcheck(lambda *x: develop(s[:9], *x).upper, inputs)


def test_arc_length_of_a_circle_and_a_helix():
    s = stations(101)
    circle = 1.5 * torch.stack((torch.cos(s), torch.sin(s)), dim=-1)
    torch.testing.assert_close(arc_lengths(circle, s), 1.5 * s, rtol=0, atol=1e-10)
    helix = torch.stack((torch.cos(s), torch.sin(s), 0.75 * s), dim=-1)
    torch.testing.assert_close(arc_lengths(helix, s), 1.25 * s, rtol=0, atol=1e-10)
