from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from cups import cloud, lune_frames, near

from brafit.cup import CupShape
from brafit.fitting import Conditions, Target
from brafit.fitting.objective import Objective, Pressure, shortfall
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import on_panels

SCALE = 80.0


def line_near_the_upper_edge(seed: int) -> np.ndarray:
    a = np.linspace(0, np.pi, 40)
    wave = np.random.default_rng(seed).normal(0, 0.05, 3)
    line = np.stack((0.1 * np.sin(a) + wave[0] * np.sin(2 * a), 1 - np.cos(a), (1.1 + wave[1]) * np.sin(a)), axis=1)
    return SCALE * line


def target(seed: int, count: int = 150, full: bool = True) -> Target:
    extra = {}
    if full:
        extra = {
            "neckline": line_near_the_upper_edge(seed),
            "strap_point": SCALE * np.array([0.1, 0.9, 1.2]),
            "apex": SCALE * np.array([0.7, 1.1, 0.75]),
        }
    wire = lune_frames().shape().edges[0, 0, ::4].detach().numpy() * SCALE
    return Target(f"cloud {seed}", cloud(count, seed).numpy() * SCALE, wire, **extra)


EVERYTHING = Conditions(
    points_width=5.0,
    connection=0.05,
    connection_width=10.0,
    ridge_apex=0.03,
    margin=0.9,
    margin_width=0.1,
    barrier=0.5,
    fairness=3e3,
)
NAMES = {
    "points",
    "edge to neckline",
    "neckline to edge",
    "connection",
    "ridge at apex",
    "regularity",
    "fairness",
    "ends",
    "twist",
}


def objective(targets: list[Target], conditions: Conditions = EVERYTHING, panels: int = 2) -> Objective:
    cup = lune_frames(len(targets), panels)
    return Objective(cup, Targets.stack(targets, torch.full((len(targets),), SCALE, dtype=torch.float64)), conditions)


def pressure(problem: Objective) -> Pressure:
    """With multipliers."""
    constraints = problem.constraints(problem.cup.sketch(problem.cup.flatten()))
    generator = torch.Generator().manual_seed(1)
    multipliers = {k: torch.randn(v.shape, generator=generator, dtype=v.dtype) for k, v in constraints.items()}
    return Pressure(7.0, multipliers)


@pytest.mark.parametrize("panels", [1, 2, 3])
@pytest.mark.parametrize("loss", ["l1", "l2", "robust"])
def test_gradient_of_every_parameter_against_central_differences(loss, panels):
    problem = objective([target(3)], replace(EVERYTHING, points=loss), panels)
    press, flat = pressure(problem), near(problem.cup, 0.05, 4)
    result = problem.evaluate(flat, press)
    assert set(result.terms) - {"objective", "rms_mm"} == (NAMES if panels > 1 else NAMES - {"ridge at apex"})
    assert all(v.abs().max() > 1e-6 for v in result.terms.values())
    size, h = problem.cup.size, 2e-6
    steps = h * torch.eye(size, dtype=torch.float64)
    many = objective([target(3)] * size, replace(EVERYTHING, points=loss), panels)
    wide = Pressure(press.penalty, {k: v.expand(size, -1) for k, v in press.multipliers.items()})
    difference = (many.value(flat + steps, wide) - many.value(flat - steps, wide)) / (2 * h)
    scale = difference.abs().max().item()
    torch.testing.assert_close(result.gradient[0], difference, rtol=1e-6, atol=1e-7 * scale)


def differences(problem: Objective, flat: torch.Tensor, h: float = 2e-6) -> torch.Tensor:
    """Gradient of a batch of one problem by central differences."""
    steps = h * torch.eye(problem.cup.size, dtype=torch.float64)
    values = [problem.value(flat + step, Pressure(1.0)) - problem.value(flat - step, Pressure(1.0)) for step in steps]
    return torch.cat(values) / (2 * h)


def flat_cloud(height: float) -> np.ndarray:
    """A net in the plane of the lune cup's upper edge, a half circle of height 1."""
    y, z = np.meshgrid(np.arange(-0.1, 2.11, 0.05), np.arange(-0.1, height, 0.05))
    return SCALE * np.stack((0 * y, y, z), axis=-1).reshape(-1, 3)


