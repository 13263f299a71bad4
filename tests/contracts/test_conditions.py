"""What every condition promises: right derivatives, each scan as if alone, and no cost for a cup that meets it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from cups import cloud, plain_strips, varied
from edge_length import UpperEdgeLength, lengths
from style_line import RidgeBelowApex
from torch import Tensor
from tukey import Biweight

from brafit.cup import CupShape, StripsCup
from brafit.fitting import Condition, Conditions, Target
from brafit.fitting.condition import checked_conditions, measured_conditions
from brafit.fitting.implicit import Data, Problem
from brafit.fitting.loss import checked_loss, point_loss
from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import WEIGHTS, Objective, Pressure, weight_names
from brafit.fitting.targets import Targets

SCALE = 65.0
"""Millimetres per solver unit."""
NONE = Conditions(neckline=0.0, rim=0.0, connection=0.0, ridge_apex=0.0, barrier=0.0, fairness=0.0)
"""Only the points are left."""


@dataclass(frozen=True)
class Case:
    """A condition, and targets that a cup meets.

    Attributes:
        asked: with this condition alone, beside the points.
        met: of a cup's shape (mm) at the stations of the output and at those of the fit, what it meets: conditions and
            landmarks. None: no cup meets it wholly.
    """

    asked: Conditions
    met: Callable[[CupShape, CupShape], tuple[Conditions, dict[str, np.ndarray]]] | None


def own_edge(shape: CupShape) -> np.ndarray:
    return shape.edges[0, -1].numpy()


class FairRidge(Condition):
    """The ridge's middle lies in a plane: a condition without a name of its own, of several residuals, with a loss."""

    weight = 0.3
    loss = Biweight(200.0)

    def residuals(self, shape: CupShape, targets: Targets) -> Tensor:
        return shape.edges[:, 1, 20:28, 1] - 60.0


CASES = {
    "neckline": Case(
        replace(NONE, neckline=0.25), lambda fine, _: (replace(NONE, neckline=0.25), {"neckline": own_edge(fine)})
    ),
    "rim": Case(replace(NONE, rim=0.5), lambda *_: (replace(NONE, rim=0.5), {"neckline": np.eye(3)})),
    "connection": Case(
        replace(NONE, connection=0.02),  # of strips from the corner, which stands in the middle
        lambda fine, _: (replace(NONE, connection=0.02), {"strap_point": own_edge(fine)[100]}),
    ),
    "ridge_apex": Case(
        replace(NONE, ridge_apex=0.02),
        lambda fine, _: (replace(NONE, ridge_apex=0.02), {"apex": fine.edges[0, 1, 90].numpy()}),
    ),
    "barrier": Case(replace(NONE, barrier=1.0, margin=0.9), lambda *_: (replace(NONE, barrier=1.0, margin=-9.0), {})),
    "fairness": Case(replace(NONE, fairness=1e3), None),
    "upper edge length": Case(
        replace(NONE, extra=[UpperEdgeLength(230.0)]),
        lambda _, nodes: (replace(NONE, extra=[UpperEdgeLength(lengths(nodes)[0].item())]), {}),
    ),
    "ridge below apex": Case(
        replace(NONE, extra=[RidgeBelowApex(12.0)]),
        lambda _, nodes: (replace(NONE, extra=[RidgeBelowApex(10.0)]), {"apex": above_the_ridge(nodes)}),
    ),
    "FairRidge": Case(replace(NONE, extra=[FairRidge()]), None),
}


def above_the_ridge(nodes: CupShape) -> np.ndarray:
    """A bust point 10 mm above the ridge's 24th node."""
    return nodes.edges[0, -2, 24].numpy() - np.array([10.0, 0.0, 0.0])


def targets(cup: StripsCup, given: dict[str, np.ndarray] | None = None) -> Targets:
    """Clouds that end below the upper edges, with all marks, the last without a neckline; or with the given ones."""
    wire = SCALE * cup.wire.sample(cup.stations)[0].numpy()
    a, one = np.linspace(0, np.pi, 50), np.eye(3)
    line = np.stack((0.1 * np.sin(2 * a), 1 - np.cos(a), 1.05 * np.sin(a)), axis=1)
    marks = {"neckline": line, "strap_point": one.sum(0) - 0.9 * one[0], "apex": one.sum(0) - 0.3 * one[0]}
    marks = {key: SCALE * value for key, value in marks.items()} if given is None else given
    many = []
    for k in range(cup.batch):
        points = cloud(600 - 50 * k, k).numpy()
        own = {key: v for key, v in marks.items() if key != "neckline" or k < cup.batch - 1 or given is not None}
        many.append(Target(str(k), SCALE * points[points[:, 2] < 0.4], wire, **own))
    return Targets.stack(many, torch.full((cup.batch,), SCALE, dtype=torch.float64))


