"""The skin that a page holds is the scan's, to a hundredth of a millimetre, and small."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_torso import front, torso_points
from scipy.spatial import KDTree

from brafit.marking.skin import Skin, octahedral, skin_of


def unfolded(folded: np.ndarray) -> np.ndarray:
    """Unit vectors of places on the octahedron, by solving for them: |x| + |y| + |z| = 1."""
    u, v = (folded / 127.0).T
    z = 1 - np.abs(u) - np.abs(v)
    outside = np.clip(-z, 0, None)
    x, y = u - np.sign(u) * outside, v - np.sign(v) * outside
    vectors = np.stack([x, y, z], axis=1)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def read(records: bytes, count: int, skin: Skin) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals as a reader of the bytes finds them."""
    shorts = np.frombuffer(records[: 8 * count], dtype="<u2").reshape(count, 4)
    signed = np.frombuffer(records[: 8 * count], dtype="i1").reshape(count, 8)
    return skin.origin + skin.step * shorts[:, :3], unfolded(signed[:, 6:])


def test_records_hold_the_points_and_their_normals():
    points = torso_points(20_000) + np.array([5000.0, -3000.0, 1e4])
    skin = skin_of(points)
    found, normals = read(skin.records(), len(skin.places), skin)
    assert len(skin.records()) == 9 * len(skin.places)
    assert len(found) > 0.99 * len(points)
    assert KDTree(points).query(found)[0].max() < 0.05
    x, y = (found - [5000.0, -3000.0, 1e4]).T[:2]
    ahead = (found[:, 2] > 1e4 + 60) & (np.abs(x) < 120) & (np.abs(y) < 150)
    slope = [(front(x + dx, y + dy) - front(x - dx, y - dy)) / 0.02 for dx, dy in ((0.01, 0), (0, 0.01))]
    true = np.stack([-slope[0], -slope[1], np.ones_like(x)], axis=1)[ahead]
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    cosine = np.abs((true * normals[ahead]).sum(axis=1))
    assert np.degrees(np.arccos(np.quantile(cosine, 0.02).clip(-1, 1))) < 6


def test_directions_survive_eight_bits():
    directions = np.random.default_rng(0).standard_normal((5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = (unfolded(octahedral(directions).astype(float)) * directions).sum(axis=1)
    assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 1


def test_strays_do_not_make_the_others_coarse():
    points = np.concatenate([torso_points(20_000), [[1e6, 0.0, 0.0], [0.0, 2e5, 3e5], [0.0, 0.0, 160.0]]])
    skin = skin_of(points)
    assert skin.step < 0.02
    assert KDTree(points[:-3]).query(skin.points)[0].max() < 0.05
    assert skin.of == len(points)


def test_a_dense_scan_is_thinned_evenly():
    points = torso_points(30_000)
    skin = skin_of(points, most=5_000)
    assert 2_500 < len(skin.places) < 8_000
    assert KDTree(skin.points).query(points)[0].max() < 3 * skin.spacing


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_a_beginning_is_an_even_sample(share: float):
    skin = skin_of(torso_points(20_000))
    some = skin.points[: int(share * len(skin.places))]
    # Of every tenth of the scan along any axis, about as many are there as of the whole.
    for k in range(3):
        edges = np.quantile(skin.points[:, k], np.linspace(0, 1, 11))
        counts = np.histogram(some[:, k], edges)[0] / len(some)
        assert np.abs(counts - 0.1).max() < 0.03
