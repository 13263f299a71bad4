from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest
import trimesh
from breasts import cup_frame_points, write_ply
from dialects import Known, write_stl
from scipy.spatial import Delaunay

from brafit.cloud import read_cloud
from brafit.cloud.mesh import READERS, read_mesh
from brafit.cloud.polygons import filled
from brafit.cloud.refusal import RefusedError
from brafit.errors import InputError


def area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    rows = ["v " + " ".join(map(repr, row)) for row in np.asarray(vertices, dtype=float).tolist()]
    return "\n".join(rows + [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]) + "\n"


def breast(n: int = 600) -> tuple[np.ndarray, np.ndarray]:
    points = cup_frame_points(n)
    return points, Delaunay(points[:, :2]).simplices


def reason(path, data: str | bytes) -> str:
    """Why a file is refused."""
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(ValueError, match=r"\w") as caught:
        read_mesh(path, 1000)
    return caught.value.cause if isinstance(caught.value, RefusedError) else str(caught.value)


# Outlines whose areas are known: an L, a quad with a corner drawn in, a comb, a square with a bridge to a square hole.
OUTLINES = [
    ([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 3.0),
    ([(0, 0), (4, 0), (1, 1), (0, 4)], 4.0),
    ([(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)], 11.0),
    ([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)], 12.0),
    ([(0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (0, 2)], 4.0),
]


@pytest.mark.parametrize(("outline", "expected"), OUTLINES)
def test_polygons_are_filled_within_their_outline(outline, expected):
    flat = np.array(outline, dtype=float)
    axes = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    for turned in (flat, flat[::-1]):
        for first in range(len(flat)):
            vertices = np.roll(turned, first, axis=0) @ axes[:2] + [5, 6, 7]
            triangles = filled(vertices, np.arange(len(flat)), np.array([len(flat)]))
            assert len(triangles) == len(flat) - 2
            # Triangles inside add up to the outline's area; others would exceed it.
            np.testing.assert_allclose(area(vertices, triangles), expected, rtol=1e-12)


def test_polygons_of_too_few_corners_have_no_area():
    vertices = np.eye(3)
    triangles = filled(vertices, np.array([0, 0, 1, 0, 1, 2, 0, 0, 1]), np.array([1, 2, 0, 3, 3]))
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [0, 0, 1]])


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_a_face_that_names_no_vertex_is_named(tmp_path, suffix):
    vertices, faces = breast(200)
    faces = faces.copy()
    faces[7, 1] = 200
    path = tmp_path / f"a{suffix}"
    trimesh.Trimesh(vertices, faces, process=False, validate=False).export(path)
    line = reason(path, path.read_bytes())
    assert (
        "names vertex 201, there are 200, counted from 1"
        if suffix == ".obj"
        else "names vertex 200, counted from 0, of 200"
    ) in line


def test_vertices_that_no_face_uses_may_be_anything(tmp_path):
    vertices, faces = breast(200)
    extra = np.vstack([vertices, [[np.nan, 0, 0], [1e30, 0, 0]]])
    for suffix in (".obj", ".off", ".ply"):
        path = tmp_path / f"a{suffix}"
        for corners in (vertices, extra):
            trimesh.Trimesh(corners, faces, process=False).export(path)
            columns = read_mesh(path, 500)
            np.testing.assert_allclose(columns["positions"], read_mesh(path, 500)["positions"])
            assert np.isfinite(columns["positions"]).all()
            assert columns["faces"][0] == len(faces)
        vertices_ = vertices.copy()
        vertices_[faces[0, 0]] = np.nan
        trimesh.Trimesh(vertices_, faces, process=False).export(path)
        assert reason(path, path.read_bytes()) == "1 of 200 vertices of its faces are NaN, infinite or absurdly large"


# OBJ: whole meshes of any kind are read, those with lines lost or doubled are not.


def fine_beside_coarse() -> trimesh.Trimesh:
    coarse = trimesh.creation.icosphere(subdivisions=3, radius=100.0)
    fine = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    fine.apply_translation([0, 0, 105])
    vertices = np.vstack([coarse.vertices, fine.vertices])
    return trimesh.Trimesh(vertices, np.vstack([coarse.faces, fine.faces + len(coarse.vertices)]), process=False)


def twice_sided() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=3)
    return trimesh.Trimesh(ball.vertices, np.vstack([ball.faces, ball.faces[:, ::-1]]), process=False)


