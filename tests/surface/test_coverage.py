from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_landmarks, cup_frame_points, rotation

from brafit.geometry.polyline import nearest_on
from brafit.surface.coverage import cell_areas, point_weights

CENTRE = np.array([0.0, RADIUS, 0.0])
AREA = np.pi * RADIUS**2
"""Of the quarter sphere."""


def curve() -> np.ndarray:
    marks = cup_frame_landmarks()
    return np.concatenate([marks["wire"], marks["upper_line"][::-1][1:-1]])


def uneven(seed: int = 0) -> np.ndarray:
    """Points on the quarter sphere, from one side to the other four times as dense."""
    points = cup_frame_points(9000, seed)
    kept = np.random.default_rng(seed).uniform(size=len(points)) < 0.25 - 0.15 * (points[:, 1] - RADIUS) / RADIUS
    return points[kept]


def test_the_cells_of_a_bounded_surface_make_up_its_area():
    points = cup_frame_points(3000)
    assert cell_areas(points, curve()).sum() == pytest.approx(AREA, rel=0.02)


def test_so_they_do_where_a_strip_along_the_curve_has_no_points():
    points = cup_frame_points(3000)
    kept = points[np.minimum(points[:, 0], points[:, 2]) > 2.5]
    assert cell_areas(kept, curve()).sum() == pytest.approx(AREA, rel=0.02)


def test_points_on_the_curve_and_slightly_beyond_it_add_nothing():
    points = cup_frame_points(3000)
    edge = cup_frame_landmarks()["wire"][1:-1]
    beyond = edge - [0.0, 0.0, 0.3]
    assert cell_areas(np.concatenate([points, edge, beyond]), curve()).sum() == pytest.approx(AREA, rel=0.02)


def test_means_over_uneven_points_are_means_over_the_surface():
    points = uneven()
    weights = point_weights(points, curve())
    assert weights.sum() == pytest.approx(1.0)
    mean = weights @ ((points - CENTRE) / RADIUS)
    # Of the directions of the quarter sphere.
    np.testing.assert_allclose(mean, [0.5, 0.0, 0.5], atol=0.02)
    assert abs(((points - CENTRE) / RADIUS).mean(axis=0)[1]) > 0.1


def test_noise_across_the_surface_hardly_changes_the_areas():
    points = cup_frame_points(3000)
    across = (points - CENTRE) / RADIUS * np.random.default_rng(1).normal(0, 0.5, (len(points), 1))
    noisy = cell_areas(points + across, curve())
    assert noisy.sum() == pytest.approx(AREA, rel=0.03)
    assert np.median(np.abs(noisy / cell_areas(points, curve()) - 1)) < 0.1


def test_the_areas_go_with_the_surface_and_do_not_depend_on_the_order():
    points, turn = cup_frame_points(1000), rotation(3)
    area = cell_areas(points, curve())
    moved = cell_areas(points @ turn.T + 50.0, curve() @ turn.T + 50.0)
    np.testing.assert_allclose(moved, area, rtol=1e-6)
    order = np.random.default_rng(0).permutation(len(points))
    np.testing.assert_allclose(cell_areas(points[order], curve()), area[order], rtol=1e-9)


def test_a_stray_point_does_not_rule():
    points = np.concatenate([cup_frame_points(1000), [[200.0, 65.0, 200.0]]])
    weights = point_weights(points, curve())
    assert weights[-1] < 5 * np.median(weights)


def test_few_or_coinciding_points_weigh_alike():
    np.testing.assert_allclose(point_weights(cup_frame_points(5)), 0.2)
    np.testing.assert_allclose(point_weights(np.ones((40, 3))), 1 / 40)


def test_the_nearest_place_on_a_polyline():
    line = np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0]])
    places = nearest_on(np.array([[1.0, 1e-3, 5.0], [5.0, 1.0, 0.0], [-1.0, -1.0, 0.0]]), line)
    np.testing.assert_allclose(places, [[1, 0, 0], [2, 1, 0], [0, 0, 0]])
