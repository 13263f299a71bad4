from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from brafit.geometry.grid import (
    chebyshev_analysis,
    chebyshev_derivative,
    chebyshev_integral,
    chebyshev_points,
    chebyshev_synthesis,
    sliding_derivative,
    sliding_integral,
    station_weights,
)


def function(x):
    return np.exp(np.sin(3 * x))


def slope(x):
    return 3 * np.cos(3 * x) * function(x)


def test_chebyshev_operators_are_spectral():
    x = chebyshev_points(48)
    assert x[0] == -1
    assert x[-1] == 1
    assert (np.diff(x) > 0).all()
    np.testing.assert_allclose(chebyshev_derivative(48) @ function(x), slope(x), atol=1e-9)
    np.testing.assert_allclose(chebyshev_integral(48) @ slope(x), function(x) - function(-1), atol=1e-12)
    np.testing.assert_allclose(chebyshev_derivative(48) @ np.ones(48), 0, atol=1e-11)


def test_chebyshev_interpolation_between_the_points():
    x, fine = chebyshev_points(48), np.linspace(-1, 1, 333)
    coefficients = chebyshev_analysis(48) @ function(x)
    np.testing.assert_allclose(chebyshev_synthesis(48, fine) @ coefficients, function(fine), atol=1e-12)
    np.testing.assert_allclose(chebyshev_synthesis(48, fine, 1) @ coefficients, slope(fine), atol=1e-9)


def uneven(n: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    t = torch.linspace(0, 1, n, dtype=torch.float64)
    return (2 * t + 0.3 * torch.sin(3 * t)).to(dtype)


@pytest.mark.parametrize("n", [3, 8, 9, 40])
def test_sliding_polynomials_are_exact_up_to_their_degree(n):
    x = uneven(n)
    powers = torch.arange(min(n, 8), dtype=torch.float64)
    values = x[:, None] ** powers
    slopes = powers * x[:, None] ** (powers - 1).clamp_min(0)
    torch.testing.assert_close(sliding_derivative(values, x), slopes, rtol=1e-9, atol=1e-9)
    areas = (x[:, None] ** (powers + 1) - x[0] ** (powers + 1)) / (powers + 1)
    torch.testing.assert_close(sliding_integral(values, x), areas, rtol=1e-9, atol=1e-9)


def test_sliding_orders():
    def errors(n: int) -> tuple[float, float]:
        x = uneven(n)
        derivative = sliding_derivative(torch.sin(4 * x)[:, None], x)[:, 0] - 4 * torch.cos(4 * x)
        integral = sliding_integral(4 * torch.cos(4 * x)[:, None], x)[:, 0] - (torch.sin(4 * x) - torch.sin(4 * x[0]))
        return derivative.abs().max().item(), integral.abs().max().item()

    coarse, fine = errors(31), errors(61)
    assert coarse[0] / fine[0] > 2**6.3
    assert coarse[1] / fine[1] > 2**7.3


def test_sliding_operators_for_any_batch_shape_and_type(dtype):
    x = uneven(21, dtype)
    values = torch.randn(2, 3, 21, 2, dtype=dtype)
    for operator in (sliding_derivative, sliding_integral):
        whole = operator(values, x)
        assert whole.dtype == dtype
        torch.testing.assert_close(whole[1, 2], operator(values[1, 2], x))


def test_station_weights_average_over_the_wire_whatever_the_spacing():
    s = torch.linspace(0, 1, 201, dtype=torch.float64) ** 2 * 3
    w = station_weights(s)
    assert w.sum().item() == pytest.approx(1)
    assert (w * torch.sin(s)).sum().item() == pytest.approx((1 - math.cos(3)) / 3, abs=1e-3)
    even = station_weights(torch.linspace(0, 3, 5, dtype=torch.float64))
    torch.testing.assert_close(even, torch.tensor([0.5, 1, 1, 1, 0.5], dtype=torch.float64) / 4)
