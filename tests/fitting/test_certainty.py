from __future__ import annotations

import math
import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from lunes import lune_cup, lune_flat

from brafit.cup import StripsCup, Wire
from brafit.fitting import LM, Conditions, LMStage, ResultCode, Target
from brafit.fitting.certainty import Alternative, Alternatives, deviations, outline_deviation, outline_spread
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.targets import Targets
from brafit.geometry.development import FlatPanel, arc_lengths
from brafit.simulation.synthetic import on_panels
from brafit.surface import point_weights

SEEDS = 24
NOISE = 0.006
"""In solver units: about 0.5 mm on a breast."""


def cups(batch: int) -> StripsCup:
    wire = Wire.from_omega((0.15, 0.9, 0.1), math.pi)
    cup = StripsCup(wire.select(torch.zeros(batch, dtype=torch.long)), 2, 5, nodes=32)
    share = torch.tensor([0.5, 1.0], dtype=torch.float64)
    cup.start((share * math.pi / 2).expand(batch, -1), torch.ones(batch, 2, dtype=torch.float64))
    return cup


def scans(noise: float, seeds: int = SEEDS) -> Objective:
    """Scans of the cup that `cups` starts with: the same 400 places, other noise each."""
    cup = cups(seeds)
    truth = cup.shape_of(cup.flatten().detach()).map(lambda v: v[0])
    wire, line = truth.edges[0].numpy(), truth.edges[-1].numpy()
    points, targets = on_panels(truth, 400, np.random.default_rng(99)).numpy(), []
    for k in range(seeds):
        cloud = points + noise * np.random.default_rng(k).normal(size=points.shape)
        targets.append(Target(str(k), cloud, wire, line, None, None))
    stacked = Targets.stack(targets, torch.ones(seeds, dtype=torch.float64))
    return Objective(cup, stacked, Conditions(neckline=0.02, neckline_limit=None))


def flat_lengths(flat: torch.Tensor) -> torch.Tensor:
    """Lengths of the ridge and of the upper edge in the flat panels."""
    shape = cups(len(flat)).shape_of(flat)
    return arc_lengths(shape.flat().upper, shape.stations)[..., -1]


def predicted(flat: torch.Tensor, changes: torch.Tensor) -> torch.Tensor:
    """The standard deviation of these lengths for every fit."""
    batch, count, size = changes.shape
    others = flat_lengths((flat[:, None] + changes).reshape(-1, size)).view(batch, count, 2)
    return (others - flat_lengths(flat)[:, None]).square().sum(1).sqrt()


@pytest.fixture(scope="module")
def fits() -> tuple[Objective, torch.Tensor, Pressure]:
    objective = scans(NOISE)
    solution = LM([LMStage(steps=40, tolerance=1e-8)]).solve(objective, objective.cup.flatten().detach(), None)
    assert set(solution.codes) == {ResultCode.CONVERGED}
    return objective, solution.flat, solution.pressure


def test_lengths_of_repeated_fits_scatter_as_each_fit_predicts(fits):
    """A truth by experiment: ridge and upper edge over many scans of one breast."""
    objective, flat, pressure = fits
    seen = flat_lengths(flat).std(0)
    foretold = predicted(flat, deviations(objective, flat, pressure)).median(0).values
    ratio = foretold / seen
    assert seen.min() > 1e-4
    assert ((ratio > 0.5) & (ratio < 2)).all(), ratio


def test_parameters_scatter_as_predicted_when_no_direction_is_left_out(fits):
    objective, flat, pressure = fits
    changes = deviations(objective, flat, pressure, count=flat.shape[1])
    ratio = changes.square().sum(1).sqrt().median(0).values / flat.std(0)
    used = torch.arange(flat.shape[1]) != objective.cup.corner_place
    assert 0.7 < ratio[used].median() < 1.4
    assert ((ratio[used] > 0.4) & (ratio[used] < 2.5)).all(), ratio


def test_a_corner_that_nothing_asks_for_stays_in_its_place(fits):
    """Without a strap point no scan moves it along the edge."""
    objective, flat, pressure = fits
    place = objective.cup.corner_place
    assert (flat[:, place] == 0).all()
    assert (deviations(objective, flat, pressure)[..., place] == 0).all()


def test_deviations_are_the_same_alone_as_in_a_batch(fits):
    """To the last bit."""
    objective, flat, pressure = fits
    together = deviations(objective, flat, pressure)
    for k in (0, 5):
        index = torch.tensor([k])
        alone = deviations(objective.select(index), flat[index], pressure.select(index))[0]
        assert torch.equal(alone, together[k])


def test_a_problem_that_nothing_holds_has_no_deviations(fits):
    """And spoils no other's; without noise there are none."""
    objective, flat, pressure = fits
    some = torch.tensor([0, 1])
    known = deviations(objective.select(some), flat[some], pressure.select(some))
    clean = scans(0.0, seeds=1)
    truth = clean.cup.flatten().detach()
    assert deviations(clean, truth, Pressure(1.0)).abs().max() < 1e-3 * known.abs().max()

    free = replace(objective.targets.select(some), has_neckline=torch.tensor([True, False]))
    free.weights[1] = 0
    nothing = Conditions(neckline=0.02, neckline_limit=None, barrier=0, fairness=0)
    left = deviations(Objective(cups(2), free, nothing), flat[some], Pressure(1.0))
    assert bool(left[0].isfinite().all())
    assert bool(left[1].isnan().all())