@pytest.mark.parametrize(
    "mesh",
    [
        fine_beside_coarse(),
        twice_sided(),
        trimesh.creation.cylinder(1.0, 500.0, sections=64),
        trimesh.creation.box((1, 20, 300)),
        trimesh.creation.icosahedron(),
        trimesh.creation.cone(1.0, 30.0, sections=40),
        trimesh.Trimesh(*breast(), process=False),
    ],
    ids=["fine and coarse", "both sides", "thin and long", "box", "icosahedron", "cone", "breast"],
)
def test_whole_meshes_are_read_from_obj(tmp_path, mesh):
    path = tmp_path / "a.obj"
    path.write_text(obj_text(mesh.vertices, mesh.faces))
    read = READERS[".obj"](path)
    np.testing.assert_array_equal(read.vertices, mesh.vertices)
    np.testing.assert_array_equal(read.triangles, mesh.faces)


def test_an_obj_with_lines_lost_or_doubled_is_refused(tmp_path):
    vertices, faces = breast()
    lines = obj_text(vertices, faces).splitlines()
    path = tmp_path / "a.obj"
    assert "names vertex 600, there are 599" in reason(path, "\n".join(lines[:99] + lines[100:]))
    doubled = "\n".join(lines[:60] + lines[20:])
    assert reason(path, doubled) == "its vertices from the 21. on stand in it twice, as if lines were doubled"
    # No count tells here, because the last vertices are in no face; what the faces join does.
    unused = [f"v {k} 0 -9" for k in range(30)]
    shifted = "\n".join([*lines[:99], *lines[100:600], *unused, *lines[600:]])
    assert "join vertices far apart" in reason(path, shifted)
    assert "its faces use" in reason(path, "\n".join(lines[:650]))
    assert (
        reason(path, "\n".join(["v 1 2 3", "vt 0 0"]))
        == "it has texture coordinates but no faces, as if its end were missing"
    )
    path.write_text("\n".join([*lines[:600], *lines[:600], *lines[600:]]))
    assert len(READERS[".obj"](path).triangles) == len(faces)  # a copy at the end shifts nothing


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("v 1 2", "line 601 is not complete: a vertex with 2 of its numbers"),
        ("v 1 2 3 4 5", "line 601 is not complete: a vertex with 5 of its numbers"),
        ("v 1;5 2 3", "line 601: '1;5' is no number"),
        ("v 1 2 3 0.5", "line 601 gives a vertex the weight 0.5, which makes sense in curved surfaces only"),
        ("f 1 2", "line 601 is not complete: a face of 2 corners"),
        ("f 1 2 0", "line 601: a face names vertex 0, there are 600, counted from 1"),
        ("f 1 2 -700", "line 601: a face names vertex -700, 600 stand before it"),
        ("f 1 2 3.5", "line 601: '3.5' is no whole number"),
        ("w 1 2 3", "line 601 begins with 'w', which no line of an OBJ does"),
        ("surf 0 1 0 1 1 2", "line 601 (surf) brings more than polygons, which is not read"),
    ],
)
def test_what_is_wrong_in_an_obj_is_named(tmp_path, line, expected):
    lines = obj_text(*breast()).splitlines()
    assert reason(tmp_path / "a.obj", "\n".join([*lines[:600], line, *lines[600:]])) == expected


def test_an_obj_without_faces_is_a_cloud(tmp_path):
    points = cup_frame_points(150)
    path = tmp_path / "a.obj"
    path.write_text("\n".join(["vn 0 0 1", *(f"v {x} {y} {z} 0.1 0.2 0.3" for x, y, z in points.tolist()), "p 1 2"]))
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.points, points)
    assert cloud.faces == 0


def test_what_is_wrong_in_an_stl_is_named(tmp_path):
    vertices, faces = breast()
    path = tmp_path / "a.stl"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    data, n = path.read_bytes(), len(faces)
    for count, rest in ((n + 5, f"it has bytes for {n}"), (n - 5, "5 more follow"), (0, f"{n} more follow")):
        assert (
            reason(path, data[:80] + struct.pack("<I", count) + data[84:])
            == f"its header counts {count} triangles, {rest}"
        )
    assert f"it has bytes for {n - 1}" in reason(path, data[:-10])
    slipped = reason(path, data[:5000] + b"\x07" * 17 + data[5000:])
    assert slipped == "17 bytes follow the triangles that its header counts, the last of which join nothing"
    text = write_stl(path, Known(vertices, faces[:150].tolist()), lambda values: list(values)[-1]).read_bytes()
    assert reason(path, text[: text.rindex(b"endsolid")]) == "its last line is not 'endsolid'"
    text = text.replace(b"\r", b"\n")
    lines = text.split(b"\n")
    assert "stands where 'vertex' should" in reason(path, b"\n".join(lines[:4] + lines[5:]))


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".off"])
def test_meshes_in_utf16_are_read(tmp_path, suffix):
    """As PowerShell writes what a program prints; an STL was said to be cut off, with a count of millions."""
    vertices, faces = breast()
    path, other = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    kind = {".ply": {"encoding": "ascii"}, ".stl": {"file_type": "stl_ascii"}}.get(suffix, {})
    trimesh.Trimesh(vertices, faces, process=False).export(path, **kind)
    other.write_bytes(path.read_bytes().decode().encode("utf-16"))
    one, two = READERS[suffix](path), READERS[suffix](other)
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.triangles, two.triangles)


