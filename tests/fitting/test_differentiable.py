"""Derivatives through the fit against fits of changed data: clouds that lie on a known cup, in double precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jaxtyping
import numpy as np
import pytest
import torch
from torch import Tensor

from brafit.cup import FramesCup, StripsCup, Wire
from brafit.fitting import LM, Conditions, DifferentiableFit, FittedCups, LMStage, Target, TensorTarget, fit_targets
from brafit.fitting.objective import WEIGHTS
from brafit.geometry.development import FlatPanel
from brafit.pattern import pieces_from_panels
from brafit.simulation.synthetic import on_panels

SCALE = 70.0
PLACES = ("points", "wire", "neckline", "strap_point", "apex")
MODEL = partial(StripsCup, panels=2, terms=5, stations=61, nodes=32, output_nodes=48)
SOLVER = LM([LMStage(steps=60, tolerance=1e-6)])
CLOSE = Conditions(neckline=0.1, neckline_limit=None, neckline_wave=0.0, fairness=0.0, connection=0.0)
"""Nothing but what a cloud on a cup, with its upper edge as neckline, fulfils."""
ALL = Conditions(
    neckline_limit=None, connection=0.01, ridge_apex=0.01, margin=0.9, margin_width=0.05, barrier=0.01, fairness=3.0
)
"""Every condition pulls."""


def on_a_cup(seed: int, count: int, neckline: bool = True) -> Target:
    """A cloud exactly on a cup of the model, with all marks; where none is given, without a neckline."""
    generator = torch.Generator().manual_seed(seed)
    s = np.linspace(0, 1, 15)
    points = np.stack((np.sin(np.pi * s), 1 - np.cos(np.pi * s), 0.1 * np.sin(2 * np.pi * s)), axis=1)
    wire = SCALE * points * (1, 1 + 0.05 * seed, 1)
    cup = MODEL(Wire.from_polyline(wire))
    share = torch.tensor([[0.8, 1.5]], dtype=torch.float64)
    cup.start(share, torch.ones_like(share))
    flat = cup.flatten().detach()
    change = 0.03 * torch.randn(flat.shape, generator=generator, dtype=torch.float64)
    change[:, -3:] = 0  # no corner
    shape = cup.shape_of(flat + change).map(lambda v: v[0])
    shape = replace(shape, edges=shape.edges * cup.wire.scale, tangents=shape.tangents * cup.wire.scale)
    upper, ridge = shape.edges[-1].numpy(), shape.edges[1].numpy()
    cloud = on_panels(shape, count, np.random.default_rng(seed)).numpy()
    return Target(f"cup {seed}", cloud, wire, upper if neckline else None, upper[30] + (1, 2, 1), ridge[28])


TARGETS = (on_a_cup(1, 260), on_a_cup(2, 200))


def fit(condition: Conditions, matrix: Any = "full") -> DifferentiableFit:
    return DifferentiableFit(MODEL, SOLVER, condition, matrix=matrix)


def leaves(targets: tuple[Target, ...] = TARGETS) -> list[TensorTarget]:
    """Targets all of whose places ask for derivatives."""
    given = [{k: v for k in PLACES if (v := getattr(target, k)) is not None} for target in targets]
    tensors = [{k: torch.from_numpy(v.copy()).requires_grad_() for k, v in own.items()} for own in given]
    return [TensorTarget.of(target, **own) for target, own in zip(targets, tensors, strict=True)]


def measured(cups: FittedCups) -> Tensor:
    """What derivatives are taken of, (B, 6): lengths of the edges in the patterns, and three sums, of parameters and of
    places on the flat edges, with weights at random.
    """
    flat = torch.cat((cups.flat.lower, cups.flat.upper), dim=1).flatten(1)
    random = torch.Generator().manual_seed(5)
    weights = [torch.randn(v.shape[1], 3, generator=random, dtype=v.dtype) for v in (cups.parameters, flat)]
    sums = SCALE * cups.parameters @ weights[0] + 0.1 * flat @ weights[1]
    return torch.cat((cups.lengths(), sums), dim=1)


def gradients(cups: FittedCups, inputs: Sequence[Tensor]) -> list[list[Tensor]]:
    """Of the sum over the batch of each measure, by each of the inputs."""
    values = measured(cups).sum(0)
    return [list(torch.autograd.grad(value, inputs, retain_graph=True, materialize_grads=True)) for value in values]


def off(found: Tensor, known: Tensor) -> float:
    """Relative error of the derivatives of all measures that depend on the data at all, the largest over the batch."""
    return float(((found - known).norm(dim=1) / known.norm(dim=1)).max())


def differences(fits: DifferentiableFit, targets: Sequence[Sequence[Target]], near: FittedCups, step: float) -> Tensor:
    """Central differences of the measures between the two batches of targets, whose places come as arrays."""
    ends = [measured(fits([TensorTarget.of(t) for t in batch], near=near)).detach() for batch in targets]
    return (ends[0] - ends[1]) / (2 * step)


def moved(place: str, targets: Sequence[Target], step: float) -> tuple[list[Tensor], list[list[Target]]]:
    """A direction at random for each target's place, and the targets moved there and back."""
    random = np.random.default_rng(3)
    directions = [random.normal(size=getattr(t, place).shape) for t in targets]
    pairs = list(zip(targets, directions, strict=True))
    both = [[replace(t, **{place: getattr(t, place) + h * d}) for t, d in pairs] for h in (step, -step)]
    return [torch.from_numpy(d) for d in directions], both


