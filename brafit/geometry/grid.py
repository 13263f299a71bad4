"""Linear operators on functions sampled at given points: derivative, integral, interpolation.

The operators are small dense matrices, made once in float64 with NumPy and cast to what the caller works in.
Chebyshev points give spectral accuracy; for arbitrary points, sliding polynomials of a fixed degree.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import chebyshev
from torch import Tensor


def like(matrix: np.ndarray, other: Tensor) -> Tensor:
    """A NumPy array as a tensor of the dtype and device of `other`."""
    return torch.as_tensor(matrix, dtype=other.dtype, device=other.device)


@lru_cache
def chebyshev_points(n: int) -> np.ndarray:
    """The n Chebyshev-Lobatto points of [-1, 1], increasing."""
    return -np.cos(np.pi * np.arange(n) / (n - 1))


@lru_cache
def chebyshev_analysis(n: int) -> np.ndarray:
    """(n, n): values at the Chebyshev points -> Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(chebyshev_points(n), n - 1))


def chebyshev_polynomials(terms: int, x: np.ndarray) -> np.ndarray:
    """(len(x), terms): the Chebyshev polynomials at x in [-1, 1]."""
    return np.cos(np.arccos(x)[:, None] * np.arange(terms))


def chebyshev_synthesis(terms: int, x: np.ndarray, derivative: int = 0) -> np.ndarray:
    """(len(x), terms): Chebyshev coefficients -> values (or derivatives by x) at x in [-1, 1].

    Args:
        terms: coefficients of a series.
        x: places in [-1, 1].
        derivative: order of the derivative by x; 0: values.
    """
    return _synthesis(terms, np.ascontiguousarray(x, dtype=np.float64).tobytes(), derivative)


@lru_cache(maxsize=64)
def _synthesis(terms: int, x: bytes, derivative: int) -> np.ndarray:
    """Every cup asks for the same few."""
    basis = np.eye(terms)
    if derivative:
        basis = chebyshev.chebder(basis, derivative, axis=0)
    return chebyshev.chebvander(np.frombuffer(x), len(basis) - 1) @ basis


@lru_cache
def chebyshev_derivative(n: int) -> np.ndarray:
    """(n, n): values at the Chebyshev points -> derivatives there. Rows sum to zero, so constants vanish exactly."""
    d = chebyshev_synthesis(n, chebyshev_points(n), 1) @ chebyshev_analysis(n)
    return d - np.diag(d.sum(1))


@lru_cache
def chebyshev_integral(n: int) -> np.ndarray:
    """(n, n): values at the Chebyshev points -> integral from -1 to each point."""
    coefficients = chebyshev.chebint(np.eye(n), lbnd=-1, axis=0)
    return chebyshev.chebvander(chebyshev_points(n), n) @ coefficients @ chebyshev_analysis(n)


_WIDTH = 8
"""Samples that a sliding polynomial goes through."""


def _sliding(x: Float[Tensor, " n"]) -> tuple[np.ndarray, np.ndarray, float]:
    """Derivative and integral of samples at (x - x[0]) / (x[-1] - x[0]), and the length x[-1] - x[0].

    Evenly spaced points share their operators, whatever their scale.
    """
    points = x.detach().cpu().double().numpy()
    length = float(points[-1] - points[0])
    unit = ((points - points[0]) / length).round(14)
    return *_sliding_operators(tuple(unit.tolist()), _WIDTH), length


@lru_cache
def _sliding_operators(points: tuple[float, ...], width: int) -> tuple[np.ndarray, np.ndarray]:
    x = np.asarray(points)
    n = len(x)
    width = min(width, n)
    derivative, integral = np.zeros((n, n)), np.zeros((n, n))
    for k in range(n):
        first = min(max(k - width // 2, 0), n - width)
        window = slice(first, first + width)
        centre, scale = x[k], np.ptp(x[window])
        powers = np.vander((x[window] - centre) / scale, width, increasing=True)
        derivative[k, window] = np.linalg.inv(powers)[1] / scale
    for k in range(n - 1):
        first = min(max(k + 1 - width // 2, 0), n - width)
        window = slice(first, first + width)
        centre, scale = x[k], np.ptp(x[window])
        powers = np.vander((x[window] - centre) / scale, width, increasing=True)
        end = (x[k + 1] - centre) / scale
        moments = end ** np.arange(1, width + 1) / np.arange(1, width + 1) * scale
        integral[k + 1 :, window] += moments @ np.linalg.inv(powers)
    return derivative, integral


def sliding_derivative(values: Float[Tensor, "*batch n k"], x: Float[Tensor, " n"]) -> Float[Tensor, "*batch n k"]:
    """d values / dx at the samples, by sliding polynomials through eight of them: local error of order h^7.

    Args:
        values: functions sampled at x; the last dimension runs over functions.
        x: increasing, need not be evenly spaced.
    """
    derivative, _, length = _sliding(x)
    return torch.einsum("ij,...jk->...ik", like(derivative / length, values), values)


def sliding_integral(values: Float[Tensor, "*batch n k"], x: Float[Tensor, " n"]) -> Float[Tensor, "*batch n k"]:
    """Integral of the samples from x[0] to each x, by sliding polynomials through eight of them: order h^8.

    Args:
        values: functions sampled at x; the last dimension runs over functions.
        x: increasing, need not be evenly spaced.
    """
    _, integral, length = _sliding(x)
    return torch.einsum("ij,...jk->...ik", like(integral * length, values), values)


def station_weights(stations: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Weights that sum to 1 and make a sum over stations a mean over the wire, whatever their spacing (trapezoidal
    rule).
    """
    half = stations.diff() / (2 * (stations[-1] - stations[0]))
    return torch.nn.functional.pad(half, (0, 1)) + torch.nn.functional.pad(half, (1, 0))