def test_an_obj_that_counts_from_0_is_called_that(tmp_path):
    vertices, faces = breast()
    text = obj_text(vertices, faces - 1)
    assert reason(tmp_path / "a.obj", text) == "its faces count the vertices from 0, an OBJ counts them from 1"


def ply(*body: str, faces: int = 1, extra: str = "") -> str:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    corners = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    return (
        f"{head}element face {faces}\nproperty list uchar int vertex_indices\n{extra}end_header\n{corners}"
        + "\n".join(body)
    )


def test_what_is_wrong_in_a_ply_is_named(tmp_path):
    path = tmp_path / "a.ply"
    assert reason(path, ply("3 0 1 9")) == "a face names vertex 9, counted from 0, of 4"
    assert reason(path, ply("3 0 1 2.5")) == "a vertex that its face elements name is no whole number"
    assert reason(path, ply("3 0 1")) == "its header promises 1 of face, it ends within number 1"
    assert (
        reason(path, ply("3 0 1 2 3"))
        == "its header promises 16 numbers, 17 follow: its rows are not as the header says"
    )
    assert reason(path, ply("3 0 1 2", "0.5 1", faces=2)) == "line 15: '0.5' stands where a count should"
    assert reason(path, ply("x 0 1 2")) == "line 14: 'x' is no number"
    assert reason(path, ply("3 0 1 2", faces=9)) == "its header promises 21 numbers or more, 16 follow"
    assert reason(path, ply("3 0 0 1")) == "its faces have no area"
    assert "have no list vertex_indices" in reason(path, ply("3 0 1 2").replace("vertex_indices", "corners"))


def test_properties_of_a_ply_in_capitals(tmp_path):
    path = tmp_path / "a.ply"
    capitals = ply("3 0 1 2").replace("float x", "float X").replace("float y", "float Y").replace("float z", "float Z")
    path.write_text(capitals)
    np.testing.assert_array_equal(READERS[".ply"](path).vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    both = capitals.replace("property float Z\n", "property float Z\nproperty float z\n")
    for corner in ("0 0 0", "1 0 0", "1 1 0", "0 1 0"):
        both = both.replace(f"{corner}\n", f"{corner} 5\n")
    path.write_text(both)
    np.testing.assert_array_equal(READERS[".ply"](path).vertices[:, 2], [5, 5, 5, 5])


def test_positions_by_other_names_are_no_damage(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(ply("3 0 1 2").replace("float x", "float px"))
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    assert caught.value.cause == "cannot be read as a cloud (its vertices have no positions x, y, z: only px, y, z)"


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".obj", "v 1,5 2,5 3,5\n"),
        (".ply", ply("3 0 1 2").replace("1 1 0", "1,0 1,5 0,0")),
        (".off", "OFF\n1 0 0\n1,5 2,5 3,5\n"),
        (
            ".stl",
            "solid\nfacet normal 0 0 1\nouter loop\nvertex 1,5 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
            "endloop\nendfacet\nendsolid",
        ),
    ],
)
def test_decimal_commas_in_a_mesh_are_named(tmp_path, suffix, text):
    path = tmp_path / f"a{suffix}"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    assert "has a decimal comma, which this format does not know)" in caught.value.cause
    assert caught.value.remedy == "Export it with decimal points"


@pytest.mark.parametrize("solids", [1, 2])
def test_an_ascii_stl_may_be_one_line(tmp_path, solids):
    vertices, faces = breast()
    spelt = [
        " facet normal 0 0 1 outer loop "
        + " ".join("vertex " + " ".join(f"{float(x)!r}" for x in corner) for corner in vertices[face])
        + " endloop endfacet"
        for face in faces[:150]
    ]
    parts = [spelt] if solids == 1 else [spelt[:70], spelt[70:]]
    path = tmp_path / "a.stl"
    path.write_text(" ".join(f"solid a {k}{''.join(part)} endsolid a {k}" for k, part in enumerate(parts)))
    np.testing.assert_array_equal(READERS[".stl"](path).vertices, vertices[faces[:150]].reshape(-1, 3))


