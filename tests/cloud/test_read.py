from __future__ import annotations

import bz2
import gzip
import lzma
import os
import re
import sys

import numpy as np
import pytest
from breasts import cup_frame_points, write_ply

from brafit.cloud import FORMATS, read_cloud
from brafit.cloud import open3d_runtime as engine
from brafit.errors import InputError
from brafit.samples import sample_paths

COPY = "Export the cloud again, and check that the copy is complete."


def message(path, capfd) -> str:
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    captured = capfd.readouterr()
    assert captured.out + captured.err == "", "Open3D printed something"
    line = str(caught.value)
    assert "\n" not in line
    assert "\x1b" not in line
    return line.removeprefix(f"{path}: ")


def test_ply_in_double_precision_with_its_flag(tmp_path):
    points = cup_frame_points(200) + 1e-9
    inside = np.arange(200) % 3 > 0
    cloud = read_cloud(write_ply(tmp_path / "a.PLY", points, inside))
    np.testing.assert_array_equal(cloud.points, points)
    assert cloud.inside is not None
    np.testing.assert_array_equal(cloud.inside, inside)
    assert cloud.normals is None
    assert read_cloud(write_ply(tmp_path / "b.ply", points)).inside is None


def test_the_samples_have_normals_and_a_flag():
    cloud = read_cloud(sample_paths()[0])
    assert cloud.points.dtype == np.float64
    assert cloud.normals is not None
    assert cloud.inside is not None
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-3)
    assert 2000 < cloud.inside.sum() < len(cloud.points) == 4000


@pytest.mark.parametrize("extension", ["xyz", "pts", "pcd", "xyzn"])
def test_text_formats(tmp_path, extension):
    points = cup_frame_points(150).round(3)
    rows = [" ".join(map(str, row)) for row in points]
    if extension == "xyzn":
        rows = [f"{row} 0 0 1" for row in rows]
    pcd = "VERSION 0.7;FIELDS x y z;SIZE 4 4 4;TYPE F F F;COUNT 1 1 1;WIDTH 150;HEIGHT 1;VIEWPOINT 0 0 0 1 0 0 0"
    head = {"pts": ["150"], "pcd": [*pcd.split(";"), "POINTS 150", "DATA ascii"]}.get(extension, [])
    path = tmp_path / f"a.{extension}"
    path.write_text("\n".join(head + rows) + "\n")
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, points, atol=1e-4)
    assert (cloud.normals is not None) == (extension == "xyzn")


def test_files_that_are_no_clouds(tmp_path, capfd):
    path = tmp_path / "a.ply"
    assert message(path, capfd) == "there is no such file. Check the path."
    path.write_bytes(b"")
    assert message(path, capfd) == f"the file is empty. {COPY}"
    path.write_text("solid nonsense\n")
    assert message(path, capfd).startswith("cannot be read as a cloud, it is damaged or cut off (")
    (tmp_path / "a.json").write_text("{}")
    assert message(tmp_path / "a.json", capfd) == "is no cloud, but stands beside one. Name a.ply."
    (tmp_path / "b.json").write_text("{}")
    assert message(tmp_path / "b.json", capfd) == (
        f"is not a cloud of a known format ({', '.join(sorted(FORMATS))}). Name a cloud, or export it as .ply."
    )
    assert message(tmp_path, capfd).startswith("is a folder, and one cloud is wanted.")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission(tmp_path, capfd):
    path = write_ply(tmp_path / "a.ply", cup_frame_points(200))
    path.chmod(0)
    assert message(path, capfd).startswith("cannot be read (Permission denied).")


@pytest.mark.parametrize(
    ("pack", "kind"),
    [(gzip.compress, "packed (gzip)"), (bz2.compress, "packed (bzip2)"), (lzma.compress, "packed (xz)")],
)
def test_packed_files_are_named(tmp_path, pack, kind):
    path = write_ply(tmp_path / "a.ply", cup_frame_points(200))
    path.write_bytes(pack(path.read_bytes()))
    with pytest.raises(InputError, match=re.escape(f"a.ply: is {kind}. Unpack it first.")):
        read_cloud(path)


