from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from cups import half_circle, lune_frames, near

from brafit.cup import Cup, StripsCup, Wire
from brafit.fit import LM, Conditions, LMStage, ResultCode, Target
from brafit.fit.measure import upper_edge_gap
from brafit.fit.normal import normal_equations
from brafit.fit.objective import Objective, Pressure
from brafit.fit.targets import Targets
from brafit.scan.synthetic import on_panels, quarter_sphere

STAGES = [
    LMStage(steps=30, terms=4, points=200, tolerance=1e-3),
    LMStage(steps=60, tolerance=1e-12),
]


def strips(batch: int = 1, panels: int = 2, terms: int = 5) -> StripsCup:
    wire = Wire.from_omega((0.15, 0.9, 0.1), math.pi)
    cup = StripsCup(wire.select(torch.zeros(batch, dtype=torch.long)), panels, terms, nodes=40)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(batch, -1), torch.ones(batch, panels, dtype=torch.float64))
    return cup


def varied(cup: Cup, amount: float = 0.05) -> torch.Tensor:
    """Parameters beside the start, without corner, the higher terms the smaller."""
    start = cup.flatten().detach()
    change = near(cup, amount, seed=4) - start
    order = torch.arange(cup.terms, dtype=start.dtype).repeat(2 * cup.panels)
    change = change / (1 + torch.cat((start.new_zeros(cup.panels), order, start.new_zeros(2))) ** 2)
    change[:, -2:] = 0
    return start + change


def against(
    cup: Cup, clouds: list[np.ndarray], necklines: list[np.ndarray] | None = None, samples: int = 81
) -> Targets:
    wire = cup.wire.sample(cup.stations)[0].numpy()
    lines = necklines or [None] * len(clouds)
    targets = [Target(str(k), c, wire, line, None, None) for k, (c, line) in enumerate(zip(clouds, lines, strict=True))]
    return Targets.stack(targets, torch.ones(len(clouds), dtype=torch.float64), samples)


def sphere_targets(cup: Cup, count: int = 300) -> Targets:
    clouds = [quarter_sphere(count, 1.0, np.random.default_rng(k)).numpy() for k in range(cup.batch)]
    line = np.stack([[0.0, 1 - math.cos(a), math.sin(a)] for a in np.linspace(0, math.pi, 60)])
    return against(cup, clouds, [line] * cup.batch)


@pytest.mark.parametrize("kind", ["frames", "strips"])
def test_normal_equations_have_the_gradient_of_the_objective(kind):
    """One pass with closed-form rows gives what automatic differentiation gives."""
    cup = lune_frames(2) if kind == "frames" else strips(2)
    flat = near(cup, 0.03) if kind == "frames" else varied(cup)
    conditions = Conditions(points="robust", ridge_apex=0.01, barrier=5.0, margin=0.9, margin_width=0.1)
    targets = sphere_targets(cup)
    targets = Targets(
        **{
            **vars(targets),
            "connection": torch.tensor([[0.0, 1.0, 1.0]] * 2, dtype=torch.float64),
            "has_connection": torch.tensor([True, True]),
            "apex": torch.tensor([[0.7, 1.0, 0.7]] * 2, dtype=torch.float64),
            "has_apex": torch.tensor([True, True]),
        }
    )
    objective = Objective(cup, targets, conditions)
    own, other = normal_equations(objective, flat, Pressure(10.0)), objective.evaluate(flat, Pressure(10.0))
    assert torch.allclose(own.value, other.value, rtol=1e-6)
    assert (own.gradient - other.gradient).norm() < 1e-4 * other.gradient.norm()
    assert set(own.terms) == set(other.terms)


def test_a_strips_cup_is_recovered_from_clean_points():
    """Two panels on a wire that is not planar: edges within 1e-5 of its length (the neckline has chords)."""
    cup = strips(terms=4)
    flat = varied(cup)
    dense = StripsCup(cup.wire, 2, 4, stations=3201).shape_of(flat).map(lambda v: v[0])
    truth = cup.shape_of(flat).map(lambda v: v[0])
    points = on_panels(truth, 400, np.random.default_rng(0)).numpy()
    targets = against(cup, [points], [dense.edges[-1].numpy()], samples=801)
    conditions = Conditions(fairness=0.0, connection=0.0, barrier=1e-4, margin=0.0)
    solution = LM(STAGES).solve(Objective(cup, targets, conditions), cup.flatten().detach(), None)
    assert solution.codes == [ResultCode.CONVERGED]
    found = cup.shape_of(solution.flat)
    assert (found.edges[0] - truth.edges).norm(dim=-1).max() < 1e-5 * math.pi


