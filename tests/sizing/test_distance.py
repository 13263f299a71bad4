"""Distances of cups after a rigid motion, against singular value decompositions one by one."""

from __future__ import annotations

import numpy as np
import pytest
from lunes import lune_cup
from scipy.spatial.transform import Rotation

from brafit.geometry.rigid import motion_onto
from brafit.sizing.distance import distance_matrix, distances_between, population
from brafit.sizing.surface import corresponding, point_areas

EVEN = np.full(50, 1 / 50)


def clouds(count: int = 20) -> np.ndarray:
    random = np.random.default_rng(3)
    return random.normal(size=(count, 50, 3)) * (60, 50, 20)


def direct(one: np.ndarray, other: np.ndarray, weights: np.ndarray) -> float:
    turn, shift = motion_onto(one, other, weights)
    return float(np.sqrt(weights @ np.square(one @ turn + shift - other).sum(1)))


def test_every_pair_is_as_far_apart_as_kabsch_says():
    points = clouds()
    weights = np.random.default_rng(4).uniform(0.2, 1, 50)
    weights /= weights.sum()
    cups = population(points, weights)
    expected = [[direct(a, b, weights) for b in points] for a in points]
    np.testing.assert_allclose(distances_between(cups, cups), expected, atol=1e-5)


def test_a_moved_copy_is_at_no_distance_and_a_mirror_image_is():
    points = clouds(1)[0]
    turn = Rotation.from_rotvec([0.4, -1.1, 0.8]).as_matrix()
    cups = population(np.stack((points, points @ turn + (100, -20, 5), points * (1, 1, -1))), EVEN)
    found = distances_between(cups, cups)
    assert found[0, 1] < 1e-4
    assert found[0, 2] > 5
    assert found[0, 2] == pytest.approx(direct(points, points * (1, 1, -1), EVEN))


def test_small_differences_are_measured():
    points = clouds(1)[0]
    small = 0.01 * np.random.default_rng(6).normal(size=points.shape)
    cups = population(np.stack((points, points + small)), EVEN)
    assert distances_between(cups, cups)[0, 1] == pytest.approx(direct(points, points + small, EVEN), rel=1e-3)


def test_flat_points_are_compared_too():
    points = clouds(2) * (1, 1, 0)
    cups = population(points, EVEN)
    assert distances_between(cups, cups)[0, 1] == pytest.approx(direct(points[0], points[1], EVEN), abs=1e-5)


def test_blocks_make_no_difference():
    cups = population(clouds(23), EVEN)
    whole, pairs = distance_matrix(cups), []
    np.testing.assert_allclose(distance_matrix(cups, pairs.append, block=7), whole, atol=1e-4)
    assert sum(pairs) == 23 * 23
    assert (whole == whole.T).all()
    assert (np.diag(whole) == 0).all()


def test_it_is_a_distance():
    found = distances_between(population(clouds(), EVEN), population(clouds(), EVEN))
    around = found[:, :, None] + found[None]  # [a, b, c]: a to b and b to c
    assert (found[:, None] <= around + 1e-6).all()


def test_points_correspond_whatever_the_panels_and_stations():
    """All lune cups of so many panels are on one another along the wire, and close to the sphere across."""
    fine = corresponding(lune_cup(8, 401).edges.numpy()[None])
    other = corresponding(lune_cup(7, 161).edges.numpy()[None])
    assert np.abs(fine - other).max() < 1.0
    assert np.linalg.norm(fine[0] - (0, 80, 0), axis=-1) == pytest.approx(80, abs=0.6)
    theta = np.pi * (np.arange(24) + 0.5) / 24
    np.testing.assert_allclose(fine[0, :, 0, 1], 80 * (1 - np.cos(theta)), atol=0.01)
    np.testing.assert_allclose(fine[0, :, -1, 0], 0, atol=1e-6)  # the upper edge, in the plane x = 0


def test_areas_of_places_are_those_of_the_sphere():
    """On a quarter sphere the area goes with the sine of the angle along the wire; the outer rows have half of it."""
    areas = point_areas(corresponding(lune_cup(8, 401).edges.numpy()[None])).reshape(24, 9)
    assert areas.sum() == pytest.approx(1)
    theta = np.pi * (np.arange(24) + 0.5) / 24
    np.testing.assert_allclose(areas.sum(1)[3:-3], (np.sin(theta) / np.sin(theta).sum())[3:-3], rtol=0.03)
    np.testing.assert_allclose(areas[:, 0], areas[:, 4] / 2, rtol=0.03)
