"""What every solver promises: a lower objective, each problem as if alone, and none spoilt by another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from cups import half_circle, plain_strips, varied

from brafit.cup import Cup, FramesCup
from brafit.fitting import (
    LM,
    Anneal,
    AnnealStage,
    Conditions,
    LMStage,
    NelderMead,
    ResultCode,
    Solution,
    Solver,
    Step,
    Target,
)
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.solver import Callback
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import on_panels

ROOT = Path(__file__).parents[2]
SOLVERS: dict[str, Callable[[int], Solver]] = {
    "lm": lambda _: LM([LMStage(steps=8, terms=4, points=50), LMStage(steps=12, tolerance=1e-6)]),
    "anneal": lambda _: Anneal(
        [AnnealStage("adam", 4, 1.0), AnnealStage("lbfgs", 8, 10.0), AnnealStage("lbfgs", 8, 100.0)]
    ),
    "paper": lambda evaluations: NelderMead(rounds=1, evaluations=evaluations, penalty=10.0, largest=10.0),
}
"""Of each the schedule, cut short; the paper's for so many evaluations."""
SHARE = {"lm": 0.05, "anneal": 0.5, "paper": 0.9}
"""Of the first objective that may be left."""


def cups(solver: str, batch: int) -> Cup:
    """Of the model that the solver is for, off the cup that made the points; few parameters for the paper's."""
    if solver == "lm":
        cup = plain_strips(batch)
        cup.load_flat(varied(plain_strips(1), 0.1).expand(batch, -1))
        return cup
    panels, terms = (1, 1) if solver == "paper" else (2, 2)
    cup = FramesCup(half_circle(batch), panels, terms, 21)
    angles, reaches = ([[1.2]], [[0.8]]) if solver == "paper" else ([[0.6, 1.75]], [[0.85, 1.15]])
    cup.start(torch.tensor(angles * batch).double(), torch.tensor(reaches * batch).double())
    return cup


def truth(solver: str) -> Cup:
    """The cup that the points lie on."""
    if solver == "lm":
        return plain_strips(1)
    panels = 1 if solver == "paper" else 2
    cup = FramesCup(half_circle(1), panels, 2, 41)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * torch.pi / 2)[None], torch.ones(1, panels, dtype=torch.float64))
    return cup


def target(solver: str, seed: int, count: int = 60) -> Target:
    shape = truth(solver).shape().map(lambda v: v[0].detach())
    points = on_panels(shape, count, np.random.default_rng(seed)).numpy()
    return Target(f"cloud {seed}", points, shape.edges[0].numpy(), shape.edges[-1].numpy())


def problem(solver: str, targets: list[Target]) -> Objective:
    conditions = Conditions(connection=0.0, barrier=0.1, fairness=0.0, neckline_limit=None, margin=0.05)
    stacked = Targets.stack(targets, torch.ones(len(targets), dtype=torch.float64))
    return Objective(cups(solver, len(targets)), stacked, conditions)


def solved(solver: str, targets: list[Target], callback: Callback | None = None) -> Solution:
    own = problem(solver, targets)
    return SOLVERS[solver](25).solve(own, own.cup.flatten().detach(), callback)


def spoilt(own: Target) -> Target:
    """A cloud with a point that is no number."""
    points = own.points.copy()
    points[3, 1] = np.nan
    return replace(own, points=points)


def test_every_solver_that_comes_with_a_file_of_settings_is_here():
    files = list((ROOT / "conf" / "solver").glob("*.yaml"))
    assert {file.stem for file in files} == set(SOLVERS)
    for file in files:
        assert yaml.safe_load(file.read_text())["_target_"].endswith(f".{type(SOLVERS[file.stem](1)).__name__}")


@pytest.mark.parametrize("solver", SOLVERS)
class TestSolver:
    def test_it_lowers_the_objective_of_a_known_cup(self, solver):
        """And what it tells of on the way are its steps and the terms of the problems that still run."""
        told: list[Step] = []
        own = problem(solver, [target(solver, 1), target(solver, 2)])
        start = own.cup.flatten().detach()
        kept = start.clone()
        solution = SOLVERS[solver](200).solve(own, start, told.append)
        assert torch.equal(start, kept), "the start was changed"
        pressure = Pressure(100.0 if solver != "paper" else 10.0)
        before, after = own.value(start, pressure), own.value(solution.flat, pressure)
        assert (after < SHARE[solver] * before).all(), (before, after)
        assert solution.flat.shape == start.shape
        assert solution.flat.dtype == start.dtype
        assert len(solution.codes) == len(solution.iterations) == 2
        assert (solution.iterations > 0).all()
        assert not {ResultCode.DIVERGED, ResultCode.DROPPED} & set(solution.codes)
        assert isinstance(SOLVERS[solver](1), Solver)
        self.check(told)

    @staticmethod
    def check(told: list[Step]) -> None:
        assert told
        for step in told:
            assert 0 <= step.index <= step.total
            assert step.stage
            assert {"objective", "points"} <= set(step.terms)
            assert all(len(term) == len(step.scans) for term in step.terms.values())
            assert set(step.scans.tolist()) <= {0, 1}
        assert [step.index for step in told] == sorted(step.index for step in told)

    def test_a_result_alone_is_that_in_a_batch_with_a_spoilt_one(self, solver):
        """A cloud that is no number is told of as diverged, and the others end as they do alone."""
        first, second = target(solver, 1), target(solver, 2, 50)
        together = solved(solver, [first, spoilt(target(solver, 3)), second])
        assert together.codes[1] is ResultCode.DIVERGED
        for row, own in ((0, first), (2, second)):
            alone = solved(solver, [own])
            torch.testing.assert_close(alone.flat[0], together.flat[row], rtol=1e-9, atol=1e-10)
            assert alone.codes[0] is together.codes[row]
            assert alone.iterations[0] == together.iterations[row]

    def test_the_same_problem_twice_ends_in_the_same(self, solver):
        both = solved(solver, [target(solver, 1)] * 2)
        assert torch.equal(both.flat[0], both.flat[1])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LM([]), "at least one stage"),
        (lambda: LM([{"steps": 5, "leading": True}]), "at least one stage that is not leading"),
        (lambda: LM([{"steps": 0}]), "steps >= 1"),
        (lambda: Anneal([AnnealStage("sgd", 1, 1.0)]), "unknown optimiser 'sgd'"),
        (lambda: Anneal([AnnealStage("adam", -1, 1.0)]), "steps >= 0"),
    ],
)
def test_schedules_that_are_none_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