def test_guides_draw_all_edges_and_points_count_no_more():
    problem = objective([target(3)])
    shape = problem.cup.shape_of(near(problem.cup, 0.05, 4)).map(lambda v: v.detach())
    problem.guides = shape.edges[:, 1:]
    guided, flat = problem.seen(0), near(problem.cup, 0.05, 5)
    at_home = guided.evaluate(near(problem.cup, 0.05, 4), Pressure(1.0)).terms
    assert max(v.item() for k, v in at_home.items() if "guide" in k) < 1e-6
    result = guided.evaluate(flat, Pressure(1.0))
    assert {k for k in result.terms if "guide" in k} == {
        f"{a} to {b}" for i in (1, 2) for a, b in ((f"edge {i}", "guide"), ("guide", f"edge {i}"))
    }
    assert result.terms["points"].item() == 0
    assert not any("neckline" in k for k in result.terms)
    expected = differences(guided, flat)
    scale = expected.abs().max().item()
    torch.testing.assert_close(result.gradient[0], expected, rtol=1e-5, atol=1e-6 * scale)


def test_the_upper_edge_is_held_on_a_cloud_that_ends_before_it():
    """Only beyond the cloud's end, only without a neckline, and with the right gradient."""
    wire = target(0).wire
    short, long = (Target(f"net {size}", flat_cloud(size), wire) for size in (0.6, 1.2))
    marked = replace(short, neckline=line_near_the_upper_edge(1))
    problem = objective([short, long, marked], Conditions(rim=1.0, margin=0.1))
    flat = lune_frames(3).flatten().detach()
    terms = problem.evaluate(flat, Pressure(1.0)).terms["edge to cloud"]
    assert terms[0] > 1e-3
    assert terms[1] == terms[2] == 0
    one, flat = objective([short], Conditions(rim=1.0, margin=0.1)), near(lune_frames(1), 0.03, 2)
    expected = differences(one, flat)
    scale = expected.abs().max().item()
    torch.testing.assert_close(one.evaluate(flat, Pressure(1.0)).gradient[0], expected, rtol=1e-5, atol=1e-5 * scale)


def test_value_is_the_sum_of_the_terms_and_the_one_without_gradients():
    problem = objective([target(1), target(2, 60)])
    flat, press = near(problem.cup), pressure(problem)
    result = problem.evaluate(flat, press)
    sums = sum(v for k, v in result.terms.items() if k in NAMES)
    torch.testing.assert_close(result.terms["objective"], sums)
    torch.testing.assert_close(problem.value(flat, press), result.value)


def test_points_term_is_the_mean_square_distance():
    """A cup of half circles around points of a smaller and a larger half circle in the wire's plane."""
    a = torch.linspace(0.3, math.pi - 0.3, 11, dtype=torch.float64)
    ring = torch.stack((torch.sin(a), -torch.cos(a), 0 * a), dim=-1)
    points = torch.cat((0.9 * ring, 1.2 * ring)) + torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    own = Target("ring", (points * SCALE).numpy(), target(0).wire)
    problem = objective([own], Conditions(points="l2"), panels=1)
    cup = problem.cup
    cup.start(torch.zeros(1, 1, dtype=torch.float64) + 1e-9, torch.ones(1, 1, dtype=torch.float64))
    result = problem.evaluate(cup.flatten().detach(), Pressure(1.0))
    assert result.terms["points"].item() == pytest.approx((0.1**2 + 0.2**2) / 2, rel=1e-5)


def test_missing_landmarks_cost_nothing_and_are_safe():
    """Without neckline, strap point and apex the other terms stay what they are, also beside a scan that has them."""
    bare, full = target(1, full=False), target(1)
    both = objective([bare, full])
    flat = near(lune_frames(1)).expand(2, -1)
    result = both.evaluate(flat, Pressure(3.0))
    assert result.gradient.isfinite().all()
    for name in ("edge to neckline", "neckline to edge", "connection", "ridge at apex"):
        assert result.terms[name][0] == 0
        assert result.terms[name][1] > 0
    for name in ("points", "regularity", "fairness", "ends", "twist"):
        torch.testing.assert_close(result.terms[name][0], result.terms[name][1])


