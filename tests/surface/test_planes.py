from __future__ import annotations

import numpy as np
import pytest

from brafit.surface.planes import distances_off, least_axes, normals_at

LEVELS = {
    "all different": (3.0, 1.0, 0.2),
    "a plane": (3.0, 2.0, 0.0),
    "nearly a plane": (1.0, 1.0, 1e-12),
    "two least alike": (3.0, 1.0, 1.0),
    "two least nearly alike": (3.0, 1.0, 1.0 - 1e-6),
    "a line": (1.0, 0.0, 0.0),
    "all alike": (2.0, 2.0, 2.0),
    "nothing": (0.0, 0.0, 0.0),
    "huge": (3e200, 2e200, 1e199),
    "tiny": (3e-200, 2e-200, 1e-201),
}


def matrices(levels: tuple[float, ...], count: int = 200) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((count, 3, 3)))[0]
    return (turn * np.array(levels)) @ turn.transpose(0, 2, 1)


def rows(full: np.ndarray) -> np.ndarray:
    return full.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].T


@pytest.mark.parametrize("levels", LEVELS.values(), ids=LEVELS)
def test_least_axes_are_as_good_as_those_of_lapack(levels):
    full = matrices(levels)
    axes = least_axes(rows(full)).T
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1, atol=1e-14)
    size = max(levels) or 1.0
    values, vectors = np.linalg.eigh(full / size)
    stretched = np.einsum("nij,nj->ni", full / size, axes)
    np.testing.assert_allclose(stretched, values[:, :1] * axes, atol=1e-11)
    gap = values[:, 1] - values[:, 0]
    if gap.min() > 1e-3:  # else the vector itself is in doubt
        np.testing.assert_allclose(np.abs((axes * vectors[:, :, 0]).sum(axis=1)), 1, atol=1e-13)


def test_normals_of_planes_with_noise():
    random = np.random.default_rng(1)
    points = random.uniform(-1, 1, (4000, 3)) * [1, 1, 0]
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    near = random.integers(0, 4000, (1500, 20))
    normals = normals_at(points @ turn + [5, 500, -70], near)
    np.testing.assert_allclose(np.abs(normals @ turn[2]), 1, atol=1e-9)


def test_distances_from_a_plane_in_spite_of_strays():
    random = np.random.default_rng(2)
    points = random.uniform(-5, 5, (2500, 3)) * [1, 1, 0] + [1000.0, -300, 40]
    points[:200, 2] += 3.0
    points[200:500, 2] += random.choice([-4.0, 4.0], 300)
    chosen = np.arange(400)
    # Of 24 neighbours three are strays.
    others = np.concatenate([random.integers(500, 2500, (400, 21)), random.integers(200, 500, (400, 3))], axis=1)
    distances = distances_off(points, chosen, others)
    np.testing.assert_allclose(distances[:200], 3.0, atol=0.15)
    np.testing.assert_allclose(distances[200:], 4.0, atol=0.2)
