from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from brafit.fitting.neckline import STRAP_REACH, smooth_neckline
from brafit.geometry.polyline import distances, evenly_spaced

JITTER = 0.4
CORNER = np.array([100.0, 0, 0])


def arcs(count: int) -> np.ndarray:
    """Two arcs, 110 and 75 mm long, not in one plane, that meet at right angles in the corner (100, 0, 0)."""
    a, b = np.linspace(-0.9, 0, count), np.linspace(0, 1.0, count)
    first = np.stack((122 * np.sin(a), 122 * (1 - np.cos(a)), 8 * a**2), axis=1)
    second = np.stack((10 * b**2, 75 * np.sin(b), 75 * (1 - np.cos(b))), axis=1)
    return np.concatenate([first, second[1:]]) + CORNER


SMOOTH = arcs(4001)


def jittered(amplitude: float = JITTER) -> np.ndarray:
    """Points about 2 mm apart, every other one up, the ends and the corner in place."""
    line = arcs(48)
    sign = (-1.0) ** np.arange(len(line))
    sign[[0, 47, -1]] = 0
    return line + amplitude * sign[:, None] * np.array([0.3, -0.4, np.sqrt(0.75)])


def test_jitter_vanishes_and_the_corner_stays():
    given = jittered()
    line = smooth_neckline(given, CORNER, wave=45.0)
    first, second = line.sides
    np.testing.assert_array_less(np.abs(first[-1] - CORNER), 1e-9)
    np.testing.assert_array_less(np.abs(second[0] - CORNER), 1e-9)
    np.testing.assert_allclose(first[0], given[0], atol=1e-9)
    np.testing.assert_allclose(second[-1], given[-1], atol=1e-9)
    left, before = (distances(points, SMOOTH[::8]) for points in (np.concatenate(line.sides), given))
    assert np.sqrt((left**2).mean()) < np.sqrt((before**2).mean()) / 5
    assert left.max() < 0.1
    tangents = [side[[-1, 0]] - side[[-6, 5]] for side in line.sides]
    into, out = tangents[0][0], -tangents[1][1]
    assert abs(np.dot(into, out)) < 0.15 * np.linalg.norm(into) * np.linalg.norm(out)


@pytest.mark.parametrize("amplitude", [0.2, 0.6])
def test_the_reported_smoothing_is_how_far_the_given_points_are(amplitude):
    across = distances(jittered(amplitude), SMOOTH[::8]).max()
    assert smooth_neckline(jittered(amplitude), CORNER, wave=45.0).smoothing == pytest.approx(across, abs=0.1)
    assert smooth_neckline(jittered(amplitude), CORNER, wave=0.0).smoothing < 1e-9


def test_clean_arcs_stay():
    line = smooth_neckline(arcs(48), CORNER, wave=45.0)
    assert distances(SMOOTH[::20], np.concatenate(line.sides)).max() < 0.1


def test_without_smoothing_the_points_stay_and_a_corner_that_was_cut_off_comes_back():
    even = evenly_spaced(SMOOTH, 76)
    assert distances(CORNER[None], even)[0] > 0.1
    line = smooth_neckline(even, CORNER, wave=0.0)
    assert len(line.sides) == 2
    np.testing.assert_array_equal(line.sides[0][-1], CORNER)
    np.testing.assert_array_equal(line.sides[1][0], CORNER)
    far = even[np.linalg.norm(even - CORNER, axis=1) > 2.7]
    assert len(far) >= len(even) - 2
    assert KDTree(np.concatenate(line.sides)).query(far)[0].max() == 0
    assert distances(np.concatenate(line.sides), SMOOTH[::8]).max() < 0.01


@pytest.mark.parametrize("wave", [0.0, 45.0])
def test_the_corner_goes_to_a_strap_point_beside_the_line(wave):
    strap = CORNER + np.array([2.0, -3.0, 1.0])
    line = smooth_neckline(jittered(), strap, wave)
    np.testing.assert_allclose([line.sides[0][-1], line.sides[1][0]], [strap, strap], atol=1e-9)


@pytest.mark.parametrize("strap", [None, CORNER + np.array([0.0, 0.0, 1.2 * STRAP_REACH]), SMOOTH[0], SMOOTH[-1]])
def test_without_a_strap_point_on_the_line_there_is_one_side(strap):
    for wave in (0.0, 45.0):
        given = jittered()
        line = smooth_neckline(given, strap, wave)
        assert len(line.sides) == 1
        np.testing.assert_allclose(line.sides[0][[0, -1]], given[[0, -1]], atol=1e-9)
        assert line.sampled(81).shape == (81, 3)


def test_short_lines_and_repeated_points_do_no_harm():
    for count in (2, 3):
        line = smooth_neckline(SMOOTH[:: (len(SMOOTH) - 1) // (count - 1)], None, wave=45.0)
        assert len(line.sides[0]) == count
    repeated = np.repeat(jittered(), 2, axis=0)
    once, twice = (smooth_neckline(given, CORNER, 45.0).sampled(81) for given in (jittered(), repeated))
    np.testing.assert_array_equal(once, twice)


@pytest.mark.parametrize("count", [3, 4, 50, 81, 200])
def test_samples_are_as_many_as_asked_for_and_include_the_corner(count):
    line = smooth_neckline(jittered(), CORNER, wave=45.0)
    points = line.sampled(count)
    assert points.shape == (count, 3)
    away = np.linalg.norm(points - CORNER, axis=1)
    assert away.min() < 1e-9
    np.testing.assert_allclose(points[[0, -1]], jittered()[[0, -1]], atol=1e-9)
    if count >= 50:
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        assert steps.max() < 1.1 * steps.min()
