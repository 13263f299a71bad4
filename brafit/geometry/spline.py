"""Cubic splines through samples at 0, 1, 2 and so on, of many curves at once.

Their slopes at the samples are a fixed matrix times the samples: one product for all curves, where each spline would be
a system of equations of its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


@lru_cache(maxsize=16)
def _slopes_of_samples(count: int) -> Float[ndarray, "count count"]:
    places = np.arange(count)
    return CubicSpline(places, np.eye(count)).derivative()(places)


def slopes(values: Float[ndarray, "*curves n k"]) -> Float[ndarray, "*curves n k"]:
    """Derivatives at the samples of the splines through them (third derivatives go on past the second and the last but
    one sample)."""
    return _slopes_of_samples(values.shape[-2]) @ values


def between(
    values: Float[ndarray, "curves n k"], slope: Float[ndarray, "curves n k"], places: Float[ndarray, " curves"]
) -> Float[ndarray, "curves k"]:
    """Places on curves, each at its own real-valued index.

    Args:
        values: samples of the curves.
        slope: derivatives there, see `slopes`.
        places: from 0 to n - 1.
    """
    first = np.clip(np.floor(places).astype(int), 0, values.shape[1] - 2)
    t, rows = (places - first)[:, None], np.arange(len(values))
    a, b, u, v = (values[rows, first], values[rows, first + 1], slope[rows, first], slope[rows, first + 1])
    step = b - a
    return a + t * (u + t * (3 * step - 2 * u - v + t * (u + v - 2 * step)))


def running_lengths(values: Float[ndarray, "curves n k"]) -> Float[ndarray, "curves n"]:
    """Lengths of the splines from the first sample to each."""
    slope, step = slopes(values), np.diff(values, axis=1)
    total = np.zeros(values.shape[:2])
    for node, weight in zip((_NODES + 1) / 2, _WEIGHTS / 2, strict=True):
        go = 6 * node * (1 - node) * step
        go += (1 - node) * (1 - 3 * node) * slope[:, :-1]
        go += node * (3 * node - 2) * slope[:, 1:]
        total[:, 1:] += weight * np.sqrt(np.einsum("cnk,cnk->cn", go, go))
    return np.cumsum(total, axis=1)
