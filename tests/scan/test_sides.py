"""Both sides of a body from one pass, and loading in a process that is guarded itself."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from breasts import cup_frame_points, write_breast, write_ply
from torsos import torso, write

from brafit.cloud import read_cloud, worker
from brafit.errors import InputError
from brafit.landmarks import landmarks_path
from brafit.samples import sample_paths
from brafit.scan import Scan, load_scan, load_sides


def same(one: Scan, other: Scan) -> bool:
    """Bit by bit."""
    pairs = [(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(Scan)]
    return one.frame.equals(other.frame) and all(
        np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs if a is not one.frame
    )


@pytest.fixture(scope="module", params=["alike", "different"])
def body(request, tmp_path_factory):
    heights = {"alike": 30.0, "different": 36.0}
    return write(tmp_path_factory.mktemp("body"), torso(heights[request.param], n=40_000))


def test_both_sides_are_what_each_is_alone(body):
    left, right = load_sides(body, ("left", "right"), points=500)
    assert isinstance(left, Scan)
    assert isinstance(right, Scan)
    assert (left.side, right.side) == ("left", "right")
    assert same(left, load_scan(body, side="left", points=500))
    assert same(right, load_scan(body, side="right", points=500))
    (alone,) = load_sides(body, [None], points=500)
    assert isinstance(alone, Scan)
    assert same(alone, left)


def test_both_sides_of_a_file_that_marks_both(body, tmp_path):
    points = np.load(body)
    marks = json.loads(landmarks_path(body).read_text())
    flip = np.array([-1.0, 1, 1])
    other = {
        "side": "right",
        "wire": (np.array(marks["wire"]) * flip).tolist(),
        "landmarks": {name: (np.array(place) * flip).tolist() for name, place in marks["landmarks"].items()},
    }
    path = tmp_path / "both.npy"
    np.save(path, points)
    landmarks_path(path).write_text(json.dumps({"breasts": [marks, other]}))
    scans = load_sides(path, ("right", "left"), points=500)
    for side, scan in zip(("right", "left"), scans, strict=True):
        assert isinstance(scan, Scan)
        assert same(scan, load_scan(path, side=side, points=500))
        assert scan.cleaning.read == len(points)


def test_a_side_that_cannot_be_loaded_does_not_stop_the_other(tmp_path):
    path = write_breast(tmp_path)
    left, right = load_sides(path)
    assert isinstance(left, Scan)
    assert isinstance(right, InputError)
    with pytest.raises(InputError) as caught:
        load_scan(path, side="right")
    assert str(caught.value) == str(right)
    path.write_bytes(b"ply\nformat")
    both = load_sides(path)
    assert all(isinstance(error, InputError) for error in both)
    assert len({str(error) for error in both}) == 1


def test_a_cloud_that_has_been_read_is_not_read_again(tmp_path):
    path = write_breast(tmp_path)
    cloud, expected = read_cloud(path), load_scan(path)
    path.unlink()
    assert same(load_scan(cloud), expected)


def test_reading_in_this_process_gives_the_same(tmp_path, monkeypatch):
    samples = sample_paths()[:1]
    npy = tmp_path / "a.npy"
    np.save(npy, cup_frame_points(200))
    broken = [tmp_path / name for name in ("a.ply", "a.xyz", "a.pcd", "a.npz", "a.stl", "a.obj")]
    for path in broken:
        path.write_bytes(b"ply\nformat" if path.suffix == ".ply" else b"1 2\nfacet")
    write_ply(tmp_path / "cut.ply", cup_frame_points(200))
    (tmp_path / "cut.ply").write_bytes((tmp_path / "cut.ply").read_bytes()[:-50])
    broken.append(tmp_path / "cut.ply")
    clouds = [read_cloud(path) for path in (*samples, npy)]
    reasons = [_reason(path, apart=True) for path in broken]
    monkeypatch.setattr(worker, "_Child", None)  # no other process can be started
    monkeypatch.setattr(worker, "_child", None)
    for path, cloud in zip((*samples, npy), clouds, strict=True):
        here = read_cloud(path, apart=False)
        np.testing.assert_array_equal(here.points, cloud.points)
        assert (here.inside is None) == (cloud.inside is None)
    assert [_reason(path, apart=False) for path in broken] == reasons


def _reason(path, apart: bool) -> str:
    with pytest.raises(InputError) as caught:
        read_cloud(path, apart=apart)
    return str(caught.value)
