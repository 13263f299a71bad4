"""Curves as tensors are those made of arrays, and their derivatives are right."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from brafit.cup import Wire
from brafit.fitting.differentiable import traced_side, traced_wire
from brafit.fitting.neckline import smooth_neckline
from brafit.geometry.polyline import evenly_spaced
from brafit.geometry.traced import spaced


def line(count: int = 40) -> np.ndarray:
    """A bent line in space, unevenly marked, with a little noise."""
    s = np.linspace(0, 1, count) ** 1.3
    curve = np.stack((60 * np.sin(np.pi * s), 120 * s, 8 * np.cos(3 * s)), axis=1)
    return curve + np.random.default_rng(0).normal(0, 0.2, curve.shape)


def test_a_wire_is_the_same_as_of_arrays():
    wire = Wire.from_polyline(line())
    coefficients, length = traced_wire(torch.from_numpy(line()), wire.coefficients.shape[1])
    torch.testing.assert_close(coefficients, wire.coefficients[0], rtol=0, atol=1e-10)
    torch.testing.assert_close(length, wire.length[0], rtol=1e-12, atol=0)


def test_points_that_repeat_count_once():
    twice = np.repeat(line(), 2, axis=0)
    for found, known in zip(
        traced_wire(torch.from_numpy(twice), 64), traced_wire(torch.from_numpy(line()), 64), strict=True
    ):
        torch.testing.assert_close(found, known, rtol=1e-12, atol=1e-12)


def test_a_neckline_is_the_same_as_of_arrays():
    smooth = smooth_neckline(line(), None, 45.0).sampled(81)
    found = spaced(traced_side(torch.from_numpy(line()), 45.0), 81)
    np.testing.assert_allclose(found.numpy(), smooth, atol=1e-9)
    np.testing.assert_allclose(spaced(torch.from_numpy(line()), 30).numpy(), evenly_spaced(line(), 30), atol=1e-12)


@pytest.mark.parametrize(
    "function",
    [
        lambda points: traced_wire(points, 24)[0],
        lambda points: traced_wire(points, 24)[1],
        lambda points: spaced(traced_side(points, 45.0), 20),
    ],
    ids=["wire", "length", "neckline"],
)
def test_derivatives_are_central_differences(function):
    points = torch.from_numpy(line(12)).requires_grad_()
    assert torch.autograd.gradcheck(function, (points,), eps=1e-4, atol=1e-6, rtol=1e-5)