def problem(asked: Conditions, batch: int = 3) -> tuple[Objective, Tensor]:
    """Without points, of which other tests tell."""
    cup = plain_strips(batch)
    return Objective(cup, targets(cup), asked).thinned(0), varied(cup)


def cost(objective: Objective, flat: Tensor) -> Tensor:
    """What the conditions cost, without the points and the bare sum."""
    terms = objective.evaluate(flat, Pressure(1.0)).terms
    return sum((v for k, v in terms.items() if k not in ("objective", "points")), torch.zeros(len(flat)))


def test_every_condition_has_a_case():
    assert set(WEIGHTS) - {"points"} < set(CASES)


@pytest.mark.parametrize("name", CASES)
class TestCondition:
    def test_it_asks_something_of_cups_that_do_not_meet_it(self, name):
        objective, flat = problem(CASES[name].asked)
        assert (cost(objective, flat) > 1e-9).any()
        others = [k for k, block in enumerate(self.blocks(objective, flat)) if block.condition not in (name, "")]
        assert not others

    def test_its_derivatives_are_those_of_central_differences(self, name):
        objective, flat = problem(CASES[name].asked)
        gradient = objective.evaluate(flat, Pressure(1.0)).gradient
        direction, h = torch.randn(flat.shape, dtype=flat.dtype) * objective.cup.steps, 2e-6
        direction[:, -1] = 0  # the corner's place, which only a strap point asks for
        value = [objective.value(flat + sign * h * direction, Pressure(1.0)) for sign in (1, -1)]
        known = (value[0] - value[1]) / (2 * h)
        torch.testing.assert_close((gradient * direction).sum(1), known, rtol=2e-5, atol=1e-9)

    def test_solvers_that_linearise_see_the_same_derivatives(self, name):
        """Rows in closed form, or of the condition's own, give the value and gradient of automatic differentiation."""
        objective, flat = problem(CASES[name].asked)
        own, other = normal_equations(objective, flat, Pressure(1.0)), objective.evaluate(flat, Pressure(1.0))
        torch.testing.assert_close(own.value, other.value, rtol=1e-9, atol=0)
        unasked = objective.unasked(torch.arange(flat.shape[1]))
        known = other.gradient.masked_fill(unasked, 0)  # that of the equations, and that of what the nodes make of them
        assert (own.gradient - known).norm() < 1e-4 * known.norm()

    def test_its_rows_are_the_derivatives_of_its_residuals(self, name):
        """They make the Gauss-Newton matrix of solvers and of the certainty."""
        objective, flat = problem(CASES[name].asked)
        linear = objective.cup.linearise(flat)
        direction, h = torch.randn(flat.shape, dtype=flat.dtype) * objective.cup.steps, 1e-6
        direction[:, -1] = 0
        for k, block in enumerate(self.blocks(objective, flat)):
            if block.diagonal is not None:
                continue
            rows = block.jacobian(linear, objective.cup.size)
            ahead, behind = (self.blocks(objective, flat + sign * h * direction)[k].residual for sign in (1, -1))
            known = (ahead - behind) / (2 * h)
            found = (rows * direction[:, None, linear.columns]).sum(-1)
            if block.gaps is not None:  # up to what slides along
                away = block.residual.unflatten(1, (-1, 3))
                known, found = ((v.unflatten(1, (-1, 3)) * away).sum(-1) for v in (known, found))
            torch.testing.assert_close(found, known, rtol=1e-4, atol=1e-5 * max(1.0, known.abs().max().item()))

    def test_each_scan_is_as_if_alone(self, name):
        objective, flat = problem(CASES[name].asked)
        together, linear = objective.evaluate(flat, Pressure(1.0)), normal_equations(objective, flat, Pressure(1.0))
        for k in range(3):
            one = objective.select(torch.tensor([k]))
            alone = one.evaluate(flat[k : k + 1], Pressure(1.0))
            torch.testing.assert_close(alone.value[0], together.value[k], rtol=1e-12, atol=0)
            torch.testing.assert_close(alone.gradient[0], together.gradient[k], rtol=1e-9, atol=1e-12)
            matrix = normal_equations(one, flat[k : k + 1], Pressure(1.0)).matrix[0]
            torch.testing.assert_close(matrix, linear.matrix[k], rtol=1e-5, atol=1e-7)

    def test_a_cup_that_meets_it_pays_nothing(self, name):
        meets = CASES[name].met
        if meets is None:
            pytest.skip("no cup meets it wholly")
        cup = plain_strips(1)
        flat = cup.flatten().detach()
        scale = torch.full((1,), SCALE, dtype=torch.float64)
        asked, marks = meets(cup.shape_of(flat).scaled(scale), cup.sketch(flat).scaled(scale))
        assert cost(Objective(cup, targets(cup, marks), asked).thinned(0), flat).abs().max() < 1e-6

    def test_scans_without_landmarks_are_left_alone(self, name):
        cup = plain_strips(1)
        objective = Objective(cup, targets(cup, {}), CASES[name].asked)
        result = objective.evaluate(varied(cup), Pressure(1.0))
        assert result.value.isfinite().all()
        assert result.gradient.isfinite().all()

    def test_derivatives_through_the_fit_know_it(self, name):
        """The twice differentiable objective has its value, its gradient, and its weight by its name."""
        objective, flat = problem(CASES[name].asked, 2)
        shares = Data.of(objective).shares.requires_grad_()
        whole = Problem.of(objective, Pressure(1.0), replace(Data.of(objective), shares=shares))
        at = flat.clone().requires_grad_()
        value = whole.value(at)
        plain = objective.evaluate(flat, Pressure(1.0))
        torch.testing.assert_close(value.detach(), plain.value, rtol=1e-5, atol=1e-9)
        (by_share,) = torch.autograd.grad(value.sum(), shares, retain_graph=True)
        known = dict(zip(weight_names(objective.conditions), by_share.unbind(1), strict=True))
        torch.testing.assert_close(known[name], cost(objective, flat), rtol=1e-5, atol=1e-12)
        (gradient,) = torch.autograd.grad(value.sum(), at, create_graph=True)
        (second,) = torch.autograd.grad(gradient.square().sum(), at)
        assert second.isfinite().all()

    @staticmethod
    def blocks(objective: Objective, flat: Tensor) -> list:
        shape, cup = objective.cup.sketch(flat), objective.cup
        return objective.blocks(flat, shape, Pressure(1.0), shape.margin, cup.unfairness(flat))