def test_each_problem_of_a_batch_ends_as_if_alone():
    cup = strips(3)
    targets = sphere_targets(cup)
    objective = Objective(cup, targets, Conditions())
    start = varied(cup, 0.02)
    solver = LM([LMStage(steps=8, terms=4, points=150, tolerance=1e-3), LMStage(steps=12, tolerance=1e-5)])
    together = solver.solve(objective, start, None)
    for k in range(3):
        index = torch.tensor([k])
        alone = solver.solve(objective.select(index), start[index], None)
        assert torch.allclose(alone.flat[0], together.flat[k], rtol=0, atol=1e-9)
        assert alone.codes[0] is together.codes[k]
        assert alone.iterations[0] == together.iterations[k]


def test_losers_are_dropped_and_the_best_start_wins():
    cup = strips(3)
    targets = sphere_targets(cup).select(torch.zeros(3, dtype=torch.long))
    objective = Objective(cup, targets, Conditions(), torch.zeros(3, dtype=torch.long))
    start = cup.flatten().detach()
    start[1, 0] -= 0.5
    start[2, 0] += 0.5
    stages = [LMStage(steps=3, terms=3, points=100, keep=1), LMStage(steps=10)]
    solution = LM(stages).solve(objective, start, None)
    assert sorted(code is ResultCode.DROPPED for code in solution.codes) == [False, True, True]
    values = objective.value(solution.flat, solution.pressure)
    kept = solution.codes.index(next(c for c in solution.codes if c is not ResultCode.DROPPED))
    assert values.argmin() == kept


def test_frames_are_fitted_too():
    """Constraints of the paper's model are held by penalty and multipliers."""
    cup = lune_frames(1, stations=41)
    stages = [LMStage(steps=15, penalty=p, tolerance=1e-5) for p in (1.0, 10.0, 100.0)]
    objective = Objective(cup, sphere_targets(cup), Conditions())
    solution = LM(stages).solve(objective, cup.flatten().detach(), None)
    shape = cup.shape_of(solution.flat)
    assert cup.ends(shape).abs().max() < 1e-9
    distances = objective.distances(shape, objective.feet(shape))
    assert distances.square().mean().sqrt() < 0.03
    assert cup.twist(shape).square().mean().sqrt() < 1e-2


def test_a_place_that_is_no_number_is_reported():
    cup = strips(2)
    start = cup.flatten().detach()
    start[1, 0] = math.nan
    solution = LM([LMStage(steps=3)]).solve(Objective(cup, sphere_targets(cup), Conditions()), start, None)
    assert solution.codes[1] is ResultCode.DIVERGED
    assert solution.flat[0].isfinite().all()


def test_impossible_stages_are_refused():
    with pytest.raises(ValueError, match="steps >= 1"):
        LMStage(steps=0)
    with pytest.raises(ValueError, match="at least one stage"):
        LM([])


def test_strips_need_no_closing():
    cup = StripsCup(half_circle())
    assert cup.closure(cup()) is None
    assert cup.constraints(cup()) == {}


def test_the_neckline_weighs_more_only_where_the_upper_edge_is_too_far():
    """Of two scans with the same cloud, one whose neckline lies off it and one whose neckline fits."""
    cup = strips(2)
    cloud = quarter_sphere(300, 1.0, np.random.default_rng(0)).numpy()
    angle = np.linspace(0, math.pi, 60)
    fitting = np.stack([0 * angle, 1 - np.cos(angle), np.sin(angle)], axis=1)
    off = fitting + 0.5 * np.sin(angle)[:, None] ** 2 * [0.0, 0.0, 1.0]
    targets = against(cup, [cloud, cloud], [off, fitting])
    gaps, points = [], []
    for limit in (10.0, 0.025):
        objective = Objective(cup, targets, Conditions(neckline_limit=limit, connection=0.0, fairness=0.01))
        solution = LM(STAGES).solve(objective, cup.flatten().detach(), None)
        shape = cup.shape_of(solution.flat)
        lines = zip(shape.edges[:, -1], map(torch.as_tensor, (off, fitting)), strict=True)
        gaps.append([upper_edge_gap(edge, line) for edge, line in lines])
        points.append(solution.flat)
    assert gaps[0][0] > 0.03, gaps
    assert gaps[1][0] < 1.1 * 0.025, gaps
    assert gaps[0][1] < 0.025
    torch.testing.assert_close(points[0][1], points[1][1], rtol=0, atol=0)
