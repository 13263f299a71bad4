from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from brafit.geometry.rigid import laid_on

RANDOM = np.random.default_rng(3)
POINTS = RANDOM.normal(size=(40, 3))
TURN = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
SHIFT = np.array([3.0, -2.0, 7.0])


@pytest.mark.parametrize("flat", [False, True])
def test_a_motion_is_found_again(flat):
    points = POINTS * (1, 1, 0 if flat else 1)
    np.testing.assert_allclose(laid_on(points, points @ TURN.T + SHIFT), points @ TURN.T + SHIFT, atol=1e-12)


def test_points_that_are_not_used_move_along_and_decide_nothing():
    aims = POINTS @ TURN.T + SHIFT
    used = np.arange(len(POINTS)) < 30
    wrong = np.where(used[:, None], aims, 100.0)
    np.testing.assert_allclose(laid_on(POINTS, wrong, used), aims, atol=1e-12)


def test_mirror_images_are_not_reached_and_scipy_agrees():
    aims = POINTS * (-1, 1, 1)
    found = laid_on(POINTS, aims)
    distances = np.linalg.norm(found[1:] - found[:-1], axis=1)
    np.testing.assert_allclose(distances, np.linalg.norm(np.diff(POINTS, axis=0), axis=1))
    middle, aim = POINTS.mean(axis=0), aims.mean(axis=0)
    turn = Rotation.align_vectors(aims - aim, POINTS - middle)[0]
    np.testing.assert_allclose(found, turn.apply(POINTS - middle) + aim, atol=1e-9)
