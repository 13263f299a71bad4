from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_points
from scipy.spatial import KDTree

from brafit.cloud.open3d_runtime import open3d
from brafit.errors import ConfigError
from brafit.surface import clean
from brafit.surface.cleaning import inliers, thin, uncrowd
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import NEIGHBOURS


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


def test_the_order_of_the_points_does_not_matter():
    points = cup_frame_points(3000)
    inside = points[:, 0] > 10
    first, counts = clean(points, inside, count=700)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(points))
        again, counts_again = clean(points[order], inside[order], count=700)
        np.testing.assert_array_equal(again, first)
        assert counts_again == counts


def test_outliers_go_and_are_counted():
    breast = cup_frame_points(3000)
    stray = np.random.default_rng(1).uniform(80, 160, (20, 3))
    points, counts = clean(np.concatenate([stray, breast]), count=None)
    assert 20 <= counts.outliers < 60
    assert counts.read == 3020
    assert counts.used == len(points) == 3020 - counts.outliers
    assert np.linalg.norm(points - [0, RADIUS, 0], axis=1).max() < RADIUS + 1e-4
    everything, counts = clean(np.concatenate([stray, breast]), count=None, outliers=None)
    assert len(everything) == 3020
    assert counts.outliers == 0


@pytest.mark.parametrize(("neighbours", "deviations"), [(16, 3.0), (16, 1.0), (5, 2.0), (40, 2.0)])
def test_outliers_are_those_of_open3d(neighbours, deviations):
    rng = np.random.default_rng(2)
    breast = cup_frame_points(2000)
    points = np.concatenate([breast + 0.5 * rng.standard_normal(breast.shape), rng.uniform(-90, 160, (60, 3))])
    cloud = open3d().t.geometry.PointCloud(points)
    _, kept = cloud.remove_statistical_outliers(neighbours, deviations)
    known = Neighbours.of(points, max(NEIGHBOURS, neighbours + 1))
    np.testing.assert_array_equal(inliers(known, neighbours, deviations), kept.numpy())


def test_only_flagged_points_are_used_and_the_counts_add_up():
    points = cup_frame_points(3000)
    inside = points[:, 2] > 20
    kept, counts = clean(points, inside, count=None)
    assert kept[:, 2].min() > 20
    assert counts.outliers + counts.outside + counts.used == counts.read == 3000


def test_repeated_points_count_once():
    points = np.repeat(cup_frame_points(300), 4, axis=0)
    assert len(thin(points, 1000)[0]) == 300


def test_the_crowded_go_first():
    grid = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0), [0.0]), axis=-1).reshape(-1, 3)
    crowd = grid[::7] + 0.05
    kept = uncrowd(np.concatenate([crowd, grid]), 100)
    assert KDTree(np.concatenate([crowd, grid])[kept]).query(grid)[0].max() < 0.1


@pytest.mark.parametrize("setting", [{"count": 9}, {"outliers": 0.0}, {"neighbours": 1}])
def test_settings_out_of_range(setting):
    with pytest.raises(ConfigError, match=r"^scan\.(points|outliers|neighbours): "):
        clean(cup_frame_points(200), **setting)


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
def test_the_noise_that_is_left_is_measured(noise):
    generator = np.random.default_rng(0)
    exact = cup_frame_points(6000)
    normal = (exact - [0, RADIUS, 0]) / RADIUS
    _, steps = clean(exact + noise * generator.standard_normal((6000, 1)) * normal)
    assert steps.scatter_mm is not None
    # The plane through a curved patch of 6 mm radius is off by about a tenth of a millimetre.
    assert abs(steps.scatter_mm - noise) < 0.15 + 0.1 * noise
