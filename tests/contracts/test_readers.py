"""What every reader of clouds promises: the known cloud back, and of a file cut off one clear error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from breasts import cup_frame_points, write_ply
from ptx import PtxReader
from scipy.spatial import Delaunay
from trimesh.exchange.gltf import export_gltf

from brafit.cloud import FORMATS, Reader, read_cloud
from brafit.cloud.mesh import MESH_FORMATS
from brafit.cloud.text import TEXT_FORMATS
from brafit.errors import InputError

COUNT = 400
OTHERS: tuple[Reader, ...] = (PtxReader(),)
"""Readers from outside of brafit."""
SUFFIXES = sorted(FORMATS | {end for reader in OTHERS for end in reader.suffixes})
SAMPLED = (".glb", ".gltf", ".stl")
"""Formats that always have faces, on which points are sampled."""
UNCOUNTED = TEXT_FORMATS - {".pts"}
"""Tables of rows that nothing counts: one that ends after a row is whole."""


def known() -> np.ndarray:
    return cup_frame_points(COUNT)


def plane() -> np.ndarray:
    """For formats that have faces: what is sampled on it lies in it."""
    x, y = np.meshgrid(np.arange(0, 100.0, 5), np.arange(0, 100.0, 5))
    return np.stack((x.ravel(), y.ravel(), 2 * x.ravel() - y.ravel()), axis=1)


def rows(points: np.ndarray, between: str = " ", tail: str = "") -> str:
    return "\n".join(between.join(map(repr, map(float, point))) + tail for point in points) + "\n"


def write_text(path: Path) -> None:
    kind, points = path.suffix, known()
    head = {".pts": f"{COUNT}\n", ".csv": "x,y,z\n"}.get(kind, "")
    path.write_text(head + rows(points, "," if kind == ".csv" else " ", " 0 0 1" if kind == ".xyzn" else ""))


def write_mesh(path: Path) -> None:
    points = plane()
    mesh = trimesh.Trimesh(points, Delaunay(points[:, :2]).simplices, process=False)
    if path.suffix == ".gltf":  # with its buffers inside
        path.write_bytes(export_gltf(mesh, embed_buffers=True)["model.gltf"])
    else:
        data = mesh.export(file_type=path.suffix[1:])
        assert isinstance(data, bytes)
        path.write_bytes(data)


def write_vertices(path: Path) -> None:
    """OBJ and OFF without faces."""
    points = known()
    head, each = ("OFF\n" + f"{COUNT} 0 0\n", "") if path.suffix == ".off" else ("", "v ")
    path.write_text(head + "".join(f"{each}{line}\n" for line in rows(points).splitlines()))


def write_pcd(path: Path) -> None:
    head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {COUNT}\nHEIGHT 1\nPOINTS {COUNT}\n"
    path.write_bytes(f"{head}DATA binary\n".encode() + known().astype("<f4").tobytes())


def write_ptx(path: Path) -> None:
    """Metres, moved by its matrix; a tenth of the cells saw nothing."""
    shift, seen = np.array([1.0, 2.0, 3.0]), known() / 1000
    cells = np.concatenate((seen - shift, np.zeros((COUNT // 10, 3))))
    head = f"{len(cells)}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n1 2 3 1\n"
    path.write_text(head + rows(cells, tail=" 0.5"))


WRITERS: dict[str, Callable[[Path], object]] = {
    **dict.fromkeys(TEXT_FORMATS, write_text),
    **dict.fromkeys(SAMPLED, write_mesh),
    **dict.fromkeys((".obj", ".off"), write_vertices),
    ".ply": lambda path: write_ply(path, known()),
    ".pcd": write_pcd,
    ".npy": lambda path: np.save(path, known()),
    ".npz": lambda path: np.savez(path, points=known()),
    ".ptx": write_ptx,
}


@pytest.mark.parametrize("suffix", SUFFIXES)
class TestReader:
    @staticmethod
    def read(path: Path):
        return read_cloud(path, apart=False, mesh_points=500, readers=OTHERS)

    def test_a_known_cloud_is_read_back(self, suffix, tmp_path):
        path = tmp_path / f"a{suffix.upper()}"
        WRITERS[suffix](tmp_path / f"a{suffix}")
        (tmp_path / f"a{suffix}").rename(path)
        cloud = self.read(path)
        unit = 1000.0 if cloud.unit == "m" else 1.0
        assert cloud.points.dtype == np.float64
        assert cloud.path == path
        if suffix in SAMPLED:
            x, y, z = unit * cloud.points.T
            np.testing.assert_allclose(z, 2 * x - y, atol=1e-3)
            np.testing.assert_allclose((x.min(), x.max()), (0, 95), atol=5)
            assert len(x) == 500
            assert cloud.faces > 0
        else:
            np.testing.assert_allclose(unit * cloud.points, known(), atol=1e-9 if suffix != ".pcd" else 1e-5)
            assert cloud.faces == 0

    def test_a_file_cut_off_gives_one_error_that_names_it(self, suffix, tmp_path):
        whole, path = tmp_path / f"whole{suffix}", tmp_path / f"a{suffix}"
        WRITERS[suffix](whole)
        data = whole.read_bytes()
        refusals, counts = [], []
        for part in (0, 1, 40, len(data) // 3, 2 * len(data) // 3 + 1, len(data) - 30):
            path.write_bytes(data[:part])
            try:
                counts.append(len(self.read(path).points))
            except InputError as error:
                refusals.append(str(error))
        assert all(line.startswith(f"{path}: ") and "\n" not in line for line in refusals)
        assert len(refusals) >= 3
        assert not counts or (suffix in UNCOUNTED | {".obj"} and max(counts) < COUNT), "read as a whole file"

    def test_a_file_that_is_something_else_is_refused(self, suffix, tmp_path):
        path = tmp_path / f"a{suffix}"
        path.write_text("Dear all,\nplease find the minutes enclosed.\n" * 40)
        with pytest.raises(InputError, match=r"\S"):
            self.read(path)


def test_every_format_is_written_here():
    assert set(WRITERS) == set(SUFFIXES)
    assert set(SAMPLED) < MESH_FORMATS
