from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
import torch
from cups import lune_frames, near
from lunes import lune_cup
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from brafit.cup.edge_gaps import (
    gaps_to_line,
    gaps_to_points,
    nearest_on_polyline,
    polyline_points,
)
from brafit.cup.shape import CupShape
from brafit.geometry.panels import sample_table


def line(batch: int = 2, count: int = 9) -> torch.Tensor:
    return torch.randn(batch, count, 3, dtype=torch.float64).cumsum(1)


def cups(batch: int = 2) -> CupShape:
    cup = lune_frames(batch)
    return cup.shape_of(near(cup)).map(torch.Tensor.detach)


def moved(shape: CupShape, amount: float, step: tuple[torch.Tensor, torch.Tensor]) -> CupShape:
    """The shape with edges and tangents moved by independent amounts."""
    edges, tangents = shape.edges + amount * step[0], shape.tangents + amount * step[1]
    return CupShape(shape.stations, edges, tangents, shape.directions, shape.normals, shape.geodesic)


def outside_points(batch: int = 2, count: int = 25) -> torch.Tensor:
    return torch.randn(batch, count, 3, dtype=torch.float64) + torch.tensor([0.5, 1.0, 0.5], dtype=torch.float64)


def test_nearest_on_a_polyline_equals_dense_sampling():
    curve, points = line(), 3 * torch.randn(2, 25, 3, dtype=torch.float64)
    ours = (points - polyline_points(curve, *nearest_on_polyline(points, curve))).norm(dim=-1)
    t = torch.linspace(0, 1, 2001, dtype=torch.float64)[:, None]
    for b in range(2):
        dense = torch.cat([torch.lerp(p, q, t) for p, q in itertools.pairwise(curve[b])])
        nearest = torch.cdist(points[b], dense).amin(1)
        assert (ours[b] <= nearest + 1e-12).all()
        np.testing.assert_allclose(ours[b], nearest, atol=1e-5)


def test_repeated_points_of_a_line_do_no_harm():
    curve = line()
    points = torch.randn(2, 5, 3, dtype=torch.float64)
    repeated = curve.repeat_interleave(2, dim=1)
    plain = polyline_points(curve, *nearest_on_polyline(points, curve))
    torch.testing.assert_close(polyline_points(repeated, *nearest_on_polyline(points, repeated)), plain)


def test_gaps_to_a_line_have_the_distances_of_the_edges_samples():
    shape, curve = cups(), line()
    for edge in (0, 1, -1):
        points = shape.edges[:, edge]
        expected = (points - polyline_points(curve, *nearest_on_polyline(points, curve))).norm(dim=-1)
        torch.testing.assert_close(gaps_to_line(shape, edge, curve).vectors.norm(dim=-1), expected)


def test_gaps_to_points_have_the_distances_from_the_edge_between_its_stations():
    shape, points = cups(), outside_points()
    for edge in (1, -1):
        own = gaps_to_points(shape, edge, points).vectors.norm(dim=-1)
        for b in range(2):
            curve = CubicHermiteSpline(shape.stations, shape.edges[b, edge], shape.tangents[b, edge])
            dense = np.linspace(0, math.pi, 2001)
            for p, distance in zip(points[b].numpy(), own[b].tolist(), strict=True):
                start = dense[np.linalg.norm(curve(dense) - p, axis=1).argmin()]
                low, high = max(start - 0.01, 0.0), min(start + 0.01, math.pi)
                ending: Any = minimize_scalar(
                    lambda s, curve=curve, p=p: np.linalg.norm(curve(s) - p), bounds=(low, high), method="bounded"
                )
                truth = min(ending.fun, np.linalg.norm(curve(low) - p), np.linalg.norm(curve(high) - p))
                assert distance == pytest.approx(truth, abs=2e-5)


@pytest.mark.parametrize("kind", ["line", "points"])
def test_gradients_of_the_gaps_are_those_of_the_distances(kind):
    """The envelope theorem, against central differences with a new search each time."""
    shape = cups()
    if kind == "line":
        fixed, gaps = line(), gaps_to_line
    else:
        fixed, gaps = outside_points(count=41), gaps_to_points
    weights = torch.rand(2, 41, dtype=torch.float64)
    wave = torch.randn(2, 3, 1, 3, dtype=torch.float64)  # smooth, so that the finite differences are exact enough
    s = shape.stations[:, None]
    step = wave * torch.sin(2 * s), 2 * wave * torch.cos(2 * s)
    zero = torch.zeros((), dtype=torch.float64, requires_grad=True)

    def value(at) -> torch.Tensor:
        return (gaps(moved(shape, at, step), -1, fixed).vectors.square().sum(-1) * weights).sum()

    (gradient,) = torch.autograd.grad(value(zero), zero)
    h = 1e-6
    assert gradient.item() == pytest.approx(((value(h) - value(-h)) / (2 * h)).item(), rel=1e-6)


@pytest.mark.parametrize("edge", [0, 1, -1])
@pytest.mark.parametrize("kind", ["line", "points"])
def test_columns_are_the_derivatives_of_the_gaps(kind, edge):
    shape = cups()
    fixed, gaps = (line(), gaps_to_line) if kind == "line" else (outside_points(), gaps_to_points)
    step = torch.randn_like(shape.edges), torch.randn_like(shape.tangents)
    zero = torch.zeros((), dtype=torch.float64)
    expected = torch.func.jacrev(lambda a: gaps(moved(shape, a, step), edge, fixed).vectors)(zero)
    own = gaps(shape, edge, fixed).columns(sample_table(*step)[..., None])[..., 0]
    torch.testing.assert_close(own, expected)


def test_upper_edge_and_neckline_pull_both_ways():
    """A neckline that is half of the upper edge: the edge is off it, it is not off the edge."""
    shape = lune_cup(2, 101, 1.0).map(lambda v: v[None])
    half = shape.edges[:, -1, :51]
    edge, neckline = gaps_to_line(shape, -1, half).vectors, gaps_to_points(shape, -1, half).vectors
    torch.testing.assert_close(neckline, torch.zeros_like(neckline))
    torch.testing.assert_close(edge[:, :51], torch.zeros_like(edge[:, :51]))
    assert edge[:, -1].norm().item() == pytest.approx((half[0, -1] - shape.edges[0, -1, -1]).norm().item())
