"""The objective with all its second derivatives, and Newton's way to its optimum."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch
from cups import cloud, half_circle, near

from brafit.cup import StripsCup
from brafit.fitting import Conditions, Target
from brafit.fitting.implicit import Data, Problem, at_optimum, polished
from brafit.fitting.objective import WEIGHTS, Objective, Pressure
from brafit.fitting.targets import Targets

MODEL = partial(StripsCup, panels=2, terms=4, stations=41, nodes=24, output_nodes=24)
ALL = Conditions(points_width=5.0, connection=0.05, ridge_apex=0.03, margin=0.9, margin_width=0.1, fairness=100.0)
SCALE = 80.0


def problem(condition: Conditions = ALL, neckline: bool = True, batch: int = 2) -> Problem:
    """Clouds in a thick shell about the cups: residuals are large, and points lie beyond the rim and on ridges."""
    cup = MODEL(half_circle(batch))
    share = torch.tensor([[0.8, 1.5]], dtype=torch.float64).expand(batch, -1)
    cup.start(share, torch.ones_like(share))
    shape = cup.sketch(near(cup, 0.05, 8)).map(lambda v: SCALE * v.detach())
    targets = []
    for k in range(batch):
        points, line = SCALE * cloud(60 + 20 * k, k).numpy(), shape.edges[k, -1].numpy()
        strap, apex = line[12] + (4.0, -3.0, 2.0), shape.edges[k, 1, 10].numpy() + 2.0
        targets.append(Target(str(k), points, SCALE * cup.wire.sample(cup.stations)[k].numpy(), line, strap, apex))
    if not neckline:
        targets = [replace(t, neckline=None, strap_point=None) for t in targets]
    stacked = Targets.stack(targets, torch.full((batch,), SCALE, dtype=torch.float64))
    objective = Objective(cup, stacked, condition)
    return Problem.of(objective, Pressure(1.0, barrier=torch.full((batch, 1), 3.0).double()), Data.of(objective))


CASES = [
    (ALL, True),
    (replace(ALL, points="l1"), True),
    (replace(ALL, points="robust"), True),
    (ALL, False),
]


@pytest.mark.parametrize(("condition", "neckline"), CASES, ids=["l2", "l1", "robust", "rim"])
def test_the_hessian_is_differences_of_the_gradient_that_solvers_use(condition, neckline):
    """Its feet are found anew at every place."""
    own = problem(condition, neckline)
    flat, step = near(own.objective.cup, 0.04, 3), 1e-5
    value, gradient, matrix = own.hessian(flat)
    plain = Objective(own.objective.cup, own.objective.targets, condition)
    here = plain.evaluate(flat, own.pressure)
    torch.testing.assert_close(value, here.value, rtol=1e-12, atol=0)
    unasked = own.unasked(flat)
    torch.testing.assert_close(gradient, here.gradient.masked_fill(unasked, 0.0), rtol=1e-9, atol=1e-12)
    random = torch.Generator().manual_seed(2)
    for _ in range(3):
        along = torch.randn(flat.shape, generator=random, dtype=flat.dtype).masked_fill(unasked, 0.0)
        up, down = (plain.evaluate(flat + sign * step * along, own.pressure).gradient for sign in (1, -1))
        known = ((up - down) / (2 * step)).masked_fill(unasked, 0.0)
        found = (matrix @ along[..., None])[..., 0]
        assert ((found - known).norm(dim=1) < 1e-6 * known.norm(dim=1)).all()


@pytest.mark.parametrize("neckline", [True, False])
def test_every_block_has_a_weight_and_no_name_is_vain(neckline):
    """Of every objective: a new condition that no weight knows would fail here."""
    own = problem(neckline=neckline)
    flat = near(own.objective.cup, 0.04, 3)
    shape = own.objective.cup.sketch(flat)
    blocks = own.objective.blocks(flat, shape, own.pressure, shape.margin, own.objective.cup.unfairness(flat))
    assert {block.condition for block in blocks} <= set(WEIGHTS)
    if neckline:
        assert set(WEIGHTS) - {block.condition for block in blocks} == {"points", "rim"}


def test_newtons_method_ends_where_the_solvers_gradient_vanishes():
    own = problem()
    start = near(own.objective.cup, 0.04, 3)
    found = polished(own, start)
    assert bool(found.settled.all())
    plain = Objective(own.objective.cup, own.objective.targets, ALL)
    before, after = (plain.evaluate(flat, own.pressure) for flat in (start, found.flat))
    assert (after.value < before.value).all()
    assert after.gradient.abs().max() < 1e-5 * before.gradient.abs().max()  # but for the edges' feet
    again = polished(own, found.flat)
    assert again.steps == 0


def test_what_is_no_optimum_has_no_derivatives():
    """At a place where the objective bends down, they are nan, not numbers that mean nothing."""
    own = problem()
    leaf = replace(own.data, points=own.data.points.clone().requires_grad_())
    asked = Problem.of(own.objective, own.pressure, leaf)
    optimum = polished(own, near(own.objective.cup, 0.04, 3), steps=0)
    assert not bool(optimum.settled.any())
    down, up = optimum.hessian
    bent = replace(optimum, hessian=torch.stack((-(down @ down), up @ up)))
    at_optimum(asked, bent).sum().backward()
    gradient = leaf.points.grad
    assert gradient is not None
    assert gradient[0].isnan().all()
    assert gradient[1].isfinite().all()
