from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from brafit.surface.neighbours import Neighbours, distances_to


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.95])
def test_neighbours_are_those_of_what_is_left(share):
    random = np.random.default_rng(0)
    points = random.standard_normal((1500, 3))
    known, kept = Neighbours.of(points, 12), np.ones(1500, dtype=bool)
    for _ in range(3):  # also of what is left of what was left
        stays = random.uniform(size=len(known.points)) >= share
        rows = zip(known.points, known.near, strict=True)
        before = {tuple(point): tuple(map(tuple, known.points[row[:12]])) for point, row in rows}
        kept[kept] = stays
        known, changed = known.among(stays)
        distances, near = map(np.asarray, KDTree(points[kept]).query(points[kept], k=known.count))
        np.testing.assert_array_equal(known.points, points[kept])
        np.testing.assert_array_equal(known.near[:, : known.count], near.reshape(len(near), -1))
        np.testing.assert_allclose(known.distances[:, : known.count], distances.reshape(len(near), -1))
        for point, row, other in zip(known.points, known.near, changed, strict=True):
            now = tuple(map(tuple, known.points[row[:12]]))
            assert other == (now != before[tuple(point)])
        if len(known.points) < 20:
            break


def test_fewer_points_than_neighbours():
    known = Neighbours.of(np.eye(3), 12)
    assert (known.count, known.near.shape) == (3, (3, 3))


def test_distances_of_places_within_a_reach():
    random = np.random.default_rng(0)
    points, places = random.uniform(-1, 1, (5000, 3)), random.uniform(-2, 2, (50, 3))
    expected = KDTree(points).query(places)[0]
    np.testing.assert_allclose(distances_to(points, places, np.inf), expected)
    near = distances_to(points, places, 0.5)
    np.testing.assert_allclose(near, np.where(expected < 0.5, expected, np.inf))
    assert np.isinf(distances_to(points, places + 10, 0.5)).all()
