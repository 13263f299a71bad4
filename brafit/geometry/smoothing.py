"""Smooth curves near polylines (NumPy), (70) and (71) of docs/formulation.md."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy.polynomial import chebyshev

from brafit.geometry.grid import chebyshev_synthesis

TERMS = 28
"""Chebyshev terms of a smooth curve at most."""


def chord_parameter(points: Float[np.ndarray, "k 3"]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k-1"]]:
    """The share of a polyline's length at each of its points, scaled to [-1, 1], and the lengths of its segments."""
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    length = np.append(0.0, np.cumsum(chords))
    return 2 * length / length[-1] - 1, chords


def smooth_series(
    x: Float[np.ndarray, " k"], points: Float[np.ndarray, "k 3"], chords: Float[np.ndarray, " k-1"], smoothing: float
) -> Float[np.ndarray, "terms 3"]:
    """Chebyshev coefficients of a smooth curve near points at x in [-1, 1], through the first and the last of them.

    Least squares plus `smoothing` times the mean squared third derivative by (x + 1) pi / 2, the points' unit being
    length / pi: a wave of n half-periods along the curve keeps 1 / (1 + smoothing n^6) of its amplitude.

    Args:
        x: increasing, from -1 to 1, see `chord_parameter`.
        points: there, in units of length / pi.
        chords: lengths of the segments between the points, in any unit: shares of them are weights.
        smoothing: weight of the third derivative; less than 1e-12 counts as that.
    """
    terms = min(TERMS, len(points))
    values = chebyshev.chebvander(x, terms - 1)
    weights = np.convolve(chords, (0.5, 0.5)) / chords.sum()  # trapezoidal: uneven sampling does not matter
    normal = values.T @ (weights[:, None] * values) + max(smoothing, 1e-12) * roughness(terms)
    ends = values[[0, -1]]
    system = np.block([[normal, ends.T], [ends, np.zeros((2, 2))]])
    right = np.concatenate((values.T @ (weights[:, None] * points), points[[0, -1]]))
    return np.linalg.solve(system, right)[:terms]


@lru_cache
def roughness(terms: int) -> Float[np.ndarray, "terms terms"]:
    """The mean squared third derivative by (x + 1) pi / 2, as a matrix between Chebyshev coefficients."""
    nodes, quadrature = np.polynomial.legendre.leggauss(2 * terms)
    third = chebyshev_synthesis(terms, nodes, 3) * (2 / np.pi) ** 3
    return third.T @ (quadrature[:, None] / 2 * third)
