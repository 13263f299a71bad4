"""brafit-mark writes a page for every scan that can be read, and says what is wrong with the others."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from analytic_torso import torso_marks, torso_points, write_torso

from brafit.cli.mark import main, page_names
from brafit.geometry.polyline import polyline_length
from brafit.landmarks import landmarks_path, read_landmarks
from brafit.landmarks.plausibility import WIRE_LENGTH
from brafit.samples import sample_paths
from brafit.underwires.nearest import nearest_wire


def mark(*arguments) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def told(page: Path) -> dict:
    found = re.search(r'<script type="application/json" id="scan-data">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def sample(folder: Path, name: str) -> Path:
    source, path = sample_paths()[0], folder / f"{name}.ply"
    shutil.copy(source, path)
    shutil.copy(landmarks_path(source), landmarks_path(path))
    return path


def test_a_page_holds_the_marks_of_the_file_and_needs_nothing_else(tmp_path, capsys):
    path = sample(tmp_path, "Brüst <1>")
    assert mark(path, "--out", tmp_path / "out") == 0
    assert capsys.readouterr().out.strip() == (
        f"1 of 1 scans can be marked: open {tmp_path / 'out' / 'index.html'} in a browser"
    )
    page = tmp_path / "out" / "Brüst <1>.html"
    assert page.stat().st_size < 6e6
    text = page.read_text()
    assert not re.search(r"(src|href)=[\"'](?!index\.html)", text)
    data, marks = told(page), read_landmarks(landmarks_path(path))
    assert marks.wire is not None
    np.testing.assert_allclose(np.array(data["breasts"][0]["wire"]) + data["origin"], marks.wire, atol=1e-3)
    assert data["file"] == "Brüst <1>.json"
    assert data["bounds"]["wirePossible"] == list(WIRE_LENGTH)
    assert data["sides"] == ["left"]
    assert data["mirror"] is None
    index = (tmp_path / "out" / "index.html").read_text()
    assert 'href="Br%C3%BCst%20%3C1%3E.html"' in index
    assert 'data-state="done"' in index


def test_the_catalogue_is_the_one_of_the_nearest_wire(tmp_path):
    path = sample(tmp_path, "a")
    assert mark(path, "--out", tmp_path) == 0
    wire = read_landmarks(landmarks_path(path)).wire
    assert wire is not None
    length, span = polyline_length(wire), float(np.linalg.norm(wire[-1] - wire[0]))
    near = min(told(tmp_path / "a.html")["catalogue"], key=lambda w: np.hypot(w["length"] - length, w["span"] - span))
    assert near["name"] == nearest_wire(wire).wire.name


def test_bad_scans_cost_themselves_alone(tmp_path, capsys):
    sample(tmp_path, "good")
    sample(tmp_path, "worse")
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat")
    (tmp_path / "worse.json").write_text('{"side": "left", "wire": [[0, 0')
    out = tmp_path / "out"
    assert mark(tmp_path, "--out", out) == 1
    said = capsys.readouterr()
    lines = said.err.strip().splitlines()
    assert [line.split(": ")[:2] for line in lines] == [
        ["failed", str(tmp_path / "broken.ply")],
        ["failed", str(tmp_path / "worse.json")],
    ]
    assert "1 of 3 scans" in said.out
    assert sorted(path.name for path in out.iterdir()) == ["good.html", "index.html"]
    index = (out / "index.html").read_text()
    assert index.count('class="failed"') == 2
    assert '<b id="done">1</b> of 1 done; 2 more cannot be marked: the table says why' in index
    assert mark(tmp_path / "broken.ply", "--out", out) == 2
    index = (out / "index.html").read_text()
    assert "The scan cannot be marked: the table says why." in index
    assert 'id="done"' not in index
    assert mark(tmp_path / "none.ply", "--out", out) == 2


def test_names_do_not_clash():
    paths = [Path(name) for name in ("a/index.ply", "b/scan.ply", "c/scan.ply", "d/Index.ply")]
    names = page_names(paths)
    assert len({name.casefold() for name in names}) == 4
    assert "index" not in {name.casefold() for name in names}


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("m", 1000.0)])
def test_a_torso_says_unit_mirror_and_axes(tmp_path, unit: str, factor: float):
    path = tmp_path / "torso.npy"
    write_torso(path, torso_points(12_000), torso_marks(path, "right", unit), unit)
    assert mark(path, "--out", tmp_path) == 0
    data = told(tmp_path / "torso.html")
    assert (data["unit"], data["factor"], data["sides"], data["side"]) == (unit, factor, ["left", "right"], "right")
    np.testing.assert_allclose(data["axes"], np.eye(3), atol=0.02)
    middle = data["mirror"]["offset"] + np.dot(data["mirror"]["normal"], data["origin"])
    assert abs(middle) < 1
    assert abs(data["mirror"]["normal"][0]) > 0.9999


def test_what_cannot_be_proposed_is_marked_by_hand(tmp_path, capsys):
    shutil.copy(sample_paths()[0], tmp_path / "alone.ply")
    assert mark(tmp_path / "alone.ply", "--out", tmp_path, "--side", "right") == 0
    data = told(tmp_path / "alone.html")
    assert data["breasts"] == []
    assert data["sides"] == ["right"]
    assert "no whole torso" in data["notes"][0]
    # From in front: a breast bulges towards the viewer.
    assert data["axes"][2][2] > 0.7
    assert "nothing is marked" in (tmp_path / "index.html").read_text()
    assert capsys.readouterr().err == ""


def test_what_else_a_landmark_file_says_is_kept_but_no_settings_are_taken(tmp_path, capsys):
    path = sample(tmp_path, "a")
    file = landmarks_path(path)
    file.write_text(json.dumps({**json.loads(file.read_text()), "fitter": "Ann", "shoulder": float("nan")}))
    assert mark(path, "--out", tmp_path) == 0
    extra = told(tmp_path / "a.html")["extra"]
    assert (extra["fitter"], extra["shoulder"]) == ("Ann", None)
    assert mark(path, "cup.terms=4") == 2
    assert "takes no settings" in capsys.readouterr().err


@pytest.mark.parametrize("points", [np.zeros((500, 3)), np.repeat(torso_points(40), 20, axis=0)])
def test_a_cloud_of_hardly_any_points_is_refused(tmp_path, capsys, points: np.ndarray):
    np.save(tmp_path / "few.npy", points)
    assert mark(tmp_path / "few.npy", "--out", tmp_path, "--units", "mm") == 2
    assert "points are distinct. Export the cloud again" in capsys.readouterr().err


@pytest.mark.parametrize("unit", ["in", "m"])
def test_a_unit_in_which_a_scan_is_no_body_is_refused_with_the_likely_one(tmp_path, capsys, unit):
    path = tmp_path / "a.ply"
    shutil.copy(sample_paths()[0], path)
    assert mark(path, "--out", tmp_path / "out", "--units", unit) == 2
    error = capsys.readouterr().err
    assert "in millimetres it would be 0.2" in error
    assert "--units mm" in error
    assert "Traceback" not in error


def test_a_stray_point_far_away_says_nothing_of_the_unit(tmp_path):
    points = np.vstack((torso_points(3000), (1e6, 0.0, 0.0)))
    np.save(tmp_path / "stray.npy", points)
    assert mark(tmp_path / "stray.npy", "--out", tmp_path, "--units", "mm") == 0


def test_a_plane_is_a_scan_like_another(tmp_path):
    points = np.random.default_rng(0).uniform(0, 250, (3000, 3)) * [1.0, 1.0, 0.0]
    np.save(tmp_path / "plane.npy", points)
    assert mark(tmp_path / "plane.npy", "--out", tmp_path, "--units", "mm") == 0
    assert abs(told(tmp_path / "plane.html")["axes"][2][2]) > 0.999