def test_arrays_of_other_things_than_numbers_are_named(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([{"a": 1}] * 200, dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"\(its array holds Python objects, not numbers\)"):
        read_cloud(path)
    np.savez(tmp_path / "a.npz", a=cup_frame_points(200), b=cup_frame_points(200))
    with pytest.raises(InputError, match=r"only: a, b\). Name the one that holds the points positions."):
        read_cloud(tmp_path / "a.npz")


def test_files_cut_off(tmp_path, capfd):
    data = write_ply(tmp_path / "whole.ply", cup_frame_points(200)).read_bytes()
    path = tmp_path / "a.ply"
    for part in (len(data) - 1, len(data) // 2, 150, 60, 3):
        path.write_bytes(data[:part])
        line = message(path, capfd)
        assert line.startswith("cannot be read as a cloud, it is damaged or cut off (")
        assert line.endswith(f"). {COPY}")
    rows = [" ".join(map(str, row)) for row in cup_frame_points(150)]
    path = tmp_path / "a.pts"
    path.write_text("\n".join(["200", *rows]))
    assert "(its first line promises 200 points, 150 follow)" in message(path, capfd)
    path = tmp_path / "a.xyz"
    path.write_text("\n".join([*rows, "1.5 2"]))
    assert message(path, capfd).startswith("cannot be read as a cloud, it is damaged or cut off (")


def write_pcd(path, points, coding="binary", promised=None):
    n = len(points) if promised is None else promised
    header = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\n"
    rows = points.astype("<f4")
    body = rows.tobytes() if coding == "binary" else "\n".join(" ".join(map(str, row)) for row in rows).encode()
    path.write_bytes(f"{header}DATA {coding}\n".encode() + body)
    return path


def test_pcd_files_whole_and_damaged(tmp_path, capfd):
    path, points = tmp_path / "a.pcd", cup_frame_points(150)
    for coding in ("binary", "ascii"):
        np.testing.assert_allclose(read_cloud(write_pcd(path, points, coding)).points, points, rtol=1e-7)
    damaged = "cannot be read as a cloud, it is damaged or cut off ("
    write_pcd(path, points, "ascii", promised=200)
    assert message(path, capfd) == (f"{damaged}its header promises 200 lines of 3 numbers, 150 lines follow). {COPY}")
    whole = write_pcd(path, points, "ascii").read_bytes()
    path.write_bytes(whole.replace(b" ", b"", 20))
    assert "(its header " in message(path, capfd)
    path.write_bytes(b" ".join(whole.rsplit(b"\n", 1)) + b"\n1 2 3")
    assert message(path, capfd).startswith(
        f"{damaged}its header promises 150 lines of 3 numbers, but its lines are not"
    )
    write_pcd(path, points, promised=200)
    assert message(path, capfd) == f"{damaged}its header promises 2400 bytes, 1800 follow). {COPY}"
    whole = write_pcd(path, points).read_bytes()
    for old, new in ((b"SIZE 4 4 4", b"SIZE 4 4"), (b"TYPE F F F", b"TYPE F F Q"), (b"POINTS 150", b"POINTS 15e")):
        path.write_bytes(whole.replace(old, new))
        assert " header " in message(path, capfd)
    path.write_bytes(whole.replace(b"FIELDS x y z", b"FIELDS u v w"))
    other = "its fields are u, v, w, without positions x, y, z). Export it with fields x, y and z."
    assert message(path, capfd) == f"cannot be read as a cloud ({other}"
    path.write_bytes(b"VERSION 0.7\n")
    assert message(path, capfd) == f"{damaged}its header has no line DATA). {COPY}"


@pytest.mark.parametrize("options", [{}, {"write_ascii": True}, {"compressed": True}])
def test_pcd_files_written_by_open3d(tmp_path, options):
    o3d = engine.open3d()
    table = o3d.t.io.read_point_cloud(str(sample_paths()[1]))
    path = tmp_path / "a.pcd"
    assert o3d.t.io.write_point_cloud(str(path), table, **options)
    cloud, expected = read_cloud(path), read_cloud(sample_paths()[1])
    atol = 1e-3 if options else 0
    for name in ("points", "normals", "inside"):
        np.testing.assert_allclose(getattr(cloud, name), getattr(expected, name), rtol=0, atol=atol)


def test_clouds_that_are_empty_or_tiny(tmp_path, capfd):
    path = tmp_path / "a.ply"
    write_ply(path, np.zeros((0, 3)))
    assert message(path, capfd) == f"the cloud is empty: 0 points. {COPY}"
    write_ply(path, cup_frame_points(99))
    assert message(path, capfd) == (
        "the cloud is too small: 99 points. A cup needs at least 100, and thousands to be good: scan more densely."
    )


def test_coordinates_that_are_not_finite(tmp_path, capfd):
    points = cup_frame_points(300)
    few = points.copy()
    few[3, 1], few[8] = np.nan, np.inf
    text = tmp_path / "a.xyz"
    text.write_text("\n".join(" ".join(map(str, row)) for row in few))
    for path in (write_ply(tmp_path / "a.ply", few), text):
        cloud = read_cloud(path)
        assert cloud.dropped == 2
        np.testing.assert_array_equal(cloud.points, np.delete(points, [3, 8], axis=0))
    points[:200] = np.nan
    path = write_ply(tmp_path / "b.ply", points)
    assert message(path, capfd) == (
        "200 of 300 points have coordinates that are NaN, infinite or absurdly large. "
        "Remove these points and export the cloud again."
    )


def test_a_missing_system_library_is_named(monkeypatch):
    class Finder:
        def find_spec(self, name, path=None, target=None):
            if name == "open3d":
                raise ImportError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")

    for name in [name for name in sys.modules if name.split(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    with pytest.raises(engine.Open3DError) as caught:
        engine.open3d()
    assert str(caught.value) == (
        "Open3D cannot be loaded: libusb-1.0.so.0: cannot open shared object file: No such file or directory "
        "(Debian package libusb-1.0-0). "
        "Run: apt-get install -y libgl1 libegl1 libx11-6 libudev1 libusb-1.0-0 libidn2-0 libgomp1"
    )
