"""Second derivatives of least distances, against central differences of first ones with feet found anew."""

from __future__ import annotations

import pytest
import torch
from cups import cloud, fixed, half_circle, near
from torch import Tensor

from brafit.cup import StripsCup
from brafit.cup.edge_gaps import gaps_to_points
from brafit.geometry.moving import moving_gaps
from brafit.geometry.nearest import nearest_feet


def cup() -> StripsCup:
    made = StripsCup(half_circle(), 2, 4, nodes=24)
    share = torch.tensor([[0.8, 1.5]], dtype=torch.float64)
    made.start(share, torch.ones_like(share))
    return fixed(made)


def to_cup(flat: Tensor, points: Tensor, weights: Tensor) -> Tensor:
    """Weighted sum of squared distances of points from the cup: inside panels, on ridges, beyond the rim."""
    shape = cup().sketch(flat)
    feet = nearest_feet(points.detach(), shape.edges.detach(), shape.tangents.detach(), shape.stations, 8)
    away = moving_gaps(points, shape.edges, shape.tangents, shape.stations, feet)
    return (weights * away.square().sum(-1)).sum()


def to_edge(flat: Tensor, points: Tensor, weights: Tensor) -> Tensor:
    """Of points from the upper edge."""
    gaps = gaps_to_points(cup().sketch(flat), -1, points, moving=True)
    return (weights * gaps.vectors.square().sum(-1)).sum()


@pytest.mark.parametrize("function", [to_cup, to_edge])
def test_second_derivatives_are_differences_of_first_ones(function):
    points, flat = cloud(60, 3)[None], near(cup(), 0.05, 2)
    weights = torch.rand(1, 60, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    random = torch.Generator().manual_seed(7)
    moves = [torch.randn(v.shape, generator=random, dtype=v.dtype) for v in (flat, points)]

    def first(step: float) -> list[Tensor]:
        at = [(v + step * m).requires_grad_() for v, m in zip((flat, points), moves, strict=True)]
        return list(torch.autograd.grad(function(*at, weights), at))

    at = [v.clone().requires_grad_() for v in (flat, points)]
    gradients = torch.autograd.grad(function(*at, weights), at, create_graph=True)
    second = torch.autograd.grad(gradients, at, grad_outputs=moves)
    step = 1e-5
    for found, up, down in zip(second, first(step), first(-step), strict=True):
        known = (up - down) / (2 * step)
        assert (found - known).norm() < 5e-5 * known.norm()  # as near as the feet are found


def test_feet_that_are_held_have_other_second_derivatives():
    """What the movement adds is not small: the test above can fail."""
    points, at = cloud(60, 3)[None], near(cup(), 0.05, 2).requires_grad_()

    def bends(moving: bool) -> Tensor:
        gaps = gaps_to_points(cup().sketch(at), -1, points, moving)
        (gradient,) = torch.autograd.grad(gaps.vectors.square().sum(), at, create_graph=True)
        return torch.autograd.grad(gradient.sum(), at)[0]

    assert (bends(True) - bends(False)).norm() > 0.05 * bends(True).norm()
