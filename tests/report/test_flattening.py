"""The flat patterns against an independent flattening, and the files of the cup in 3D against an independent reader."""

import numpy as np
import pytest
from check_cup import angle_defect, edge_strain, flattened, misfit
from lunes import lune_area, lune_cup, lune_flat

from brafit.pattern import Side, pieces_from_panels
from brafit.report.mesh import PanelMesh, panel_meshes, write_cup_glb, write_cup_obj


def meshes(panels: int = 2, n: int = 401, strips: int = 4, side: Side = "left", place=None) -> list[PanelMesh]:
    return panel_meshes(lune_cup(panels, n), pieces_from_panels(lune_flat(panels, n), side), strips, place)


@pytest.mark.parametrize("method", ["lscm", "arap"])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_independent_flattening_is_congruent_to_the_pattern(panels, method):
    pytest.importorskip("igl", reason="the flattening package libigl is not installed")
    for mesh in meshes(panels):
        flat = flattened(mesh, method)
        assert misfit(flat, mesh.flat) <= 0.02
        assert edge_strain(flat, mesh.vertices, mesh.faces) <= 1e-4


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_every_triangle_is_as_large_in_the_pattern_as_on_the_cup(panels):
    for mesh in meshes(panels):
        assert edge_strain(mesh.flat, mesh.vertices, mesh.faces) < 1e-4


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_inner_vertices_have_no_angle_defect(panels):
    for mesh in meshes(panels):
        assert angle_defect(mesh.vertices, mesh.faces) < 1e-9


def mirrored(points: np.ndarray) -> np.ndarray:
    return points[:, [1, 2, 0]] * (-1, 1, 1) + (10, 1000, -30)


@pytest.mark.parametrize(("side", "place"), [("left", None), ("right", mirrored)])
def test_glb_in_trimesh(tmp_path, side, place):
    trimesh = pytest.importorskip("trimesh", reason="the mesh reader trimesh is not installed")
    made = meshes(3, 101, side=side, place=place)
    write_cup_glb(tmp_path / "cup.glb", made)
    scene = trimesh.load(tmp_path / "cup.glb", process=False)
    assert set(scene.geometry) == {"lower panel", "middle panel", "upper panel"}
    for mesh in made:
        read = scene.geometry[mesh.name]
        np.testing.assert_allclose(read.vertices, mesh.vertices, atol=1e-4)
        np.testing.assert_allclose(read.vertex_normals, mesh.normals, atol=1e-5)
        np.testing.assert_array_equal(read.faces, mesh.faces)
        uv = np.asarray(read.visual.uv)
        np.testing.assert_allclose(misfit(uv, mesh.flat), 0, atol=1e-3)  # trimesh turns v over
        node = next(n for n in scene.graph.nodes_geometry if scene.graph[n][1] == mesh.name)
        np.testing.assert_allclose(scene.graph[node][0][:3, :3], np.eye(3) / 1000, atol=1e-12)
    areas = [scene.geometry[mesh.name].area for mesh in made]
    np.testing.assert_allclose(areas, lune_area(3), rtol=1e-3)


def test_obj_as_its_text_says(tmp_path):
    made = meshes(2, 51)
    write_cup_obj(tmp_path / "cup.obj", made)
    found: dict[str, list] = {"v": [], "vt": [], "vn": [], "f": []}
    objects: list[tuple[str, int]] = []
    for line in (tmp_path / "cup.obj").read_text().splitlines():
        word, *rest = line.split()
        if word == "o":
            objects.append((rest[0], len(found["f"])))
        elif word in found:
            found[word].append([int(x.split("/")[0]) for x in rest] if word == "f" else [float(x) for x in rest])
    assert [name for name, _ in objects] == ["lower_panel", "upper_panel"]
    np.testing.assert_allclose(found["v"], np.vstack([mesh.vertices for mesh in made]), atol=1e-6)
    np.testing.assert_allclose(found["vt"], np.vstack([mesh.flat for mesh in made]), atol=1e-6)
    first = objects[1][1]
    np.testing.assert_array_equal(np.array(found["f"][:first]) - 1, made[0].faces)
    np.testing.assert_array_equal(np.array(found["f"][first:]) - 1 - len(made[0].vertices), made[1].faces)


def test_obj_in_open3d(tmp_path):
    o3d = pytest.importorskip("open3d", reason="Open3D or one of its system libraries is missing", exc_type=ImportError)
    write_cup_obj(tmp_path / "cup.obj", meshes(2, 101))
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "cup.obj"))
    assert mesh.get_surface_area() == pytest.approx(2 * lune_area(2), rel=1e-3)
    assert mesh.has_triangle_uvs()
    uv = np.asarray(mesh.triangle_uvs)
    assert np.ptp(uv[:, 0]) == pytest.approx(2 * 80 * 1.5117, rel=0.01)
