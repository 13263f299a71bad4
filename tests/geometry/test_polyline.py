from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from brafit.geometry.polyline import distances, distinct, evenly_spaced, running_length
from brafit.geometry.smoothing import chord_parameter, smooth_series


def test_distinct_drops_repeated_points_only():
    line = np.array([[0.0, 0], [0, 0], [1, 0], [0, 0], [0, 0], [0, 0], [2, 1]])
    np.testing.assert_array_equal(distinct(line), [[0, 0], [1, 0], [0, 0], [2, 1]])


def test_even_spacing_goes_round_corners():
    hook = np.array([[0.0, 0, 0], [0.5, 0, 0], [3, 0, 0], [3, 3, 0]])
    expected = [[0, 0, 0], [1.5, 0, 0], [3, 0, 0], [3, 1.5, 0], [3, 3, 0]]
    np.testing.assert_allclose(evenly_spaced(hook, 5), expected, atol=1e-12)


def test_distances_from_a_circle_of_many_chords_are_those_from_the_circle():
    angle = np.linspace(0, 2 * np.pi, 2001)
    circle = np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    points = np.random.default_rng(0).normal(size=(100, 3))
    expected = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 1, points[:, 2])
    np.testing.assert_allclose(distances(points, circle), expected, atol=2e-6)


def test_beyond_its_ends_a_polyline_is_as_far_as_the_end():
    line = np.array([[0.0, 0], [1, 0], [1, 0], [2, 0]])
    np.testing.assert_allclose(distances(np.array([[5.0, 4], [-3, 4], [1.2, 0.7]]), line), [5, 5, 0.7])


@pytest.mark.parametrize("kept", [0.9, 0.5, 0.1])
@pytest.mark.parametrize("n", [8, 12])
def test_smoothing_shrinks_a_wave_by_its_half_periods(n, kept):
    """In the middle of a line of length pi, where its ends, which are kept, do not matter."""
    t = np.linspace(0, np.pi, 401)
    height = 1e-3
    points = np.stack((t, height * np.sin(n * t), 0.2 + 0 * t), axis=1)
    smoothing = (1 / kept - 1) / n**6
    x, chords = chord_parameter(points)
    curve = chebyshev.chebval(x, smooth_series(x, points, chords, smoothing)).T
    inner = (t > np.pi / 4) & (t < 3 * np.pi / 4)  # whole periods
    found = np.dot(curve[inner, 1], np.sin(n * t[inner])) / np.dot(np.sin(n * t[inner]), np.sin(n * t[inner]))
    assert found / height == pytest.approx(kept, abs=0.05)


@pytest.mark.parametrize("smoothing", [0.0, 1e-6, 1.0])
def test_smoothing_keeps_ends_and_gentle_arcs(smoothing):
    t = np.linspace(0, np.pi, 101) ** 1.2 / np.pi**0.2
    line = np.stack((t, 0.1 * t**2, 0.3 * t), axis=1)
    noise = 0.05 * np.random.default_rng(0).normal(size=line.shape)
    for points in (line, line + noise):
        x, chords = chord_parameter(points)
        curve = chebyshev.chebval(x, smooth_series(x, points, chords, smoothing)).T
        np.testing.assert_allclose(curve[[0, -1]], points[[0, -1]], atol=1e-9)
        if points is line:
            np.testing.assert_allclose(distances(curve, line), 0, atol=0.01)


def test_running_length_of_a_circle_is_its_chords():
    angle = np.linspace(0, np.pi, 31)
    circle = 2 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    np.testing.assert_allclose(running_length(circle), np.arange(31) * 4 * np.sin(np.pi / 60), rtol=1e-12)
