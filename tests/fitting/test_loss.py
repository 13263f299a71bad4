from __future__ import annotations

import math
from functools import partial

import pytest
import torch

from brafit.fitting.loss import cauchy, fuzzy, point_loss, smooth_absolute, square

LOSSES = {
    "square": square,
    "smooth_absolute": partial(smooth_absolute, width=0.3),
    "cauchy": partial(cauchy, width=0.3),
    "fuzzy": partial(fuzzy, strength=0.7, sharpness=2.5),
}
EDGE = 2 / math.sqrt(2.5)
"""Where `fuzzy` above goes over into its tangent."""


@pytest.mark.parametrize("name", LOSSES)
def test_slopes_are_those_of_the_values(name):
    squared = torch.tensor([1e-4, 0.01, 0.5, EDGE**2 - 1e-3, EDGE**2 + 1e-3, 9.0, 400.0], dtype=torch.float64)
    h = 1e-5 * squared
    difference = (LOSSES[name](squared + h)[0] - LOSSES[name](squared - h)[0]) / (2 * h)
    torch.testing.assert_close(LOSSES[name](squared)[1], difference, rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", LOSSES)
def test_zero_residuals_cost_nothing_and_automatic_differentiation_agrees(name):
    assert LOSSES[name](torch.zeros(1, dtype=torch.float64))[0].item() == pytest.approx(0, abs=1e-15)
    squared = torch.tensor([0.0, 0.3, 30.0], dtype=torch.float64, requires_grad=True)
    value, slope = LOSSES[name](squared)
    (gradient,) = torch.autograd.grad(value.sum(), squared)
    torch.testing.assert_close(gradient, slope.detach())


def test_fuzzy_is_42_within_its_widths():
    r = torch.linspace(0, 0.99 * EDGE, 9, dtype=torch.float64)
    expected = 0.7 * torch.exp(2.5 * r**2) - 0.7
    torch.testing.assert_close(LOSSES["fuzzy"](r**2)[0], expected)


def test_fuzzy_goes_on_as_the_tangent_without_step_or_bend():
    r = torch.tensor([EDGE * (1 - 1e-7), EDGE * (1 + 1e-7)], dtype=torch.float64)
    value, slope = LOSSES["fuzzy"](r**2)
    torch.testing.assert_close(value[0], value[1], rtol=1e-5, atol=0)
    torch.testing.assert_close(slope[0], slope[1], rtol=1e-5, atol=0)
    far = torch.tensor([3.0, 4.0, 5.0], dtype=torch.float64)
    rise = LOSSES["fuzzy"](far**2)[0].diff()
    torch.testing.assert_close(rise, torch.full_like(rise, 0.7 * 2 * 2.5 * EDGE * math.exp(4)))


def test_fuzzy_does_not_overflow(dtype):
    value, slope = fuzzy(torch.tensor([1e12], dtype=dtype), 1.0, 1e6)
    assert value.isfinite()
    assert slope.isfinite()


def test_known_values():
    squared = torch.tensor([0.0, 9.0], dtype=torch.float64)
    torch.testing.assert_close(square(squared)[0], squared)
    torch.testing.assert_close(smooth_absolute(squared, 1e-9)[0], squared.sqrt(), rtol=0, atol=1e-8)
    torch.testing.assert_close(cauchy(squared, 3.0)[0], torch.tensor([0.0, 9 * math.log(2)], dtype=torch.float64))
    torch.testing.assert_close(cauchy(squared, 1e6)[0], squared)


def test_losses_by_name():
    squared = torch.tensor([4.0], dtype=torch.float64)
    for name, loss in (("l2", square), ("l1", LOSSES["smooth_absolute"]), ("robust", LOSSES["cauchy"])):
        assert point_loss(name, 0.3)(squared) == loss(squared)
    with pytest.raises(ValueError, match=r"unknown point loss 'huber'.*l1, l2, robust"):
        point_loss("huber", 1.0)
