from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import ellipe

from brafit.geometry.fairness import EdgeCurvature, Variation

S = 1.5 * (1 - torch.cos(torch.linspace(0, math.pi, 61, dtype=torch.float64)))
"""Uneven places from 0 to 3."""
SPEED = 2 + torch.sin(2 * S)
ARC = 2 * S + (1 - torch.cos(2 * S)) / 2
"""The integral of SPEED."""


def arc(radius: float, start: float, end: float, count: int = 101) -> np.ndarray:
    angle = np.linspace(start, end, count)
    return radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def test_a_circle_is_perfectly_fair_at_any_speed():
    assert Variation(SPEED / 40, SPEED, S.diff()).residual.abs().max() < 1e-15


def test_a_clothoid_varies_by_the_square_of_its_rate_on_all_its_length():
    c = 0.3
    variation = Variation(c * ARC * SPEED, SPEED, S.diff())
    assert variation.residual.square().sum().item() == pytest.approx(c**2 * ARC[-1].item(), rel=1e-3)
    assert variation.lengths.sum().item() == pytest.approx(ARC[-1].item(), rel=1e-3)
    halved = Variation(c * ARC * SPEED, SPEED, S.diff(), torch.full_like(S[1:], 0.5))
    torch.testing.assert_close(halved.residual, 0.5 * variation.residual)


@pytest.mark.parametrize("shared", [False, True])
def test_columns_against_central_differences(shared):
    random = torch.Generator().manual_seed(1)
    rate, speed = (
        torch.rand(2, 2, len(S), generator=random, dtype=torch.float64) + torch.tensor([-0.5, 0.5])[:, None, None]
    )
    share = torch.rand(2, len(S) - 1, generator=random, dtype=torch.float64) if shared else 1.0
    by_rate, by_speed = torch.randn(2, 2, len(S), 4, generator=random, dtype=torch.float64)
    columns = Variation(rate, speed, S.diff(), share).columns(by_rate, by_speed)
    h = 1e-6
    for k in range(4):
        ahead, behind = (
            Variation(rate + sign * by_rate[..., k], speed + sign * by_speed[..., k], S.diff(), share).residual
            for sign in (h, -h)
        )
        difference = (ahead - behind) / (2 * h)
        assert (columns[..., k] - difference).abs().max() < 1e-7 * difference.abs().max()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_circle_bends_alike_everywhere_and_to_its_side(sign):
    bend = EdgeCurvature.of(arc(40, 0, sign * math.pi))
    assert bend.inflections() == [0]
    assert bend.tightest()[0] == pytest.approx(40, rel=1e-3)
    np.testing.assert_allclose(bend.curvature, sign / 40, rtol=1e-3)


@pytest.mark.parametrize("periods", [1, 3, 5])
def test_a_sine_wave_turns_at_every_half_period(periods):
    x = np.linspace(0, 60 * periods, 100 * periods + 1)
    wave = np.stack((x, 10 * np.sin(2 * np.pi * x / 60)), axis=1)
    bend = EdgeCurvature.of(wave)
    assert bend.inflections() == [2 * periods - 1]  # its two ends, where it would turn too, are left out
    assert bend.tightest()[0] == pytest.approx(1 / (10 * (2 * np.pi / 60) ** 2), rel=0.01)


def test_a_wave_that_is_nearly_straight_has_no_inflections():
    x = np.linspace(0, 300, 501)
    wave = np.stack((x, 0.15 * np.sin(2 * np.pi * x / 60)), axis=1)  # curvature 0.0016 at most
    assert EdgeCurvature.of(wave).inflections() == [0]


def test_an_ellipse_is_tightest_at_the_ends_of_its_long_axis():
    a, b = 60.0, 30.0
    angle = np.linspace(-np.pi / 2, np.pi / 2, 201)
    radius, place = EdgeCurvature.of(np.stack((a * np.cos(angle), b * np.sin(angle)), axis=1)).tightest()
    assert radius == pytest.approx(b**2 / a, rel=1e-3)
    assert place == pytest.approx(a * ellipe(1 - (b / a) ** 2), rel=1e-3)


@pytest.mark.parametrize("turn", [0.8, -0.8])
def test_a_corner_is_no_bend(turn):
    """Two arcs that meet at an angle, repeated points at the corner included."""
    first = arc(50, 0, 1.6)
    second = arc(70, 0, 1.2)
    c, s = math.cos(1.6 + turn), math.sin(1.6 + turn)
    rotation = np.array([[c, -s], [s, c]])
    second = (second - second[0]) @ rotation.T + first[-1]
    curve = np.concatenate((first, second))
    bend = EdgeCurvature.of(curve, first[-1])
    assert len(bend.runs) == 2
    assert not (bend.runs[0] & bend.runs[1]).any()
    assert bend.inflections() == [0, 0]
    radius, place = bend.tightest()
    assert radius == pytest.approx(50, rel=0.01)
    assert place < 50 * 1.6 - 9
    np.testing.assert_allclose(bend.curvature[bend.runs[1]], 1 / 70, rtol=0.01)
    assert EdgeCurvature.of(curve).tightest()[0] < 10
