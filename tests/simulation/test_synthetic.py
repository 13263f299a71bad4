from __future__ import annotations

import numpy as np
import torch
from scipy import stats

from brafit.cup.shape import CupShape
from brafit.simulation.synthetic import PAPER_RADIUS, on_panels, quarter_sphere


def cylinder_cup(n: int = 41) -> CupShape:
    """Two panels on a cylinder of radius 1 about the z axis, over the angles 0 to pi/2: heights 0, 1 + s, then 5 - s.

    The heights are functions of the angle s, so the rulings are vertical and the areas are known: 0.5 pi + pi^2/8 and
    2 pi - pi^2/4.
    """
    s = (1 - torch.cos(torch.linspace(0, torch.pi, n, dtype=torch.float64))) * torch.pi / 4
    zero, one = torch.zeros_like(s), torch.ones_like(s)
    heights = torch.stack([zero, 1 + s, 5 - s])
    slopes = torch.stack([zero, one, -one])
    ring = torch.stack([torch.cos(s), torch.sin(s)], dim=-1).expand(3, n, 2)
    turn = torch.stack([-torch.sin(s), torch.cos(s)], dim=-1).expand(3, n, 2)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(2, n, 3)
    return CupShape(
        stations=s,
        edges=torch.cat([ring, heights[..., None]], dim=-1),
        tangents=torch.cat([turn, slopes[..., None]], dim=-1),
        directions=up,
        normals=torch.cat([ring[:2], torch.zeros(2, n, 1, dtype=torch.float64)], dim=-1),
        geodesic=torch.zeros(2, n, dtype=torch.float64),
    )


def test_quarter_sphere_lies_on_its_sphere_in_its_quarter():
    points = quarter_sphere(2000, PAPER_RADIUS, np.random.default_rng(0))
    assert points.shape == (2000, 3)
    assert points.dtype == torch.float64
    centre = torch.tensor([0.0, PAPER_RADIUS, 0.0], dtype=torch.float64)
    torch.testing.assert_close((points - centre).norm(dim=1), torch.full((2000,), PAPER_RADIUS, dtype=torch.float64))
    assert (points[:, [0, 2]] > 0).all()


def test_quarter_sphere_is_uniform():
    # Archimedes: every coordinate of a uniform point on a sphere is itself uniform.
    points = quarter_sphere(4000, 2.0, np.random.default_rng(1)).numpy() / 2.0
    for column, low, width in ((points[:, 0], 0, 1), (points[:, 1], 0, 2), (points[:, 2], 0, 1)):
        assert stats.kstest(column, stats.uniform(low, width).cdf).pvalue > 0.01


def test_generators_make_it_repeatable():
    for make in (lambda g: quarter_sphere(5, 1.0, g), lambda g: on_panels(cylinder_cup(), 5, g)):
        torch.testing.assert_close(make(np.random.default_rng(7)), make(np.random.default_rng(7)), rtol=0, atol=0)


def test_points_lie_on_the_panels():
    points = on_panels(cylinder_cup(), 3000, np.random.default_rng(2)).numpy()
    assert points.shape == (3000, 3)
    # Cubic interpolation: h^4/384 with h = 0.062 between the widest stations.
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 1, atol=1e-7)
    assert points[:, 2].min() > 0
    assert (points[:, 2] <= 5 - np.arctan2(points[:, 1], points[:, 0]) + 1e-6).all()


def test_points_on_panels_are_uniform_by_area():
    points = on_panels(cylinder_cup(), 6000, np.random.default_rng(3)).numpy()
    angle, height = np.arctan2(points[:, 1], points[:, 0]), points[:, 2]
    lower, total = np.pi / 2 + np.pi**2 / 8, 5 * np.pi / 2 - np.pi**2 / 8
    share = stats.binomtest(int((height < 1 + angle).sum()), 6000, lower / total)
    assert share.pvalue > 0.01
    # Area up to angle a is 5 a - a^2 / 2, and at a given angle heights are uniform over 0 to 5 - a.
    assert stats.kstest((5 * angle - angle**2 / 2) / total, "uniform").pvalue > 0.01
    assert stats.kstest(height / (5 - angle), "uniform").pvalue > 0.01