def test_each_problem_is_as_if_alone_and_padding_does_not_matter():
    """Clouds of different size in one batch; a padded point may be anywhere."""
    targets = [target(1, 150), target(2, 40), target(3, 90)]
    problem = objective(targets)
    flat, press = near(problem.cup), pressure(problem)
    whole = problem.evaluate(flat, press)
    for k, own in enumerate(targets):
        alone = objective([own]).evaluate(flat[k : k + 1], press.select(torch.tensor([k])))
        torch.testing.assert_close(alone.value[0], whole.value[k], rtol=1e-13, atol=0)
        torch.testing.assert_close(alone.gradient[0], whole.gradient[k], rtol=1e-10, atol=1e-12)
        chosen = problem.select(torch.tensor([k])).evaluate(flat[k : k + 1], press.select(torch.tensor([k])))
        torch.testing.assert_close(chosen.value[0], whole.value[k], rtol=1e-13, atol=0)
    padded = problem.targets.points[1, 40:]
    padded.copy_(100 * torch.randn(padded.shape, dtype=torch.float64))
    moved = problem.evaluate(flat, press)
    torch.testing.assert_close(moved.value, whole.value, rtol=1e-13, atol=0)
    torch.testing.assert_close(moved.gradient, whole.gradient, rtol=1e-10, atol=1e-12)


def test_a_cup_that_has_all_it_wants_costs_nothing():
    """Points on the cup, neckline along its upper edge, developable panels: only the barrier's tail is left."""
    cup = lune_frames(stations=101)
    shape: CupShape = cup.shape().map(lambda v: v[0].detach())
    points = on_panels(shape, 200, np.random.default_rng(0)).numpy()
    edge = shape.edges[-1].numpy()
    own = Target(
        "known", points * SCALE, edge * SCALE, edge * SCALE, edge[50] * SCALE, shape.edges[1, 50].numpy() * SCALE
    )
    targets = Targets.stack([own], torch.tensor([SCALE], dtype=torch.float64))
    problem = Objective(cup, targets, Conditions(ridge_apex=0.01))
    terms = problem.evaluate(cup.flatten().detach(), Pressure(1e3)).terms
    assert terms.pop("regularity").item() < 1e-6
    assert max(v.item() for v in terms.values()) < 1e-7


def test_multipliers_are_those_of_the_lagrangian():
    """lambda c + mu / 2 c^2, up to a constant: the gradients agree."""
    problem = objective([target(1)])
    flat, press = near(problem.cup).requires_grad_(), pressure(problem)
    expected = sum(
        (press.multipliers[k] * c).sum() + press.penalty / 2 * c.square().sum()
        for k, c in problem.constraints(problem.cup.shape_of(flat)).items()
    )
    assert isinstance(expected, torch.Tensor)
    (lagrangian,) = torch.autograd.grad(expected, flat)
    flat = flat.detach()
    without = problem.evaluate(flat, Pressure(1e-12)).gradient
    torch.testing.assert_close(problem.evaluate(flat, press).gradient - without, lagrangian, rtol=1e-8, atol=1e-8)


def test_float32_is_close_to_float64():
    double = objective([target(1)])
    flat = near(double.cup)
    scale = torch.full((1,), SCALE, dtype=torch.float32)
    single = Objective(lune_frames(1).float(), Targets.stack([target(1)], scale), EVERYTHING)
    own, exact = single.evaluate(flat.float(), Pressure(3.0)), double.evaluate(flat, Pressure(3.0))
    assert own.gradient.dtype == torch.float32
    torch.testing.assert_close(own.value.double(), exact.value, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(own.gradient.double(), exact.gradient, rtol=1e-2, atol=1e-3)


def test_errors():
    with pytest.raises(ValueError, match="unknown point loss"):
        Conditions(points="l3")
    with pytest.raises(ValueError, match=r"condition.connection_width must be positive, got 0"):
        Conditions(connection_width=0.0)


def test_barrier_is_the_shortfall_below_its_bound_and_fades_above():
    margin = torch.tensor([-5.0, 0.0, 0.3, 0.6, 1.0, 50.0], dtype=torch.float64)
    values = shortfall(margin, 0.3, 0.05)
    assert values[0].item() == pytest.approx(5.3)
    assert values[1].item() == pytest.approx(0.3, abs=2e-4)
    assert values[2].item() == pytest.approx(0.05 * math.log(2))
    assert values[3].item() < 2e-4
    assert values[4].item() < 1e-6
    assert values[5].item() >= 0
    assert (values.diff() < 0).all()
