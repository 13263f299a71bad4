"""Splines of many curves against SciPy's, one at a time."""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from brafit.geometry.spline import between, running_lengths, slopes


def curves() -> np.ndarray:
    turn = np.linspace(0, 2, 21)[:, None] * np.array([1.0, 1.3, 0.7])
    return np.stack([np.cumsum(np.sin(turn + k), axis=0) for k in range(4)])


def test_slopes_and_places_between_samples():
    values, places = curves(), np.array([0.0, 3.7, 20.0, 19.2])
    slope = slopes(values)
    for k, own in enumerate(values):
        spline = CubicSpline(np.arange(21), own)
        np.testing.assert_allclose(slope[k], spline.derivative()(np.arange(21)), atol=1e-12)
        np.testing.assert_allclose(between(values, slope, places)[k], spline(places[k]), atol=1e-12)


def test_lengths_are_integrals_of_the_speed():
    values = curves()[:2]
    for own, length in zip(values, running_lengths(values), strict=True):
        along = CubicSpline(np.arange(21), own).derivative()
        steps = [quad(lambda s, along=along: float(np.linalg.norm(along(s))), k, k + 1)[0] for k in range(20)]
        np.testing.assert_allclose(length, np.append(0.0, np.cumsum(steps)), atol=1e-6)
