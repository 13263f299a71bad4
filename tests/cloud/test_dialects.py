"""Known meshes, written in every dialect of a format and read back."""

from __future__ import annotations

import random

import numpy as np
import pytest
from dialects import Known, write_gltf, write_obj, write_off, write_ply, write_stl
from hypothesis import given, settings
from hypothesis import strategies as st

from brafit.cloud.mesh import READERS
from brafit.cloud.polygons import filled

many = settings(max_examples=60, deadline=None, derandomize=True, database=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("dialects")


def known(generator: random.Random, most: int = 6) -> Known:
    """Points of a bowl, and polygons of three to `most` corners about its middle, all vertices used."""
    flat = np.array([[generator.uniform(-90, 90) for _ in range(2)] for _ in range(generator.randint(6, 30))])
    flat = flat[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))]
    vertices = np.column_stack([flat, 0.01 * (flat**2).sum(axis=1)]).astype(np.float32).astype(float)
    sizes = [generator.randint(3, most) for _ in vertices]
    return Known(vertices, [[(k + i) % len(vertices) for i in range(size)] for k, size in enumerate(sizes)])


def triangles_of(mesh: Known) -> np.ndarray:
    sizes = np.array([len(polygon) for polygon in mesh.polygons])
    return filled(mesh.vertices, np.concatenate([np.array(polygon) for polygon in mesh.polygons]), sizes)


@many
@given(seed=st.integers(0, 2**32 - 1))
def test_off(folder, seed):
    draw = random.Random(seed)
    mesh = known(draw)
    read = READERS[".off"](write_off(folder / "a.off", mesh, draw.choice))
    np.testing.assert_array_equal(read.vertices, mesh.vertices)
    np.testing.assert_array_equal(read.triangles, triangles_of(mesh))


@many
@given(seed=st.integers(0, 2**32 - 1))
def test_obj(folder, seed, monkeypatch_module):
    draw = random.Random(seed)
    mesh = known(draw)
    read = READERS[".obj"](write_obj(folder / "a.obj", mesh, draw.choice))
    np.testing.assert_array_equal(read.vertices, mesh.vertices)
    # Faces stand in the order in which their vertices do.
    np.testing.assert_array_equal(ordered(read.triangles), ordered(triangles_of(mesh)))


def ordered(triangles: np.ndarray) -> np.ndarray:
    return triangles[np.lexsort(triangles.T)]


@pytest.fixture(scope="module")
def monkeypatch_module():
    """The polygons here overlap, which no surface does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("brafit.cloud.obj.check_uncounted", lambda *_: None)
        yield patch


@many
@given(seed=st.integers(0, 2**32 - 1))
def test_ply(folder, seed):
    draw = random.Random(seed)
    mesh = known(draw)
    read = READERS[".ply"](write_ply(folder / "a.ply", mesh, draw.choice))
    np.testing.assert_array_equal(read.vertices, mesh.vertices)
    np.testing.assert_array_equal(read.triangles, triangles_of(mesh))


@many
@given(seed=st.integers(0, 2**32 - 1))
def test_stl(folder, seed):
    draw = random.Random(seed)
    mesh = known(draw, most=3)
    read = READERS[".stl"](write_stl(folder / "a.stl", mesh, draw.choice))
    np.testing.assert_array_equal(read.vertices[read.triangles], mesh.vertices[np.array(mesh.polygons)])


@many
@given(seed=st.integers(0, 2**32 - 1))
def test_gltf(folder, seed):
    draw = random.Random(seed)
    mesh = known(draw, most=3)
    path, vertices, triangles = write_gltf(folder / "a", mesh, draw.choice)
    read = READERS[path.suffix](path)
    corners = read.vertices[read.triangles]
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) == 0
    repeated = (read.triangles == np.roll(read.triangles, 1, axis=1)).any(axis=1)
    assert (flat >= repeated).all()
    np.testing.assert_allclose(corners[~repeated], vertices[triangles], rtol=1e-12, atol=1e-12)