def test_strips_of_a_ply_are_its_faces(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(ply("8 0 1 3 2 -1 0 1 2").replace("element face", "element tristrips"))
    mesh = READERS[".ply"](path)
    assert sorted(map(sorted, mesh.triangles.tolist())) == [[0, 1, 2], [0, 1, 3], [1, 2, 3]]


def test_a_mesh_with_a_flag_is_a_cloud(tmp_path):
    points = cup_frame_points(150)
    path = write_ply(tmp_path / "a.ply", points, np.arange(150) % 2 > 0)
    data = path.read_bytes().replace(
        b"end_header\n", b"element face 1\nproperty list uchar int vertex_index\nend_header\n"
    )
    path.write_bytes(data + struct.pack("<B3i", 3, 0, 1, 2))
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.points, points)
    assert cloud.inside is not None


# glTF


def gltf(**changes) -> dict:
    """A triangle whose positions are in its own buffer, with things changed."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    uri = "data:;base64," + base64.b64encode(data).decode()
    content = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [{"byteLength": len(data), "uri": uri}],
    }
    return {**content, **changes}


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "is compressed with Draco"),
        ({"extensionsRequired": ["EXT_meshopt_compression"]}, "is compressed with meshopt"),
        ({"extensionsRequired": ["ACME_voxels"]}, "needs the extension ACME_voxels"),
        (
            {"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]},
            "places its meshes many times over (EXT_mesh_gpu_instancing)",
        ),
        ({"buffers": [{"byteLength": 36, "uri": "http://a.b/c.bin"}]}, "keeps its data elsewhere (http://a.b/c.bin)"),
        ({"buffers": [{"byteLength": 36, "uri": "../c.bin"}]}, "keeps its data elsewhere (../c.bin)"),
        ({"buffers": [{"byteLength": 36, "uri": "c.bin"}]}, "keeps its data in c.bin, which is not beside it"),
    ],
)
def test_a_gltf_of_a_kind_that_is_not_read_is_named(tmp_path, changes, cause):
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(gltf(**changes)))
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    assert caught.value.cause == f"cannot be read as a cloud (it {cause})"
    with pytest.raises(RefusedError):
        READERS[".gltf"](path)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}]}, "needs 48 bytes"),
        ({"buffers": [{"byteLength": 99, "uri": "data:;base64,AAAA"}]}, "should have 99 bytes, it has 3"),
        ({"nodes": [{"mesh": 5}]}, "names number 5 of its meshes"),
        ({"nodes": [{"mesh": 0, "children": [1]}, {"children": [0]}]}, "child of two others"),
        ({"accessors": [{}]}, "does not describe a scene"),
    ],
)
def test_a_damaged_gltf_is_refused(tmp_path, changes, part):
    content = gltf(**changes)
    if "two" in part:
        content |= {"scenes": [{"nodes": [0]}]}
    assert part in reason(tmp_path / "a.gltf", json.dumps(content))


def test_a_gltf_at_rest(tmp_path):
    """Instances, a morph target at half weight, and a skin, which places its mesh by its joint alone."""
    target = {"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}]}
    content = gltf(
        nodes=[{"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0, "scale": [2, 2, 2]}],
        meshes=[{"primitives": [target], "weights": [0.5]}],
    )
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(content))
    one = 1.5 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = READERS[".gltf"](path)
    np.testing.assert_allclose(mesh.vertices, np.vstack([one + np.array([5, 0, 0]), 2 * one]), atol=1e-12)
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [3, 4, 5]])
    # Joints and weights without a buffer view are zeros: all vertices hang on joint 0, with no weight at all.
    empty = {"count": 3, "type": "VEC4"}
    accessors = [*gltf()["accessors"], {**empty, "componentType": 5121}, {**empty, "componentType": 5126}]
    part = {"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}
    nodes = [{"mesh": 0, "skin": 0, "translation": [9, 9, 9]}, {"translation": [0, 0, 3]}]
    content = gltf(nodes=nodes, meshes=[{"primitives": [part]}], skins=[{"joints": [1]}], accessors=accessors)
    assert "do not add up to 1" in reason(path, json.dumps(content))
    accessors[2] = {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC4"}
    content |= {"bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 1, "byteLength": 48}]}
    ones = base64.b64encode(np.array([[1, 0, 0, 0]] * 3, "<f4").tobytes()).decode()
    content["buffers"] = [*content["buffers"], {"byteLength": 48, "uri": f"data:;base64,{ones}"}]
    path.write_text(json.dumps(content))
    np.testing.assert_allclose(READERS[".gltf"](path).vertices, one / 1.5 + np.array([0, 0, 3]), atol=1e-12)
