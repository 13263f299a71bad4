import numpy as np
import pytest
from lunes import RADIUS, lune_area, lune_cup, sphere_points

from brafit.report.mesh import DOTS, cup_mesh, mesh_view, write_cup_ply, write_points_ply

trimesh = pytest.importorskip("trimesh", reason="the mesh reader trimesh is not installed")


def turned(points: np.ndarray) -> np.ndarray:
    return points[:, [1, 2, 0]] + (10, 1000, -30)


def mirrored(points: np.ndarray) -> np.ndarray:
    return turned(points) * (-1, 1, 1)


@pytest.mark.parametrize("place", [None, turned, mirrored])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_cup_in_trimesh(tmp_path, panels, place):
    write_cup_ply(tmp_path / "cup.ply", lune_cup(panels, n=201), place, strips=4)
    mesh = trimesh.load(tmp_path / "cup.ply", process=False)
    assert len(mesh.vertices) == panels * (2 + 199 * 5)
    assert mesh.area == pytest.approx(panels * lune_area(panels), rel=1e-4)
    assert mesh.area_faces.min() > 0
    centre = np.array([[0.0, RADIUS, 0.0]]) if place is None else place(np.array([[0.0, RADIUS, 0.0]]))
    outward = mesh.triangles_center - centre
    assert (np.sum(mesh.face_normals * outward, axis=1) > 0).all()
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert np.array_equal(np.unique(raw["panel"]), np.arange(panels))
    written = np.stack([raw[name] for name in ("nx", "ny", "nz")], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(written, axis=1), 1, atol=1e-12)
    assert np.sum(written[mesh.faces[:, 0]] * mesh.face_normals, axis=1).min() > 0.99


def test_each_panel_is_one_connected_patch_without_cracks():
    mesh = cup_mesh(lune_cup(2), strips=3)
    patches = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).split(only_watertight=False)
    assert len(patches) == 2
    assert all(patch.euler_number == 1 and patch.is_winding_consistent for patch in patches)


def test_cup_and_points_in_open3d(tmp_path):
    o3d = pytest.importorskip("open3d", reason="Open3D or one of its system libraries is missing", exc_type=ImportError)
    points, distances = sphere_points(500)
    write_cup_ply(tmp_path / "cup.ply", lune_cup(2), strips=4)
    write_points_ply(tmp_path / "points.ply", points, distances)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "cup.ply"))
    assert mesh.get_surface_area() == pytest.approx(2 * lune_area(2), rel=1e-3)
    assert mesh.has_vertex_colors()
    assert mesh.has_vertex_normals()
    cloud = o3d.t.io.read_point_cloud(str(tmp_path / "points.ply"))
    np.testing.assert_array_equal(cloud.point.positions.numpy(), points)
    np.testing.assert_allclose(cloud.point.distance.numpy()[:, 0], distances, atol=1e-5)
    legacy = o3d.io.read_point_cloud(str(tmp_path / "points.ply"))
    assert len(legacy.points) == 500
    assert legacy.has_colors()


def test_points_in_trimesh(tmp_path):
    points = np.random.default_rng(0).normal(size=(3, 3)) * 1000
    write_points_ply(tmp_path / "points.ply", points, np.array([-5.0, 0.0, 5.0]))
    cloud = trimesh.load(tmp_path / "points.ply")
    np.testing.assert_array_equal(cloud.vertices, points)
    red, _, blue = cloud.colors[:, :3].T.astype(int)
    assert blue[0] > 2 * red[0]
    assert abs(blue[1] - red[1]) < 20
    assert red[2] > 2 * blue[2]
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"] if "_ply_raw" in cloud.metadata else None
    assert raw is None or raw["distance"].tolist() == [-5, 0, 5]


def test_points_and_distances_must_agree(tmp_path):
    with pytest.raises((ValueError, TypeError)):  # the shape checks of a test run come first
        write_points_ply(tmp_path / "points.ply", np.zeros((3, 3)), np.zeros(2))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_3d_view_shows_cups_as_they_are_worn(side):
    points, distances = sphere_points(700)
    vertices, colours, faces = mesh_view(lune_cup(n=21), points, distances, side)
    assert vertices.shape == colours.shape == (2 * (2 + 19 * 7) + 4 * 700, 3)
    assert faces.min() == 0
    assert faces.max() == len(vertices) - 1
    assert np.abs(vertices.min(0) + vertices.max(0)).max() < 1e-3
    dots = vertices[-4 * 700 :].reshape(-1, 4, 3).mean(1)
    worn = points[:, [1, 0, 2]] * ((1, -1, 1) if side == "left" else (-1, -1, 1))
    np.testing.assert_allclose(dots - dots[0], worn - worn[0], atol=1e-3)


def test_the_3d_view_shows_faces_outwards():
    points, distances = sphere_points(20)
    for side in ("left", "right"):
        vertices, colours, faces = mesh_view(lune_cup(n=21), points, distances, side)
        assert (vertices.dtype, colours.dtype, faces.dtype) == (np.float32, np.uint8, np.int32)
        cup = faces[: len(faces) - 4 * 20]
        corners = vertices[cup].astype(float)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.mean(normals[:, 2] >= -1e-6) > 0.95  # to the viewer


def test_large_clouds_are_thinned_in_the_3d_view():
    points, distances = sphere_points(DOTS + 500)
    vertices, _, _ = mesh_view(lune_cup(n=21), points, distances)
    assert len(vertices) == 2 * (2 + 19 * 7) + 4 * DOTS
