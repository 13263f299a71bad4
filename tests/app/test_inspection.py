from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
import torsos
from matplotlib.figure import Figure
from scipy.spatial import Delaunay

from brafit.cli.inspect import _TAKEN, main
from brafit.cloud import read_cloud
from brafit.landmarks import landmarks_path, read_landmarks
from brafit.samples import sample_paths
from brafit.scan.discovery import passed_over
from brafit.surface.cleaning import Cleaning
from brafit.underwires.nearest import nearest_wire


def inspect(*arguments) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_every_step_of_the_cleaning_has_its_words():
    steps = {field.name for field in fields(Cleaning) if field.default == 0}
    assert _TAKEN.keys() == {"other_side"} | steps


def test_a_scan_gets_a_picture_and_its_landmarks_back(tmp_path, capsys):
    sample = sample_paths()[0]
    assert inspect(sample, "--out", tmp_path) == 0
    line = capsys.readouterr().out.strip()
    assert line.startswith(f"{sample.stem}: left: landmarks given, wire given (")
    wire = read_landmarks(landmarks_path(sample)).wire
    assert wire is not None
    assert f", nearest wire sold {nearest_wire(wire)}" in line
    assert (tmp_path / f"{sample.stem}_left.png").read_bytes().startswith(b"\x89PNG")
    given, written = read_landmarks(landmarks_path(sample)), read_landmarks(tmp_path / f"{sample.stem}.json")
    assert given.wire is not None
    assert written.wire is not None
    np.testing.assert_allclose(written.wire, given.wire, atol=0.002)
    np.testing.assert_allclose(written.points["apex"], given.points["apex"], atol=0.002)


def test_a_detected_wire_is_called_so_in_line_and_file(tmp_path, capsys):
    sample = sample_paths()[0]
    assert inspect(sample, "--out", tmp_path, "--wire", "detect") == 0
    assert "wire detected" in capsys.readouterr().out
    wire = read_landmarks(tmp_path / f"{sample.stem}.json").wire
    given = read_landmarks(landmarks_path(sample)).wire
    assert wire is not None
    assert given is not None
    assert np.linalg.norm(wire[[0, -1]] - given[[0, -1]], axis=1).max() < 0.5
    assert 0.1 < np.linalg.norm(wire[25] - given[25]) < 12


def test_status_and_reasons(tmp_path, capsys):
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat")
    shutil.copy(sample_paths()[0], tmp_path / "good.ply")
    shutil.copy(landmarks_path(sample_paths()[0]), tmp_path / "good.json")
    assert inspect(tmp_path, "--out", tmp_path / "out") == 1
    said = capsys.readouterr()
    assert said.err.startswith(f"failed: {tmp_path / 'broken.ply'}: ")
    assert len(said.err.strip().splitlines()) == 1
    assert inspect(tmp_path / "broken.ply", "--out", tmp_path / "out") == 2
    (tmp_path / "empty").mkdir()
    assert inspect(tmp_path / "empty", "--out", tmp_path / "out") == 2
    assert "the folder holds no cloud" in capsys.readouterr().err


def test_a_breast_without_marks_cannot_be_proposed(tmp_path, capsys):
    shutil.copy(sample_paths()[0], tmp_path / "alone.ply")
    assert inspect(tmp_path / "alone.ply", "--out", tmp_path / "out", "--units", "mm") == 2
    assert not list((tmp_path / "out").glob("*.json"))
    line = capsys.readouterr().err.strip()
    assert "no whole torso: landmarks can be proposed on a torso only" in line
    assert len(line.splitlines()) == 1
    assert inspect(tmp_path / "alone.ply", "--out", tmp_path / "out") == 2
    line = capsys.readouterr().err.strip()
    assert "it seems to be a part of a body, where landmarks cannot be proposed" in line
    assert "Mark it by hand with brafit-mark. Only if it is a whole torso, say its unit: --units UNIT" in line


def test_an_error_names_the_option_that_the_command_has(tmp_path, capsys):
    shutil.copy(sample_paths()[0], tmp_path / "good.ply")
    shutil.copy(landmarks_path(sample_paths()[0]), tmp_path / "good.json")
    assert inspect(tmp_path / "good.ply", "--out", tmp_path / "out", "--units", "in") == 2
    line = capsys.readouterr().err
    assert "--units in: the wire would be" in line
    assert "Take --units away" in line
    assert "scan.units" not in line


def test_the_picture_says_what_to_do_to_whoever_sees_it(tmp_path, monkeypatch):
    """In words and units, and not to look at itself."""
    np.save(tmp_path / "body.npy", torsos.torso(40.0, right=40.0, n=30_000))
    shown: list[str] = []
    monkeypatch.setattr("brafit.report.figures.save_figure", lambda figure, *_, **__: shown.extend(words_of(figure)))
    assert inspect(tmp_path / "body.npy", "--out", tmp_path / "out", "--side", "left") == 0
    words = " ".join(" ".join(shown).split())
    assert "mark by hand what is wrong" in words.lower()
    assert "brafit-inspect" not in words
    assert re.search(r"points: 30,000 read, [\d,]+ added .*, [\d,]+ used; they scatter by 0\.\d\d mm", words)
    assert "_" not in words.replace("body_left", "")
    assert {"outwards, mm", "down along the chest, mm", "out of the chest, mm"} <= set(shown)


def words_of(figure: Figure) -> list[str]:
    """All texts of a figure, and the labels of its axes."""
    axes = [label for one in figure.axes for label in (one.get_xlabel(), one.get_ylabel())]
    return axes + [text.get_text() for one in figure.axes for text in one.texts]


def test_of_a_mesh_the_picture_says_what_was_read_and_what_was_sampled(tmp_path, monkeypatch):
    import trimesh

    cloud = read_cloud(sample_paths()[0])
    near = trimesh.Trimesh(cloud.points[::4], Delaunay(cloud.points[::4, :2]).simplices, process=False)
    near.export(tmp_path / "breast.obj")
    shutil.copy(landmarks_path(sample_paths()[0]), tmp_path / "breast.json")
    told = []
    monkeypatch.setattr(
        "brafit.report.inspection.inspection_figure", lambda *given: told.append(given[4]) or Figure(figsize=(1, 1))
    )
    assert inspect(tmp_path / "breast.obj", "--out", tmp_path / "out") == 0
    counts = f"{len(near.vertices):,} vertices and {len(near.faces):,} triangles"
    assert f"points: 200,000 sampled on a mesh of {counts}, " in told[0]
    assert " read" not in told[0]
    assert inspect(sample_paths()[0], "--out", tmp_path / "out") == 0
    assert f"points: {len(cloud.points):,} read, " in told[1]


def test_the_installed_module_runs(tmp_path):
    sample = sample_paths()[0]
    command = [sys.executable, "-m", "brafit.cli.inspect", str(sample), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / f"{sample.stem}.json").read_text())["side"] == "left"


def test_clouds_without_landmarks_are_named(tmp_path):
    sample = sample_paths()[0]
    shutil.copy(sample, tmp_path / "a.ply")
    shutil.copy(landmarks_path(sample), tmp_path / "a.json")
    assert passed_over(str(tmp_path)) == []
    shutil.copy(sample, tmp_path / "b.ply")
    assert passed_over([str(tmp_path), "samples"]) == [
        f"{tmp_path}: 1 cloud without landmark file passed over (b.ply): "
        f"mark them with brafit-mark {tmp_path}; for torsos brafit-inspect {tmp_path} --beside proposes landmarks"
    ]
