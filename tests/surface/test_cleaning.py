from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_points

from brafit.cloud.open3d_runtime import open3d
from brafit.errors import ConfigError
from brafit.surface.cleaning import check_settings, finish, inliers, tidy
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import NEIGHBOURS


def test_the_order_of_the_points_does_not_matter():
    points = cup_frame_points(3000)
    inside = points[:, 0] > 10
    first = finish(tidy(points, inside), count=700)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(points))
        again = finish(tidy(points[order], inside[order]), count=700)
        np.testing.assert_array_equal(again.points, first.points)
        assert again.steps == first.steps


def test_outliers_go_and_are_counted():
    breast = cup_frame_points(3000)
    stray = np.random.default_rng(1).uniform(80, 160, (20, 3))
    cleaned = finish(tidy(np.concatenate([stray, breast])), count=None)
    points, counts = cleaned.points, cleaned.steps
    assert 20 <= counts.outliers < 60
    assert counts.read == 3020
    assert counts.used == len(points) == 3020 - counts.outliers
    assert np.linalg.norm(points - [0, RADIUS, 0], axis=1).max() < RADIUS + 1e-4
    everything = finish(tidy(np.concatenate([stray, breast]), outliers=None), count=None)
    assert len(everything.points) == 3020
    assert everything.steps.outliers == 0


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
    cleaned = finish(tidy(points, inside), count=None)
    assert cleaned.points[:, 2].min() > 20
    counts = cleaned.steps
    assert counts.outliers + counts.outside + counts.used == counts.read == 3000


@pytest.mark.parametrize("setting", [(9, 3.0, 16), (2000, 0.0, 16), (2000, 3.0, 1)])
def test_settings_out_of_range(setting):
    with pytest.raises(ConfigError, match=r"^scan\.(points|outliers|neighbours): "):
        check_settings(*setting)


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
def test_the_noise_that_is_left_is_measured(noise):
    generator = np.random.default_rng(0)
    exact = cup_frame_points(6000)
    normal = (exact - [0, RADIUS, 0]) / RADIUS
    steps = finish(tidy(exact + noise * generator.standard_normal((6000, 1)) * normal)).steps
    assert steps.scatter_mm is not None
    # The plane through a curved patch of 6 mm radius is off by about a tenth of a millimetre.
    assert abs(steps.scatter_mm - noise) < 0.15 + 0.1 * noise
