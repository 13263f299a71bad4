from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_points
from scipy.spatial import KDTree

from brafit.surface.thinning import thin, uncrowd


@pytest.mark.parametrize("count", [50, 400, 1000, 1400, 1499, 1500, 3000, None])
def test_exactly_as_many_points_as_wanted(count):
    points, _ = thin(cup_frame_points(1500), count)
    assert len(points) == min(count or 1500, 1500)


@pytest.mark.parametrize("count", [1, 20, 700, 999])
def test_points_are_taken_out_down_to_any_number(count):
    assert uncrowd(np.random.default_rng(0).standard_normal((1000, 3)), count).sum() == count


def test_of_the_closest_pair_the_one_with_the_nearer_third_goes():
    line = np.array([[0.0, 0, 0], [3, 0, 0], [4, 0, 0], [9, 0, 0], [12, 0, 0]])
    np.testing.assert_array_equal(uncrowd(line, 4), [True, False, True, True, True])
    np.testing.assert_array_equal(uncrowd(line, 3), [True, False, True, False, True])


def test_what_is_left_is_even_and_covers_the_whole():
    dense = cup_frame_points(20000)
    points, voxel = thin(dense, 500)
    spacing = KDTree(points).query(points, k=2)[0][:, 1]
    area = np.pi * RADIUS**2
    # A hexagonal packing of 500 points would have 1.07 times this spacing, random points 0.5 times it on average.
    ideal = (area / 500) ** 0.5
    assert spacing.min() > 0.6 * ideal
    assert spacing.max() < 1.4 * ideal
    assert KDTree(points).query(dense)[0].max() < 1.5 * ideal
    assert 0.5 * ideal < voxel < 1.2 * ideal
    # Means of the points in a voxel sink below the sphere by the arc's height at most.
    radii = np.linalg.norm(points - [0, RADIUS, 0], axis=1)
    assert RADIUS - 2 * voxel**2 / (8 * RADIUS) < radii.min() < radii.max() < RADIUS + 1e-4


def test_repeated_points_count_once():
    points = np.repeat(cup_frame_points(300), 4, axis=0)
    assert len(thin(points, 1000)[0]) == 300


def test_the_crowded_go_first():
    grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3)
    crowd = grid[::7] + 0.05
    kept = uncrowd(np.concatenate([crowd, grid]), 100)
    assert KDTree(np.concatenate([crowd, grid])[kept]).query(grid)[0].max() < 0.1
