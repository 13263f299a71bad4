"""What the Gauss-Newton matrix lacks: creases against differences of the gradient over many points, bends against the
full Hessian.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from cups import plain_strips
from torch import Tensor

from brafit.cup import StripsCup
from brafit.cup.base import Linearised
from brafit.fitting import Conditions, Target
from brafit.fitting.implicit import Data, Problem
from brafit.fitting.normal import PointRows, normal_equations
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.pulls import Pulls
from brafit.fitting.stiffness import _SOFTEST, bends, creases, softened, spanned
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import on_panels

PRESSURE = Pressure(1.0)


def below(cup: StripsCup, count: int, share: float, seed: int) -> Objective:
    """A cloud like the first cup of a batch, smaller: its ridge lies below the cup's."""
    truth = cup.shape_of(cup.flatten().detach()).map(lambda v: v[0])
    points = on_panels(truth, count, np.random.default_rng(seed)).numpy()
    middle = points.mean(axis=0) * (0, 1, 0)
    wire, line = truth.edges[0].numpy(), truth.edges[-1].numpy()
    target = Target("below", middle + share * (points - middle), wire, line, None, None)
    targets = Targets.stack([target] * cup.batch, torch.ones(cup.batch, dtype=torch.float64))
    return Objective(cup, targets, Conditions(neckline=0.02, neckline_limit=None, fairness=0.7))


def creases_of(objective: Objective, linear: Linearised) -> Tensor:
    """In the order of the parameters."""
    problems = slice(0, objective.cup.batch)
    rows = PointRows.of(objective, linear, None, problems)
    order = linear.columns.argsort()
    found = creases(list(Pulls.each(objective, linear, rows, problems)))
    return torch.stack(found).double()[:, order][..., order]


def test_creases_and_bends_are_what_differences_of_the_gradient_show():
    """Along the two directions that creases soften most, as one cloud has them, over changes that let many points of
    another cloud leap.
    """
    cup = plain_strips()
    flat, linear = cup.flatten().detach(), cup.linearise(cup.flatten().detach())
    one, other = (below(cup, 8000, 0.93, seed) for seed in (1, 2))
    half = torch.linalg.inv(torch.linalg.cholesky(normal_equations(one, flat, PRESSURE).matrix[0])).mT
    soft = half @ torch.linalg.eigh(half.mT @ creases_of(one, linear)[0] @ half).eigenvectors[:, :2]
    matrix, crease = normal_equations(other, flat, PRESSURE).matrix[0], creases_of(other, linear)[0]
    for change in (0.01 * soft / soft.norm(dim=0)).unbind(-1):
        there, back = (normal_equations(other, flat + sign * change, PRESSURE).gradient[0] for sign in (2, -2))
        stiff = change @ matrix @ change
        seen = (there - back) @ change / 4 / stiff - 1
        bent = bends(other, flat, PRESSURE, linear, change[None, :, None])[0, :, 0] @ change / stiff
        leaping = change @ crease @ change / stiff
        assert leaping < -0.19
        assert bent > 0.2
        torch.testing.assert_close(leaping + bent, seen, rtol=0, atol=0.15)


def test_no_point_outside_a_convex_ridge_leaps():
    """In the middle of the cup, and below the ridge many do. Towards the ends the ridge of this cup is hollow."""
    cup = plain_strips()
    linear = cup.linearise(cup.flatten().detach())
    found = {}
    for share in (1.02, 0.98):
        objective = below(cup, 3000, share, 3)
        targets = objective.targets
        middle = (targets.points[0, :, 0] > 0.7).nonzero()[:, 0]
        cloud = {name: getattr(targets, name)[:, middle] for name in ("points", "weights", "data")}
        assert len(middle) > 500
        found[share] = creases_of(objective.on(cup, replace(targets, **cloud)), linear)
    assert not found[1.02].any()
    assert found[0.98].diagonal(dim1=-2, dim2=-1).amin() < 0


def test_bends_are_the_full_hessian_less_the_gauss_newton_matrix():
    """Of a cup of one panel, which has no ridge, and few points, which are all seen."""
    cup = plain_strips(panels=1)
    flat = cup.flatten().detach()
    objective = below(cup, 380, 0.93, 4)
    full = Problem.of(objective, PRESSURE, Data.of(objective)).hessian(flat)[2][0]
    plain = normal_equations(objective, flat, PRESSURE).matrix[0]
    generator = torch.Generator().manual_seed(0)
    changes = 1e-4 * torch.randn(1, cup.size, 3, generator=generator, dtype=torch.float64)
    changes[:, cup.corner_place] = 0
    found = bends(objective, flat, PRESSURE, cup.linearise(flat), changes)[0]
    known = (full - plain) @ changes[0]
    assert (known.norm(dim=0) > 0.01 * (plain @ changes[0]).norm(dim=0)).all()
    assert ((found - known).norm(dim=0) < 0.03 * known.norm(dim=0)).all()


def symmetric(size: int, seed: int) -> Tensor:
    values = torch.randn(size, size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return values + values.mT


def test_a_matrix_that_is_spanned_has_the_products_asked_for():
    matrix, missing = symmetric(9, 1) @ symmetric(9, 1) + torch.eye(9), symmetric(9, 2)
    directions = torch.randn(9, 2, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    found = spanned(matrix, directions, missing @ directions)
    torch.testing.assert_close(found @ directions, missing @ directions)
    torch.testing.assert_close(found, found.mT)


def test_a_softened_matrix_is_inverted_and_keeps_a_share_of_its_stiffness():
    matrix = symmetric(9, 1) @ symmetric(9, 1) + torch.eye(9)
    factor = torch.linalg.cholesky(matrix)
    little = 0.05 * symmetric(9, 2)
    torch.testing.assert_close(softened(factor, little), torch.linalg.inv(matrix + little))
    gone = -2 * matrix
    torch.testing.assert_close(softened(factor, gone), torch.linalg.inv(matrix) / _SOFTEST)
