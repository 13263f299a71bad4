from __future__ import annotations

import numpy as np
import pytest
import torch
from bends import needless, stretches
from cups import lune_frames, near, varied
from cups import plain_strips as strips

from brafit.cup import StripsCup
from brafit.fitting import Conditions, Target, fairness
from brafit.fitting.fairness import WAVE_SLOPE, WAVES, Shares, fairness_blocks, wavy
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.targets import Targets
from brafit.geometry.fairness import EdgeCurvature

SPANS = 0.02 + 0.01 * torch.arange(40, dtype=torch.float64) / 40
PLACES = torch.cat((SPANS.new_zeros(1), SPANS.cumsum(0)))

HEIGHT = torch.full((2,), 0.5, dtype=torch.float64)


def sizes(curvature: torch.Tensor) -> float:
    """What the sizes of the changes count, without their squares."""
    squared = curvature.diff().square() / SPANS
    return (wavy(squared, SPANS)[0] - squared).sum().item()


def test_its_slope_is_that_of_its_value():
    squared = torch.logspace(-6, 3, 40, dtype=torch.float64)
    h = 1e-5 * squared
    difference = (wavy(squared + h, SPANS, 0.7)[0] - wavy(squared - h, SPANS, 0.7)[0]) / (2 * h)
    torch.testing.assert_close(wavy(squared, SPANS, 0.7)[1], difference, rtol=1e-6, atol=0)


def test_no_share_leaves_the_squares_and_no_change_costs_nothing():
    squared = torch.linspace(0, 9, 40, dtype=torch.float64)
    torch.testing.assert_close(wavy(squared, SPANS, 0.0)[0], squared)
    assert sizes(torch.full_like(PLACES, 3.0)) == pytest.approx(0, abs=1e-15)


def test_a_rise_counts_alike_however_steep_and_every_wave_adds_its_height_twice():
    end = PLACES[-1]
    even, steep = 400 * PLACES, 400 * end * torch.sigmoid(12 * (PLACES / end - 0.5))
    total = (steep[-1] - steep[0]).item()
    assert sizes(even) == pytest.approx(WAVES * 400 * end.item(), rel=5e-3)
    assert sizes(steep) == pytest.approx(WAVES * total, rel=2e-2)
    wave = 100 * (1 - (torch.arange(len(PLACES)) - 30).abs() / 4).clamp_min(0).to(PLACES)
    assert sizes(wave) == pytest.approx(2 * WAVES * 100, rel=2e-2)


def test_small_changes_count_by_their_squares():
    slope = 1e-3 * WAVE_SLOPE
    assert sizes(slope * PLACES) == pytest.approx(WAVES / (2 * WAVE_SLOPE) * slope**2 * PLACES[-1].item(), rel=1e-5)


def test_a_stage_s_shares_count_only_while_it_runs():
    cup = strips(2)
    flat = varied(cup)
    unfair = cup.unfairness(flat)
    full = fairness_blocks(cup, flat, unfair, 2.0, Shares(), HEIGHT)
    part = fairness_blocks(cup, flat, unfair, 2.0, Shares(fairness=3.0, plainness=5.0, waves=0.0), HEIGHT)
    torch.testing.assert_close(part[0].value(), 3 * 2 * fairness.FAIRNESS * unfair.square().sum(-1))
    torch.testing.assert_close(part[1].value(), 5 * full[1].value())
    assert (full[0].value() > part[0].value() / 3).all()
    for one, other in zip(full, part, strict=True):
        torch.testing.assert_close(other.told(), one.value())


def test_each_change_has_its_span_and_series_have_none():
    cup = strips(2)
    assert cup.spans.shape == cup.unfairness(varied(cup)).shape[1:]
    assert cup.spans.sum().item() == pytest.approx(2 * cup.panels * (cup.grid.s[-1] - cup.grid.s[0]).item())
    frames = lune_frames(2)
    flat = near(frames)
    own = fairness_blocks(frames, flat, frames.unfairness(flat), 1.0, Shares(), HEIGHT)[0]
    torch.testing.assert_close(own.value(), fairness.FAIRNESS * frames.unfairness(flat).square().sum(-1))


def waved(count: int, height: float) -> EdgeCurvature:
    """An arc of radius 60 whose curvature has waves."""
    arc = np.linspace(0, 120, 401)
    turn = arc / 60 + height * np.sin(2 * np.pi * count * arc / 120)
    steps = np.diff(arc)[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=1)[:-1]
    return EdgeCurvature.of(np.concatenate((np.zeros((1, 2)), steps.cumsum(axis=0))))


def test_stretches_are_parted_by_the_inflections_and_bulge_as_arcs_do():
    plain = waved(3, 0.0)
    (own,) = stretches(plain, plain.runs[0])
    half = (own.end - own.start) / 2
    assert own.sign == 1
    assert own.depth == pytest.approx(60 * (1 - np.cos(half / 60)), rel=1e-3)
    rough = waved(3, 0.2)
    found = stretches(rough, rough.runs[0])
    assert len(found) - 1 == rough.inflections()[0] == 6
    assert [one.sign for one in found] == [1, -1, 1, -1, 1, -1, 1]


def test_what_is_needless_is_the_shallowest_that_has_to_go():
    rough = waved(3, 0.2)
    found = stretches(rough, rough.runs[0])
    assert needless("edge", found, 6) is None
    hollows = sorted(one.depth for one in found if one.sign < 0)
    one, all_of_it = needless("edge", found, 4), needless("edge", found, 0)
    assert one is not None
    assert all_of_it is not None
    assert (one.count, one.asked) == (6, 4)
    assert one.depth <= hollows[0] + 1e-9
    assert all_of_it.depth >= one.depth


def _targets(cup: StripsCup) -> Targets:
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wire = cup.wire.sample(cup.stations)[0].numpy()
    own = [Target(str(k), points.numpy(), wire, None, None, None) for k in range(cup.batch)]
    return Targets.stack(own, torch.ones(cup.batch, dtype=torch.float64))


def test_the_objective_asks_for_it():
    """More of a wave counts more than its squares say."""
    cup = strips(2)
    flat = varied(cup)
    shape = cup.sketch(flat)
    from_objective = {
        block.name: block
        for block in Objective(cup, _targets(cup), Conditions()).blocks(
            flat, shape, Pressure(1.0), shape.margin, cup.unfairness(flat)
        )
    }["fairness"]
    assert (from_objective.value() > fairness.FAIRNESS * cup.unfairness(flat).square().sum(-1)).all()