@pytest.fixture(scope="module")
def misfits() -> tuple[Objective, torch.Tensor, Pressure]:
    """Fits of a breast that no cup of two panels follows, below the ridge: points drawn anew each time, and noise."""
    cup = cups(SEEDS)
    truth = cup.shape_of(cup.flatten().detach()).map(lambda v: v[0])
    middle, targets = truth.edges[1].numpy().mean(axis=0) * (0, 1, 0), []
    for k in range(SEEDS):
        random = np.random.default_rng([7, k])
        points = on_panels(truth, 400, random).numpy()
        away = points - middle
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        points = middle + 0.6 * away + 0.4 * (points - middle) + NOISE * random.normal(size=points.shape)
        weights = point_weights(points)
        marks = truth.edges[0].numpy(), truth.edges[-1].numpy()
        targets.append(Target(str(k), points, *marks, None, None, None, weights))
    stacked = Targets.stack(targets, torch.ones(SEEDS, dtype=torch.float64))
    objective = Objective(cup, stacked, Conditions(neckline=0.02, neckline_limit=None))
    solution = LM([LMStage(steps=60, tolerance=1e-8)]).solve(objective, cup.flatten().detach(), None)
    assert set(solution.codes) == {ResultCode.CONVERGED}
    return objective, solution.flat, solution.pressure


def test_lengths_scatter_as_predicted_where_the_cup_fits_badly(misfits):
    objective, flat, pressure = misfits
    seen = flat_lengths(flat).std(0)
    foretold = predicted(flat, deviations(objective, flat, pressure)).median(0).values
    assert ((foretold / seen > 1 / 2) & (foretold / seen < 2)).all(), foretold / seen


def test_deviations_of_a_bad_fit_are_the_same_alone_as_in_a_batch(misfits):
    objective, flat, pressure = misfits
    together = deviations(objective, flat, pressure)
    index = torch.tensor([3])
    alone = deviations(objective.select(index), flat[index], pressure.select(index))[0]
    assert torch.equal(alone, together[3])


def test_noise_twice_as_strong_moves_cups_twice_as_far():
    sizes = []
    for noise in (NOISE / 2, NOISE):
        objective = scans(noise, seeds=3)
        flat = objective.cup.flatten().detach()
        sizes.append(predicted(flat, deviations(objective, flat, Pressure(1.0))))
    torch.testing.assert_close(sizes[1] / sizes[0], torch.full_like(sizes[0], 2.0), rtol=0.1, atol=0)


def test_alternatives_are_made_on_the_stations_of_the_fit(fits):
    """A sequence whose items are the cups with the changed parameters, in millimetres."""
    objective, flat, pressure = fits
    changes, wire = deviations(objective, flat, pressure)[0], objective.cup.wire.select(torch.tensor([0]))
    own = partial(StripsCup, panels=2, terms=5, nodes=32, stations=51)
    alternatives = Alternatives(own, wire, flat[0], changes, 101)
    assert len(alternatives) == len(changes)
    shape = own(wire, stations=101).shape_of(flat[:1] + changes[3:4])
    torch.testing.assert_close(alternatives[3].shape.edges, shape.edges[0] * wire.scale)
    assert len(alternatives[2:4]) == 2
    assert pickle.loads(pickle.dumps(alternatives))[0].panels[1].upper.shape == (101, 2)


def test_the_largest_deviation_is_found_at_the_nodes(fits):
    """Against the outlines of all alternatives on the stations of the output."""
    objective, flat, pressure = fits
    changes = deviations(objective, flat, pressure)
    cup, wires = objective.cup, objective.cup.wire
    found = outline_spread(cup, flat, changes) * wires.scale
    for k in range(4):
        wire = wires.select(torch.tensor([k]))
        made = partial(StripsCup, panels=2, terms=5, nodes=32)
        alternatives = Alternatives(made, wire, flat[k], changes[k], 201)
        fit = Alternatives(made, wire, flat[k], torch.zeros_like(changes[k, :1]), 201)[0]
        known = max(float(edge.max()) for pair in outline_deviation(fit.panels, alternatives) for edge in pair)
        assert found[k].item() == pytest.approx(known, rel=0.02)
    assert outline_spread(cup, flat, changes[:, :0]).isnan().all()


def moved(panels: list[FlatPanel], angle: float, scale: float = 1.0) -> Alternative:
    """Every panel turned, shifted and scaled."""
    turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]], dtype=torch.float64)
    shift = torch.tensor([30.0, -7.0], dtype=torch.float64)
    own = [FlatPanel(scale * p.lower @ turn + shift, scale * p.upper @ turn + shift) for p in panels]
    return Alternative(lune_cup(len(panels)), own)


def test_a_rigid_motion_does_not_move_outlines():
    panels = lune_flat(2)
    for lower, upper in outline_deviation(panels, [moved(panels, 0.7), moved(panels, -2.5)]):
        assert max(lower.max(), upper.max()) < 1e-10


def test_outlines_of_larger_pieces_move_by_their_distance_from_the_middle():
    """Across the outline; two alternatives, 3 % larger and 4 % smaller, add up in squares."""
    panels = lune_flat(2, n=401)
    (lower, upper), _ = outline_deviation(panels, [moved(panels, 0.4, 1.03), moved(panels, 2.0, 0.96)])
    middle = 0.5 * (panels[0].lower + panels[0].upper).mean(0).numpy()
    for edge, found in ((panels[0].lower.numpy(), lower), (panels[0].upper.numpy(), upper)):
        tangent = np.gradient(edge, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        x, y = (edge - middle).T
        expected = 0.05 * np.abs(x * tangent[:, 1] - y * tangent[:, 0])
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_nothing_is_uncertain_without_alternatives():
    for lower, upper in outline_deviation(lune_flat(3), []):
        assert not lower.any()
        assert not upper.any()
