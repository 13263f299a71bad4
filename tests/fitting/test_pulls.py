"""The scatter of the points' pulls: noise of known covariance, beside a misfit that is larger."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from brafit.fitting.pulls import Pulls
from brafit.geometry.panels import Feet

POINTS, COLUMNS, REPEATS = 900, 4, 12


def pulls_of(distances: Tensor, points: Tensor, weights: Tensor) -> Pulls:
    """Points above the plane z = 0 with derivatives that vary slowly over it."""
    count, (x, y, _) = len(points), points.T
    jacobian = torch.stack((torch.ones_like(x), x, y, torch.sin(2 * x) * y), dim=-1)
    whole = torch.zeros(count, dtype=torch.long)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(count, 3)
    nothing = torch.zeros(2, 2, 3, dtype=torch.float64)
    feet = Feet(whole, whole, torch.zeros_like(x), torch.zeros_like(x))
    table = torch.zeros(8, 3, COLUMNS)
    stations = torch.tensor([0.0, 1.0], dtype=torch.float64)
    slope = 2 * weights
    return Pulls(points, weights, feet, up, distances, slope, jacobian.float(), nothing, nothing, stations, table)


def cloud(seed: int) -> tuple[Tensor, Tensor, torch.Generator]:
    """Points of a square, weights that differ by a factor of up to 5, and more numbers by chance."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.rand(POINTS, 3, generator=generator, dtype=torch.float64)
    points[:, 2] *= 0.001
    weights = 0.2 + 0.8 * torch.rand(POINTS, generator=generator, dtype=torch.float64)
    return points, weights / weights.sum(), generator


def test_noise_is_seen_through_a_misfit_ten_times_as_large():
    """Unequal weights are no noise, nor is what is smooth: the covariance is that of the noise alone."""
    ratios = []
    for seed in range(REPEATS):
        points, weights, generator = cloud(seed)
        noise = 0.1 * torch.randn(POINTS, generator=generator, dtype=torch.float64)
        misfit = 1 + 0.7 * points[:, 0] - 0.4 * points[:, 1] + 0.2 * torch.cos(2 * points[:, 1])
        pulls = pulls_of(misfit + noise, points, weights)
        each = pulls.jacobian.double() * (0.1 * pulls.slope)[:, None]
        known = each.mT @ each
        half = torch.linalg.inv(torch.linalg.cholesky(known))
        ratios.append(torch.linalg.eigvalsh(half @ pulls.scatter().double() @ half.mT))
    ratio = torch.stack(ratios).mean(0)
    assert ((ratio > 0.8) & (ratio < 1.25)).all(), ratio


def test_what_is_affine_has_no_scatter():
    points, weights, _ = cloud(99)
    smooth = pulls_of(1 + 0.7 * points[:, 0] - 0.4 * points[:, 1], points, weights)
    wild = pulls_of(torch.where(torch.arange(POINTS) % 2 == 0, 1.0, -1.0).double(), points, weights)
    assert smooth.scatter()[0, 0] < 1e-4 * wild.scatter()[0, 0]


def test_scatter_is_that_of_the_step_where_the_derivatives_leap():
    """Shares of the surface on either side of a line, by counting: area-weighted sums of points drawn anew."""
    sums, foretold = [], []
    for seed in range(40):
        generator = torch.Generator().manual_seed(seed)
        side = 24
        grid = torch.stack(torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij"), dim=-1)
        points = (grid.reshape(-1, 2) + torch.rand(side**2, 2, generator=generator, dtype=torch.float64)) / side
        points = torch.cat((points, torch.zeros(side**2, 1, dtype=torch.float64)), dim=1)
        weights = torch.full((side**2,), 1.0 / side**2, dtype=torch.float64)
        step = (points[:, 0] < 0.5 + 0.3 / side + 0.2 * (points[:, 1] - 0.5)).double()
        pulls = pulls_of(step, points, weights)
        sums.append((2 * weights * step).sum())
        foretold.append(pulls.scatter()[0, 0].double().sqrt())
    ratio = torch.stack(foretold).mean() / torch.stack(sums).std()
    assert 0.7 < ratio < 1.6, ratio


def test_points_in_a_row_have_a_scatter_too():
    """No plane is known through them; it is that of a line."""
    count = 200
    points = torch.zeros(count, 3, dtype=torch.float64)
    points[:, 0] = torch.linspace(0, 1, count, dtype=torch.float64)
    weights = torch.full((count,), 1 / count, dtype=torch.float64)
    noise = torch.randn(count, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    found = pulls_of(5 + 3 * points[:, 0] + noise, points, weights).scatter()[0, 0].item()
    assert found == pytest.approx(4 / count, rel=0.4)
    same = pulls_of(noise, torch.zeros_like(points), weights).scatter()
    assert bool(same.isfinite().all())


def test_too_few_points_tell_nothing():
    points, weights, _ = cloud(1)
    assert not pulls_of(points[:5, 0], points[:5], weights[:5]).scatter().any()
