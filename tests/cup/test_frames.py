from __future__ import annotations

import math

import pytest
import torch
from cups import half_circle, lune_frames, lune_start, near
from lunes import lune_cup
from torch import nn

from brafit.cup import FramesCup, Wire
from brafit.geometry.developable import curvature_vector, geodesic_curvature, twist_determinant
from brafit.geometry.grid import sliding_derivative


@pytest.fixture(params=[1, 2, 3], ids="panels={}".format)
def panels(request: pytest.FixtureRequest) -> int:
    return request.param


def test_parameters_are_named(panels):
    cup = lune_frames(2, panels, terms=5)
    assert isinstance(cup, nn.Module)
    shapes = {name: tuple(p.shape) for name, p in cup.named_parameters()}
    assert shapes == {"coefficients": (2, panels, 3, 5), "turn": (2, panels, 3)}
    assert cup.size == panels * 18
    assert cup.batch == 2


def test_start_meets_the_ends_where_it_is_told(panels):
    wire = Wire.stack([Wire.from_arc(1.0, math.pi), Wire.from_arc(80.0, 150.0)])
    cup = FramesCup(wire, panels)
    angles = torch.linspace(0.3, 1.4, panels, dtype=torch.float64) + torch.tensor([[0.0], [0.1]])
    reaches = torch.linspace(0.9, 0.6, panels, dtype=torch.float64).expand(2, -1)
    cup.start(angles, reaches)
    shape = cup.shape_of(cup.flatten())
    assert shape.edges.shape == (2, panels + 1, 101, 3)
    assert shape.directions.shape == shape.normals.shape == (2, panels, 101, 3)
    end = shape.edges[:, :1, -1]
    torch.testing.assert_close(shape.edges[:, :, 0], torch.zeros_like(shape.edges[:, :, 0]))
    torch.testing.assert_close(shape.edges[:, :, -1], end.expand(-1, panels + 1, -1), rtol=0, atol=1e-12)
    torch.testing.assert_close(cup.closure(shape), torch.zeros(2, 3 * panels, dtype=torch.float64), rtol=0, atol=1e-12)
    middle = shape.edges[:, 1:, 50]
    torch.testing.assert_close(torch.atan2(middle[..., 2], middle[..., 0]), angles.expand(2, -1))
    torch.testing.assert_close(torch.hypot(middle[..., 0], middle[..., 2]), reaches)


def test_half_circles_make_the_known_developable_cup(panels):
    """Against the closed form: edges, rulings, normals, geodesic curvature; no twist."""
    cup, exact = lune_frames(1, panels, stations=101), lune_cup(panels, 101, 1.0)
    shape = cup.shape().map(lambda v: v[0])
    for name in ("stations", "edges", "tangents", "directions", "normals", "geodesic"):
        own, known = getattr(shape, name), getattr(exact, name)
        torch.testing.assert_close(own, known, rtol=0, atol=1e-9, msg=lambda m, name=name: f"{name}: {m}")
    constraints = cup.constraints(cup.shape_of(cup.flatten()))
    assert set(constraints) == {"ends", "twist"}
    for value in constraints.values():
        torch.testing.assert_close(value, torch.zeros_like(value), rtol=0, atol=1e-9)


def test_tangents_and_geodesic_curvature_are_those_of_the_edges(panels):
    cup = lune_frames(1, panels, stations=201)
    shape = cup.shape_of(near(cup))
    first = sliding_derivative(shape.edges, shape.stations)
    torch.testing.assert_close(shape.tangents, first, rtol=0, atol=1e-6)
    second = sliding_derivative(shape.tangents, shape.stations)
    lower = shape.tangents[:, :-1]
    bend = geodesic_curvature(lower, curvature_vector(lower, second[:, :-1]), shape.directions)
    torch.testing.assert_close(shape.geodesic, bend, rtol=0, atol=1e-5)


def test_constraints_measure_gap_and_mean_square_twist(panels):
    cup = lune_frames(2, panels)
    shape = cup.shape_of(near(cup))
    named = cup.constraints(shape)
    gaps = shape.edges[:, 1:, -1] - shape.edges[:, :1, -1]
    torch.testing.assert_close(named["ends"].square().sum(1), gaps.square().sum((1, 2)))
    twist = twist_determinant(shape.tangents[:, :-1], shape.tangents[:, 1:], shape.directions)[..., 1:-1]
    torch.testing.assert_close(named["twist"].square().sum(1), twist.square().mean((1, 2)))
    assert named["twist"].square().sum(1).min() > 1e-5


def test_select_takes_cups_out_of_a_batch(panels):
    wire = Wire.stack([Wire.from_arc(1.0, math.pi), Wire.from_arc(1.0, 2.5), Wire.from_omega((0.1, 1.0, 0.1), 2.5)])
    cup = lune_start(FramesCup(wire, panels, 5, 33, "fourier"))
    cup.load_flat(near(cup))
    whole, index = cup.shape_of(cup.flatten()), torch.tensor([2, 0, 2])
    part = cup.select(index)
    assert part.basis == "fourier"
    for name in ("edges", "tangents", "directions", "normals", "geodesic"):
        assert torch.equal(getattr(part.shape_of(part.flatten()), name), getattr(whole, name)[index])


@pytest.mark.parametrize("basis", ["cosine", "fourier", "chebyshev"])
def test_constant_rates_are_fair_in_every_basis(basis):
    cup = lune_start(FramesCup(half_circle(), 2, 6, 33, basis))
    flat = cup.flatten()
    torch.testing.assert_close(cup.unfairness(flat), torch.zeros_like(flat))
    assert cup.unfairness(near(cup)).square().sum() > 0.01


def test_errors():
    with pytest.raises(ValueError, match="at least 1 panel, got 0"):
        FramesCup(half_circle(), panels=0)
    with pytest.raises(ValueError, match="at least 9 stations, got 8"):
        FramesCup(half_circle(), stations=8)
    with pytest.raises(ValueError, match="at least 1 term"):
        FramesCup(half_circle(), terms=0)
    with pytest.raises(ValueError, match="unknown Ritz basis"):
        FramesCup(half_circle(), basis="spline")
