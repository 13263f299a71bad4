from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from cups import half_circle, lune_frames, near, varied
from cups import plain_strips as strips

from brafit.cup import Cup, StripsCup
from brafit.fitting import LM, Conditions, LMStage, ResultCode, Target, normal
from brafit.fitting.measure import upper_edge_gap
from brafit.fitting.normal import PointRows, normal_equations
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import on_panels, quarter_sphere

STAGES = [
    LMStage(steps=30, terms=4, points=200, tolerance=1e-3),
    LMStage(steps=60, tolerance=1e-12),
]


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


def test_the_matrix_in_single_precision_is_near_and_the_gradient_exact():
    """Against rows in double precision, from the same feet; points many enough to come in parts."""
    cup = strips(2)
    objective, flat = Objective(cup, sphere_targets(cup, 700), Conditions()), varied(cup)
    linear = cup.linearise(flat)
    rows = PointRows.of(objective, linear, None, slice(None))
    jacobian = rows.sums.jacobian(linear.table)
    gradient = (jacobian * (rows.slope * rows.distances)[..., None]).sum(1)
    torch.testing.assert_close(rows.gradient(), gradient, rtol=0, atol=1e-13)
    matrix = jacobian.mT @ (jacobian * rows.slope[..., None])
    torch.testing.assert_close(rows.matrix(), matrix, rtol=0, atol=1e-6 * matrix.abs().max().item())


def test_a_fit_ends_where_one_in_double_precision_throughout_ends(monkeypatch):
    """Cups of a wire of 200 mm: flat outlines within a thousandth of a millimetre."""
    cup = strips(2)
    objective, start = Objective(cup, sphere_targets(cup), Conditions()), varied(cup, 0.02)
    mixed = LM(STAGES).solve(objective, start, None)
    monkeypatch.setattr(torch.Tensor, "float", lambda tensor: tensor)
    double = LM(STAGES).solve(objective, start, None)
    ours, others = (cup.shape_of(solution.flat).flat() for solution in (mixed, double))
    for name in ("lower", "upper"):
        assert 200 / math.pi * (getattr(ours, name) - getattr(others, name)).norm(dim=-1).max() < 1e-3
    assert mixed.codes == double.codes


@pytest.mark.parametrize("numbers", [1, 3000, 1 << 30])
def test_parts_of_points_make_the_same_matrix(numbers, monkeypatch):
    """One row at a time, some of one problem, all of all."""
    cup = strips(2)
    objective, flat = Objective(cup, sphere_targets(cup, 150), Conditions()), varied(cup)
    whole = normal_equations(objective, flat, Pressure(1.0))
    monkeypatch.setattr(normal, "ROWS", numbers)
    monkeypatch.setattr(normal, "POINTS", numbers)
    parts = normal_equations(objective, flat, Pressure(1.0))
    torch.testing.assert_close(parts.matrix, whole.matrix, rtol=0, atol=1e-5 * whole.matrix.abs().max().item())
    torch.testing.assert_close(parts.gradient, whole.gradient, rtol=0, atol=1e-12)
    torch.testing.assert_close(parts.value, whole.value)


def test_what_is_told_belongs_to_the_scans_and_does_not_jump():
    """Stages with other weights of fairness and plainness, a soft bound, and no points; two starts a scan."""
    cup = strips(4)
    scans = torch.tensor([0, 0, 1, 1])
    targets = sphere_targets(cup).select(2 * scans)
    problem = Objective(cup, targets, Conditions(), scans, cup.shape().edges[:, 1:].detach())
    stages = [
        LMStage(steps=3, points=0, fairness=0, plainness=10),
        LMStage(steps=8, keep=1, fairness=0, plainness=10, margin_width=0.3),
        LMStage(steps=20, fairness=3, plainness=5),
        LMStage(steps=60, tolerance=1e-9),
    ]
    told = []
    solution = LM(stages).solve(problem, cup.flatten().detach() + 0.01 * torch.arange(4)[:, None], told.append)
    for step in told:
        assert step.scans.dtype == torch.long
        assert {len(values) for values in step.terms.values()} == {len(step.scans)}
    guided, first = (next(step for step in told if step.stage == f"{k} lm") for k in (1, 2))
    assert guided.terms["objective"].isnan().all()
    assert "rms_mm" not in guided.terms
    assert first.scans.tolist() == [0, 0, 1, 1]
    assert all(set(step.scans.tolist()) <= {0, 1} and len(step.scans) <= 2 for step in told if step.stage > "3")
    kept = [k for k, code in enumerate(solution.codes) if code is not ResultCode.DROPPED]
    final = problem.terms(solution.flat, solution.pressure)
    for k in kept:
        path = [step for step in told if int(scans[k]) in step.scans.tolist() and step.stage > "3"]
        objective, rms = (
            torch.stack([step.terms[name][step.scans == scans[k]][0] for step in path])
            for name in ("objective", "rms_mm")
        )
        # where the second stage ended and the third began, only the step between them counts
        assert (objective.diff().abs() < 0.5 * objective[:-1]).all(), objective
        assert objective[-1].item() == pytest.approx(final["objective"][k].item(), rel=1e-6)
        shape = cup.sketch(solution.flat)
        distances = problem.distances(shape, problem.feet(shape))[k][problem.targets.weights[k] > 0]
        assert rms[-1].item() == pytest.approx(distances.square().mean().sqrt().item(), rel=1e-5)


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
        # less than a hundred thousandth of a millimetre: rounding of matrices in single precision
        assert torch.allclose(alone.flat[0], together.flat[k], rtol=0, atol=1e-7)
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
    assert cup.closure(cup.sketch(cup.flatten())) is None
    assert cup.constraints(cup.sketch(cup.flatten())) == {}


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