def along(rows: Sequence[Sequence[Tensor]], first: int, directions: Sequence[Tensor]) -> Tensor:
    """Derivatives (B, measures) along directions, from gradients by inputs of which these items' begin at `first`."""
    each = [[(row[first + k] * d).sum() for k, d in enumerate(directions)] for row in rows]
    return torch.stack([torch.stack(own) for own in each], dim=1)


class Batch:
    """The two cups with every condition, and the gradients of the measures by all data, by `full` Hessian."""

    def __init__(self) -> None:
        self.scans = leaves()
        self.shares = {name: torch.ones(2, dtype=torch.float64, requires_grad=True) for name in WEIGHTS}
        self.cups = fit(ALL)(self.scans, shares=self.shares)
        self.places = [getattr(scan, place) for place in PLACES for scan in self.scans]
        self.rows = gradients(self.cups, [*self.places, *self.shares.values()])

    def along(self, place: str, directions: Sequence[Tensor]) -> Tensor:
        return along(self.rows, 2 * PLACES.index(place), directions)

    def by_share(self, name: str) -> Tensor:
        number = len(self.places) + list(self.shares).index(name)
        return torch.stack([row[number] for row in self.rows], dim=1)


@pytest.fixture(scope="module")
def batch() -> Batch:
    made = Batch()
    assert bool(made.cups.settled.all())
    return made


@pytest.mark.parametrize("place", PLACES)
def test_derivatives_by_places_are_those_between_fits_of_moved_ones(batch, place):
    """All conditions pull, and each item of the batch moves in a direction of its own."""
    step = 1e-3
    directions, both = moved(place, TARGETS, step)
    known = differences(fit(ALL), both, batch.cups, step)
    assert known.norm(dim=1).min() > 1e-3
    assert off(batch.along(place, directions), known) < 1e-4


@pytest.mark.parametrize("name", ["neckline", "connection", "ridge_apex", "barrier", "fairness"])
def test_derivatives_by_weights_are_those_between_fits_with_other_conditions(batch, name):
    step, ends = 1e-3, []
    for sign in (1, -1):
        changed = replace(ALL, **{name: getattr(ALL, name) * (1 + sign * step)})
        ends.append(measured(fit(changed)([TensorTarget.of(t) for t in TARGETS], near=batch.cups)).detach())
    known = (ends[0] - ends[1]) / (2 * step)
    assert known.norm(dim=1).min() > 1e-6
    assert off(batch.by_share(name), known) < 1e-4


def test_more_weight_for_everything_changes_nothing(batch):
    """A truth of its own: the optimum of c F is that of F."""
    total = torch.stack([batch.by_share(name) for name in WEIGHTS]).sum(0)
    largest = torch.stack([batch.by_share(name).abs() for name in WEIGHTS]).amax(0)
    assert (total.abs() < 1e-8 * largest.amax()).all()


def test_a_motion_of_all_data_moves_no_pattern(batch):
    """Shifted and turned, points and marks make the same pieces, whatever the cup frame."""
    turn = torch.tensor([[0.0, 0.3, -0.5], [-0.3, 0.0, 0.7], [0.5, -0.7, 0.0]], dtype=torch.float64)
    for motion in (torch.ones_like, lambda places: places @ turn):
        moves = [[motion(getattr(scan, place).detach()) for scan in batch.scans] for place in PLACES]
        rates = torch.stack([batch.along(place, move) for place, move in zip(PLACES, moves, strict=True)])
        assert rates[..., :3].abs().amax() > 1.0
        assert rates.sum(0)[:, :3].abs().max() < 1e-6 * rates.abs().amax()


