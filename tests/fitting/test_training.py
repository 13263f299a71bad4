"""What a training loop of one's own needs: starts and conditions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from lunes import RADIUS, sphere_points
from torch import Tensor

from brafit.cup import Cup, FramesCup, StripsCup, Wire
from brafit.fitting import ConditionLoss, Conditions, Target, start_cups
from brafit.fitting.loop import starting_problems
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.targets import Targets

ANGLE = np.linspace(0, np.pi, 60)
WIRE = RADIUS * np.stack((np.sin(ANGLE), 1 - np.cos(ANGLE), 0 * ANGLE), axis=-1)
UPPER = WIRE[:, [2, 1, 0]]
BALL = Target("ball", sphere_points(300)[0], WIRE, UPPER, UPPER[30], RADIUS * np.array([0.7, 1, 0.7]))
SMALL = Target("small", 0.7 * BALL.points[:200], 0.7 * WIRE, None, 0.7 * UPPER[30])
models = pytest.mark.parametrize("model", [StripsCup, FramesCup])


def lines(*targets: Target) -> np.ndarray:
    return np.stack([target.wire for target in targets])


def trained(cup: Cup, target: Target, steps: int, asked: Conditions | None = None) -> Tensor:
    """The README's loop in fewer, larger steps; the RMS (mm) before every step, and in the end."""
    start_cups(cup, [target])
    points = torch.as_tensor(target.points)[None]
    conditions = ConditionLoss(cup, [target], asked)
    adam = torch.optim.Adam(cup.parameters(), betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.OneCycleLR(adam, max_lr=0.15, total_steps=steps)
    history = []
    for step in range(steps):
        square = cup(points).square().mean()
        history.append(square.item())
        adam.zero_grad()
        (square + conditions(penalty=0.1 * 1000 ** (step / steps)).sum()).backward()
        adam.step()
        schedule.step()
    return torch.tensor([*history, cup(points).square().mean().item()]).sqrt()


def test_a_plain_loop_fits_strips():
    """Nearly to the error of the best fit of two panels to a quarter sphere, 2.3 % of its radius."""
    cup = StripsCup(WIRE, panels=2, terms=6, nodes=24, output_nodes=32, stations=41)
    rms = trained(cup, BALL, 80)
    assert rms[0] > 2 * rms[-1]
    assert rms[-1] < 0.03 * RADIUS
    assert cup.margin().min() > 0.3


def test_a_plain_loop_fits_frames():
    """As close, and developable as far as the penalty gets."""
    cup = FramesCup(WIRE, panels=2, terms=4, stations=41)
    rms = trained(cup, BALL, 60)
    assert rms[0] > 2 * rms[-1]
    assert rms[-1] < 0.035 * RADIUS
    assert cup.ends(cup.shape()).abs().max() < 1
    assert cup.twist(cup.shape()).square().mean().sqrt() < 0.02


@models
def test_starts_are_those_of_the_fit(model):
    make = partial(model, panels=3)
    cup = make(lines(BALL, BALL, SMALL, SMALL))
    curves = start_cups(cup, [BALL, SMALL], restarts=2)
    wires = Wire.of(lines(BALL, SMALL))
    known = starting_problems([BALL, SMALL], wires, make, Conditions(), 2).cup
    assert torch.equal(cup.flatten(), known.flatten())
    assert curves.shape[:2] == (4, 3)
    with pytest.raises(ValueError, match="2 targets with 1 starts each need as many cups, not 4"):
        start_cups(cup, [BALL, SMALL])


@models
def test_the_loss_of_conditions_is_the_objective_without_points_in_square_millimetres(model):
    cup = model(lines(BALL, SMALL))
    start_cups(cup, [BALL, SMALL])
    asked = Conditions(ridge_apex=0.01)
    conditions = ConditionLoss(cup, [BALL, SMALL], asked)
    loss = conditions(penalty=7.0)
    loss.sum().backward()
    problem = Objective(cup, Targets.stack([BALL, SMALL], cup.wire.scale, neckline_wave=45.0), asked)
    evaluation = problem.evaluate(cup.flatten(), Pressure(7.0))
    shape = cup.sketch(cup.flatten())
    points = problem.points_block(problem.distances(shape, problem.feet(shape))).value()
    square = cup.wire.scale.square()
    torch.testing.assert_close(loss, (evaluation.value - points) * square, rtol=1e-9, atol=0)
    gradient = torch.cat([cup.get_parameter(name).grad.flatten(1) for name in cup.layout], dim=1) / cup.steps
    (own,) = torch.autograd.grad((points * square).sum(), [cup.get_parameter(next(iter(cup.layout)))])
    first = own.flatten(1).shape[1]
    known = evaluation.gradient[:, :first] * square[:, None] - own.flatten(1) / cup.steps[:first]
    torch.testing.assert_close(gradient[:, :first], known, rtol=1e-6, atol=1e-6)


def test_the_loss_follows_the_cup():
    cup = StripsCup(WIRE)
    start_cups(cup, [BALL])
    conditions = ConditionLoss(cup, [BALL])
    before = conditions()
    with torch.no_grad():
        cup.length[..., 0] += 0.3
    assert (conditions() > 1.5 * before).all()


def test_nothing_asked_costs_nothing():
    cup = StripsCup(WIRE)
    start_cups(cup, [SMALL := replace(BALL, neckline=None)])
    nothing = Conditions(neckline=0, rim=0, connection=0, barrier=0, fairness=0)
    assert (ConditionLoss(cup, [SMALL], nothing)() == 0).all()


def test_as_many_targets_as_cups():
    with pytest.raises(ValueError, match="1 cups need as many targets, got 2"):
        ConditionLoss(StripsCup(WIRE), [BALL, SMALL])