@pytest.mark.parametrize("loss", ["l1", "l2", "robust", Biweight(3.0)], ids=str)
class TestLoss:
    def test_its_slope_is_that_of_central_differences(self, loss):
        squared, h = torch.linspace(0.01, 30, 50, dtype=torch.float64), 1e-6
        own = point_loss(loss, 0.5, torch.tensor(2.0, dtype=torch.float64))
        known = (own(squared + h)[0] - own(squared - h)[0]) / (2 * h)
        torch.testing.assert_close(own(squared)[1], known, rtol=1e-6, atol=1e-8)

    def test_it_is_the_same_in_any_unit(self, loss):
        """Of residuals in mm and of the same in units of 4 mm."""
        squared, unit = torch.linspace(0, 30, 50, dtype=torch.float64), torch.tensor(4.0, dtype=torch.float64)
        rho, slope = point_loss(loss, 0.5)(squared)
        small, same = point_loss(loss, 0.5, unit)(squared / unit**2)
        power = 1 if loss == "l1" else 2  # of lengths
        torch.testing.assert_close(small * unit**power, rho)
        torch.testing.assert_close(same, slope * unit ** (2 - power))

    def test_none_is_negative_and_none_falls(self, loss):
        rho, slope = point_loss(loss, 0.5)(torch.linspace(0, 100, 200, dtype=torch.float64))
        assert rho[0] == 0
        assert (rho.diff() >= 0).all()
        assert (slope >= 0).all()


class Nameless(Condition):
    def residuals(self, shape: CupShape, targets: Targets) -> Tensor:
        return shape.edges.new_zeros(1)


class Flat(Nameless):
    weight = 1.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([3], "condition.extra.0: a int is no brafit.fitting.Condition"),
        ([Flat], "condition.extra.0: the class Flat itself is no brafit.fitting.Condition"),
        ([Flat(), Flat()], "condition.extra.1: there is another condition Flat"),
        ([Nameless()], "condition.extra.0: Nameless must have a weight"),
        ([UpperEdgeLength(200.0, weight=-1.0)], "a number that is not negative, got -1.0"),
        ([UpperEdgeLength(200.0, name="rim")], "there is another condition rim"),
    ],
)
def test_what_is_no_condition_is_refused(given, words):
    with pytest.raises(ValueError, match=r"condition\.extra") as caught:
        checked_conditions(given, WEIGHTS)
    assert words in str(caught.value)


def test_residuals_of_another_shape_are_refused():
    objective, flat = problem(replace(NONE, extra=[Flat()]))
    with pytest.raises(ValueError, match=r"Flat\.residuals must give a tensor \(3, m\), a row a cup, got \(1,\)"):
        objective.value(flat, Pressure(1.0))


@pytest.mark.parametrize("loss", [3, Biweight, lambda squared: squared, lambda squared: (squared[:, :1],) * 2])
def test_what_is_no_loss_is_refused(loss):
    with pytest.raises(ValueError, match=r"condition\.points: .* is no loss"):
        checked_loss(loss, "condition.points")


def test_what_is_measured_is_told_of_each_cup():
    cup = plain_strips(2)
    told = measured_conditions([UpperEdgeLength(230.0), RidgeBelowApex(12.0)], cup, targets(cup))
    known = lengths(cup.shape())
    assert [one["upper edge length"]["length_mm"] for one in told] == pytest.approx(known.tolist())
    assert all(one["ridge below apex"]["residual_mm"] >= 0 for one in told)
