"""The schedule that solvers with stages share: what is repeated, raised, taken over and given up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from cups import lune_frames, near
from cups import plain_strips as strips

from brafit.cup import Cup
from brafit.cup.strip_grid import StripGrid
from brafit.fitting import LM, Anneal, AnnealStage, Conditions, LMStage, ResultCode, Solver, Target
from brafit.fitting.lm import Minimum
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.schedule import LOOKS, STILL, Ending, Schedule
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import quarter_sphere


def problem(cup: Cup, conditions: Conditions, groups: torch.Tensor | None = None) -> Objective:
    wire = cup.wire.sample(cup.stations)[0].numpy()
    angle = np.linspace(0, np.pi, 60)
    line = np.stack([0 * angle, 1 - np.cos(angle), np.sin(angle)], axis=1)
    cloud = quarter_sphere(100, 1.0, np.random.default_rng(0)).numpy()
    targets = Targets.stack([Target("ball", cloud, wire, line)] * cup.batch, torch.ones(cup.batch).double())
    return Objective(cup, targets, conditions, groups)


@dataclass
class Recorder:
    """Minimises nothing: the values are given, one for each problem, and what it is asked for is kept."""

    values: torch.Tensor
    code: ResultCode = ResultCode.CONVERGED

    def __post_init__(self):
        self.asked: list[tuple[Objective, Pressure]] = []

    def __call__(self, objective, place, pressure, stage, tell):
        self.asked.append((objective, pressure))
        yes = torch.full((len(place),), True)
        own = self.values[: len(place)]
        return Ending(place, own, yes & (self.code is ResultCode.CONVERGED), ~yes, torch.ones(len(place)).long())


def test_only_what_is_too_low_is_repeated_with_a_stronger_barrier_on_a_finer_grid():
    cup = strips(2)
    flat = cup.flatten().detach()
    own = Conditions(neckline_limit=None)
    low, high = sorted(cup.shape_of(flat * torch.tensor([[1.0], [1.2]])).margin.amin((-2, -1)).tolist())
    assert low < high
    conditions = Conditions(neckline_limit=None, margin=(low + high) / 2)
    for asked, runs in ((own, 1), (conditions, LOOKS + 1)):
        recorder = Recorder(torch.ones(2).double())
        start = flat * torch.tensor([[1.0], [1.2]])
        solution = Schedule([LMStage(steps=1)], recorder).solve(problem(cup, asked), start, None)
        assert len(recorder.asked) == runs
        barrier = solution.pressure.barrier
    assert isinstance(barrier, torch.Tensor)
    assert sorted(barrier[:, 0].tolist()) == [1.0, 10.0 ** (LOOKS + 1)]
    assert [objective.cup.batch for objective, _ in recorder.asked] == [2] + [1] * LOOKS
    strongest = [torch.as_tensor(pressure.barrier).amax().item() for _, pressure in recorder.asked]
    assert strongest == [10.0**k for k in range(LOOKS + 1)]
    grids = [objective.cup.grid for objective, _ in recorder.asked]
    nodes = [len(grid.s) for grid in grids if isinstance(grid, StripGrid)]
    assert len(nodes) == LOOKS + 1
    assert nodes == sorted(set(nodes))


def test_a_barrier_that_is_off_is_not_raised():
    recorder, cup = Recorder(torch.ones(1).double()), strips(1)
    conditions = Conditions(neckline_limit=None, margin=5.0, barrier=0.0)
    Schedule([LMStage(steps=1)], recorder).solve(problem(cup, conditions), cup.flatten().detach(), None)
    assert len(recorder.asked) == 1


def test_the_best_start_of_each_scan_goes_on_and_other_optima_are_noted():
    cup, recorder = strips(4), Recorder(torch.tensor([2.0, 1.0, 3.0, 3.1]).double())
    objective = problem(cup, Conditions(neckline_limit=None), torch.tensor([0, 0, 1, 1]))
    stages = [LMStage(steps=1, terms=4, keep=1), LMStage(steps=1)]
    solution = Schedule(stages, recorder).solve(objective, cup.flatten().detach(), None)
    gone = [code is ResultCode.DROPPED for code in solution.codes]
    assert gone == [True, False, False, True]
    # 2 is far above 1, 3.1 is not far above 3
    assert [[note.code for note in notes] for notes in solution.warnings] == [[], ["starts_apart"], [], []]
    assert recorder.asked[-1][0].groups.tolist() == [0, 1]


@pytest.mark.parametrize("still", [False, True])
def test_a_step_limit_says_whether_more_steps_would_help(still: bool):
    cup = strips(1)
    values = torch.ones(STILL + 5, 1).double() if still else torch.arange(STILL + 5, 0, -1).double()[:, None]

    def minimised(objective, place, pressure, stage, tell):
        no = torch.zeros(1, dtype=torch.bool)
        return Minimum(place, values[-1], no, no, torch.tensor([len(values)]), values)

    asked = problem(cup, Conditions(neckline_limit=None))
    solution = Schedule([LMStage(steps=30)], minimised, last=6).solve(asked, cup.flatten().detach(), None)
    assert solution.codes == [ResultCode.STEP_LIMIT]
    ((told,),) = solution.warnings
    assert told.code == "step_limit"
    assert ("more would not help" in told.text) is still
    assert ("solver.stages.6.steps=120" in told.remedy) is not still


def test_multipliers_take_over_what_the_penalty_held_where_a_stage_says_so():
    cup = lune_frames(1, stations=21)
    flat = near(cup, 0.05)
    stages = [AnnealStage("adam", 1, 1.0), AnnealStage("lbfgs", 1, 10.0), AnnealStage("lbfgs", 1, 100.0)]
    recorder = Recorder(torch.ones(1).double())
    objective = problem(cup, Conditions(margin=-10.0))
    Schedule(stages, recorder).solve(objective, flat, None)
    residual = objective.constraints(cup.sketch(flat))["twist"]
    assert [pressure.multipliers.keys() for _, pressure in recorder.asked[:2]] == [set(), set()]
    torch.testing.assert_close(recorder.asked[2][1].multipliers["twist"], 10.0 * residual)


@pytest.mark.parametrize(
    "solver",
    [
        LM([LMStage(steps=15, tolerance=1e-5)]),
        Anneal([AnnealStage("lbfgs", 40, 1.0)], tolerance=1e-5),
    ],
    ids=["lm", "anneal"],
)
def test_either_solver_ends_above_the_margin_that_is_asked_for(solver: Solver):
    """With a barrier so weak that without raising it the points win."""
    cup = strips(1)
    start, ends = cup.flatten().detach(), []
    free = Conditions(neckline_limit=None, connection=0.0, margin=-5.0, barrier=1e-2)
    for margin in (-5.0, None):
        asked = free if margin else Conditions(**{**vars(free), "margin": ends[0] + 0.05, "margin_width": 0.01})
        solution = solver.solve(problem(cup, asked), start, None)
        ends.append(cup.shape_of(solution.flat).margin.amin().item())
    assert ends[1] > ends[0] + 0.04, ends
