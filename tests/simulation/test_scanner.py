from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from brafit.anatomy.wire_detection import concavity
from brafit.cloud import read_cloud
from brafit.cloud.mesh import sample_faces
from brafit.cloud.ply import cloud_ply
from brafit.simulation.scanner import Scanner, seen, simulate
from brafit.surface.normals import off_surface, surface_of
from brafit.surface.symmetry import mirror_of

FRONT = np.array([[0.0, 0.0, 1.0]])


def ball(radius: float = 100.0) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


def test_faces_are_sampled_evenly_by_area():
    # Two triangles of areas 1 and 3, side by side.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [10, 0, 0], [12, 0, 0], [10, 3, 0]])
    points = sample_faces(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 4000)
    assert abs((points[:, 0] < 5).sum() - 1000) <= 1
    large = points[points[:, 0] > 5] - [10, 0, 0]
    assert (large.min(axis=0) >= 0).all()
    assert (large[:, 0] / 2 + large[:, 1] / 3 <= 1 + 1e-12).all()
    # A quarter of a triangle's area lies within half of its sides, in every corner.
    for corner in ([0, 0], [2, 0], [0, 3]):
        share = np.abs((large[:, :2] - corner) / [2, 3]).sum(axis=1)
        near = (np.abs((large[:, :2] - corner) / [2, 3]).max(axis=1) <= 0.5) & (share <= 0.5 + (corner != [0, 0]) * 0.5)
        assert abs(near.mean() - 0.25) < 0.02
    assert KDTree(large).query(large, k=2)[0][:, 1].min() > 0.2 * np.sqrt(3 / 3000)
    with pytest.raises(ValueError, match="its faces have no area"):
        sample_faces(vertices[:1], np.array([[0, 0, 0]]), 10)


def test_a_camera_sees_the_near_half_of_a_ball_only():
    mesh = ball()
    points = sample_faces(mesh.vertices, mesh.faces, 4000)
    visible = seen(points, mesh.vertices, mesh.faces, FRONT)
    # Slanting more than the limit is not measured: with the camera at 1100 mm the seen cap ends at this height.
    assert visible[points[:, 2] > 40].all()
    assert not visible[points[:, 2] < 5].any()


def test_a_simulated_scan_has_the_defects_asked_for(tmp_path):
    mesh = ball()
    clean = Scanner(Scanner.directions(0.4, 0.3), points=5000, noise=0.0, outliers=0.0)
    cloud = simulate(mesh.vertices, mesh.faces, clean, np.random.default_rng(0))
    assert cloud.shape == (5000, 3)
    assert np.abs(np.linalg.norm(cloud, axis=1) - 100).max() < 0.5
    noisy = Scanner(clean.cameras, points=5000, noise=1.0, outliers=0.1)
    cloud = simulate(mesh.vertices, mesh.faces, noisy, np.random.default_rng(0))
    off = np.abs(np.linalg.norm(cloud, axis=1) - 100)
    assert 0.07 < (off > 5).mean() < 0.1
    assert 0.9 < off[off < 5].std() / (1 - 2 / np.pi) ** 0.5 < 1.3
    path = tmp_path / "a.ply"
    path.write_bytes(cloud_ply(cloud))
    np.testing.assert_allclose(read_cloud(path).points, cloud, atol=1e-4)
    found = off_surface(cloud)
    assert found[off > 12].mean() > 0.8
    assert found[off < 2].mean() < 0.01


def test_normals_look_outwards_everywhere():
    mesh = ball()
    points = sample_faces(mesh.vertices, mesh.faces, 3000)
    upper = points[points[:, 2] > -50]
    surface = surface_of(upper, np.array([0.0, 0.0, 1.0]))
    cosine = (surface.normals * upper).sum(axis=1) / np.linalg.norm(upper, axis=1)
    assert cosine.min() > 0.98


def test_concavity_of_known_surfaces():
    generator = np.random.default_rng(0)
    grid = generator.uniform(-60, 60, (3_500, 2))
    for height, expected, tolerance in (
        (np.zeros(len(grid)), 0.0, 1e-9),
        (-(grid**2).sum(axis=1) / 200, -12 / 4 / 100 * (1 - 0.4**2), 0.01),
        ((grid**2).sum(axis=1) / 200, 12 / 4 / 100 * (1 - 0.4**2), 0.01),
    ):
        surface = surface_of(np.column_stack([grid, height]), np.array([0.0, 0.0, 1.0]))
        middle = np.linalg.norm(grid, axis=1) < 20
        assert abs(np.median(concavity(surface, 12.0)[middle]) - expected) < tolerance
    groove = surface_of(np.column_stack([grid, np.abs(grid[:, 0])]), np.array([0.0, 0.0, 1.0]))
    hollow = concavity(groove, 12.0)
    middle = np.abs(grid[:, 1]) < 40
    deepest = grid[middle][np.argsort(-hollow[middle])[:50], 0]
    assert np.abs(deepest).max() < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_the_plane_of_symmetry_is_found(seed):
    generator = np.random.default_rng(seed)
    half = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    body = half.vertices * [150, 300, 100]
    body[:, 2] += np.where(body[:, 1] > 0, 40 * np.exp(-((np.abs(body[:, 0]) - 70) ** 2) / 800), 0)
    points = sample_faces(body, half.faces, 20_000)
    q = np.linalg.qr(generator.standard_normal((3, 3)))[0]
    shift = generator.uniform(-500, 500, 3)
    mirror = mirror_of(points @ q.T + shift)
    truth = q[:, 0] * np.sign(q[:, 0] @ mirror.normal)
    assert np.degrees(np.arccos(min(1.0, truth @ mirror.normal))) < 0.1
    assert abs(mirror.offset - shift @ mirror.normal) < 0.2
    place = np.array([120.0, 30, 50])
    np.testing.assert_allclose(mirror(place @ q.T + shift), place * [-1, 1, 1] @ q.T + shift, atol=0.5)
