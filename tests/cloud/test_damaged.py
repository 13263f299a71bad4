from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import pytest
from breasts import cup_frame_landmarks, cup_frame_points, write_landmarks, write_ply
from damage import damaged_files, sound_files

from brafit.cloud import read_cloud, worker
from brafit.cloud.read import MIN_POINTS
from brafit.errors import InputError
from brafit.scan import load_scan


def test_sound_files_are_read(tmp_path):
    expected = cup_frame_points(600)
    for path in sound_files(tmp_path):
        cloud = read_cloud(path, mesh_points=5000)
        assert len(cloud.points) == (5000 if cloud.faces else 600), path
        low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
        np.testing.assert_allclose(
            [low, high], [expected.min(axis=0), expected.max(axis=0)], atol=8.0, err_msg=str(path)
        )


def refusal(path, what):
    """Why a file is refused; None if it is read, and then it is the breast still."""
    try:
        cloud = read_cloud(path, mesh_points=2000)
        scan = load_scan(path, points=200, mesh_points=2000)
    except InputError as error:
        return str(error)
    assert np.isfinite(cloud.points).all(), what
    assert len(cloud.points) >= MIN_POINTS, what
    # The points of the fit are about the quarter sphere on the wire.
    away = np.abs(np.linalg.norm(scan.points - [0, 65, 0], axis=1) - 65)
    assert np.median(away) < 2.5, what
    return None


def outcomes(folder, count, seed):
    """Read and load every damaged file; the number of refused ones."""
    refused = 0
    begin = time.monotonic()
    for what, path in damaged_files(folder, count, seed):
        write_landmarks(path.with_suffix(".json"), cup_frame_landmarks())
        line = refusal(path, what)
        if line is not None:
            refused += 1
            assert "\n" not in line, what
            assert str(path) in line or str(path.with_suffix(".json")) in line, what
            assert len(line) < 600 + 2 * len(str(path)), what
    assert time.monotonic() - begin < 1.0 * count + 60
    return refused


def test_damaged_files_are_refused_or_read_right(tmp_path, capfd):
    assert outcomes(tmp_path, 90, seed=1) > 20
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""


@pytest.mark.slow
def test_a_thousand_damaged_files(tmp_path):
    assert outcomes(tmp_path, 1000, seed=0) > 300


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_a_reader_that_crashes_or_hangs_costs_one_scan(tmp_path):
    path = write_ply(tmp_path / "a.ply", cup_frame_points(200))
    read_cloud(path)
    child = worker._child
    assert child is not None
    process = child._process
    # Stopped, it answers nothing: a hang.
    os.kill(process.pid, signal.SIGSTOP)
    with pytest.raises(InputError, match=r"cannot be read as a cloud \(reading it took longer than 0\.5 s\)\. "):
        read_cloud(path, seconds=0.5)
    assert len(read_cloud(path).points) == 200
    child = worker._child
    assert child is not None
    os.kill(child._process.pid, signal.SIGSTOP)
    killer = threading.Timer(0.5, os.kill, (child._process.pid, signal.SIGKILL))
    killer.start()
    with pytest.raises(InputError, match=r"cannot be read as a cloud \(its reader crashed on it, signal 9\)\. "):
        read_cloud(path)
    killer.join()
    assert len(read_cloud(path).points) == 200


@pytest.mark.parametrize(("named", "found"), [(".xyz", ".ply"), (".stl", ".ply"), (".ply", ".npy")])
def test_a_wrong_extension_is_named(tmp_path, named, found):
    path = tmp_path / f"a{found}"
    if found == ".ply":
        write_ply(path, cup_frame_points(200))
    else:
        np.save(path, cup_frame_points(200))
    wrong = path.rename(path.with_suffix(named))
    with pytest.raises(InputError) as caught:
        read_cloud(wrong)
    assert str(caught.value) == f"{wrong}: is named {named}, but its content is {found}. Rename it to a{found}."


@pytest.mark.slow
def test_ten_million_points(tmp_path):
    path = write_ply(tmp_path / "a.ply", cup_frame_points(10_000_000))
    write_landmarks(tmp_path / "a.json", cup_frame_landmarks())
    scan = load_scan(path, points=2000)
    assert scan.cleaning.read == 10_000_000
    assert len(scan.points) == 2000
    assert np.abs(np.linalg.norm(scan.points - [0, 65, 0], axis=1) - 65).max() < 0.5