@pytest.mark.slow
def test_derivatives_are_those_between_fits_of_the_solver_from_the_start():
    """Independent fits: Levenberg-Marquardt alone, which knows no Hessian. They end within 1e-5 mm of the optimum."""
    step, condition, target = 1e-2, replace(CLOSE, fairness=3.0), replace(TARGETS[1], strap_point=None)
    solver = LM([LMStage(steps=300, tolerance=1e-16)])
    (scan,) = leaves((target,))
    cups = DifferentiableFit(MODEL, solver, condition)([scan])
    assert cups.moved.max() < 1e-5
    direction, ends = (target.points - target.points.mean(axis=0)) / SCALE, []
    for sign in (1, -1):
        moved = replace(target, points=target.points + sign * step * direction)
        (found,) = fit_targets([moved], MODEL, solver, condition)
        parts = [torch.as_tensor(v, dtype=torch.float64).flatten() for v in found.parameters.values()]
        ends.append(torch.cat(parts))
    weights = torch.randn(len(ends[0]), 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    known = (ends[0] - ends[1]) / (2 * step) @ weights
    rows = [torch.autograd.grad(v, scan.points, retain_graph=True)[0] for v in (cups.parameters[0] @ weights).unbind()]
    rates = torch.stack([(row * torch.from_numpy(direction)).sum() for row in rows])
    assert off(rates[None], known[None]) < 1e-4


@pytest.mark.slow
def test_gauss_newton_is_near_where_little_is_left_and_off_where_conditions_pull():
    """It leaves out what is in proportion to the residuals. A clean recovery has almost none."""
    target, errors = (replace(TARGETS[0], strap_point=None),), []
    for condition in (CLOSE, ALL):
        near, found = None, []
        for matrix in ("full", "gauss-newton"):
            scans = leaves(target)
            near = fit(condition, matrix=matrix)(scans, near=near)
            found.append(torch.stack([row[0] for row in gradients(near, [scans[0].points])]))
        errors.append(float((found[1] - found[0]).norm() / found[0].norm()))
    assert errors[0] < 0.05
    assert 0.1 < errors[1] < 1.0


def test_derivatives_in_a_batch_are_those_alone(batch):
    """The shorter cloud is padded in the batch."""
    scan = leaves()[1]
    cups = fit(ALL)([scan])
    torch.testing.assert_close(cups.parameters[0], batch.cups.parameters[1], rtol=1e-8, atol=1e-9)
    alone = gradients(cups, [getattr(scan, place) for place in PLACES])
    for row, together in zip(alone, batch.rows, strict=True):
        for number, own in enumerate(row):
            torch.testing.assert_close(own, together[2 * number + 1], rtol=1e-6, atol=1e-8)


def test_a_cloud_without_a_neckline_tells_where_it_ends():
    """The rim's condition, its points, normals and spacing are differentiated through."""
    target, step = on_a_cup(1, 260, neckline=False), 1e-4
    condition = Conditions(connection=0.0, rim=0.3, fairness=3.0)
    (scan,) = leaves((target,))
    cups = fit(condition)([scan])
    assert bool(cups.settled.all())
    (direction,), both = moved("points", (target,), step)
    known = differences(fit(condition), both, cups, step)
    found = along(gradients(cups, [scan.points]), 0, [direction])
    assert off(found, known) < 1e-4


def test_what_is_no_differentiable_fit_is_refused():
    target = TARGETS[0]
    scan = TensorTarget.of(target)
    frames = DifferentiableFit(partial(FramesCup, panels=2, terms=3, stations=21), SOLVER, CLOSE)
    with pytest.raises(ValueError, match="FramesCup has constraints"):
        frames([scan])
    with pytest.raises(ValueError, match="unknown weight 'necklines': allowed are points"):
        fit(CLOSE)([scan], shares={"necklines": torch.ones(())})
    jaxtyping.config.update("jaxtyping_disable", True)  # which would refuse it first, by its type
    try:
        with pytest.raises(ValueError, match="unknown matrix 'newton': allowed are full, gauss-newton"):
            fit(CLOSE, matrix="newton")
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)
    with pytest.raises(ValueError, match=r"points is torch\.float32"):
        TensorTarget.of(target, points=torch.as_tensor(target.points, dtype=torch.float32))
    with pytest.raises(TypeError, match="'weights' is no place of a scan: there are points, wire"):
        TensorTarget.of(target, weights=torch.ones(260))
    with pytest.raises(ValueError, match=r"points have the shape \(3, 3\), the target's \(260, 3\)"):
        TensorTarget.of(target, points=torch.zeros(3, 3, dtype=torch.float64))


def test_extents_are_those_of_the_pieces_and_move_with_their_outermost_points(batch):
    cups = batch.cups
    for k in range(2):
        panels = [
            FlatPanel(*edges) for edges in zip(cups.flat.lower[k].detach(), cups.flat.upper[k].detach(), strict=True)
        ]
        boxes = [
            np.ptp(np.vstack([edge.points for edge in piece.edges]), axis=0) for piece in pieces_from_panels(panels)
        ]
        np.testing.assert_allclose(cups.extents()[k].detach(), boxes, atol=1e-9)
    lower = torch.tensor([[0.0, 0], [3, -1], [8, 0]], dtype=torch.float64).expand(1, 1, 3, 2).clone().requires_grad_()
    upper = torch.tensor([[0.0, 0], [9, 4], [8, 0]], dtype=torch.float64).expand(1, 1, 3, 2).clone().requires_grad_()
    extents = replace(cups, flat=FlatPanel(lower, upper)).extents()
    torch.testing.assert_close(extents, torch.tensor([[[9.0, 5.0]]], dtype=torch.float64))
    by_lower, by_upper = torch.autograd.grad(extents[0, 0, 1], (lower, upper))
    assert by_lower[0, 0].tolist() == [[0, 0], [0, -1], [0, 0]]
    assert by_upper[0, 0].tolist() == [[0, 0], [0, 1], [0, 0]]
