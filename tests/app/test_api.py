"""`brafit.fit` on scans, files and arrays."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lunes import RADIUS, sphere_points

import brafit
from brafit.cloud import read_cloud
from brafit.cloud.ply import cloud_ply
from brafit.errors import ConfigError, InputError
from brafit.landmarks import landmarks_text, read_landmarks
from brafit.result import Result
from brafit.samples import sample_paths
from brafit.scan import load_scan

ANGLE = np.linspace(0, np.pi, 40)
WIRE = RADIUS * np.stack((np.sin(ANGLE), 1 - np.cos(ANGLE), 0 * ANGLE), -1)
BALL = sphere_points(400)[0]
TURN = np.array(((0, 0, 1), (1, 0, 0), (0, 1, 0)), float)
QUICK = [
    "cup=frames", "solver=anneal", "cup.terms=4", "cup.stations=51", "restarts=1",
    "solver.stages=[{optimiser:adam,steps:60,penalty:1.0},{optimiser:lbfgs,steps:150,penalty:100.0}]",
]  # fmt: skip


def placed(points: np.ndarray) -> np.ndarray:
    """Somewhere in a scanner's frame."""
    return points @ TURN.T + (100, -30, 900)


@pytest.fixture(scope="module")
def fitted() -> Result:
    points, _ = sphere_points(400)
    return brafit.fit(
        placed(points),
        wire=placed(WIRE),
        strap_point=placed(np.array((0, RADIUS, RADIUS))),
        settings=QUICK,
        name="ball",
    )


def test_distances_and_surface_are_in_the_frame_of_the_points(fitted: Result) -> None:
    distances = fitted.distance(fitted.frame.to_scan(fitted.target.points))
    np.testing.assert_allclose(distances, fitted.fit.distances, atol=1e-9)
    assert np.sqrt(np.mean(distances**2)) < 0.08 * RADIUS
    far = placed(np.array([[2 * RADIUS, RADIUS, 2 * RADIUS]]))
    assert fitted.distance(far)[0] > RADIUS
    meshes = fitted.surface(strips=3)
    assert [mesh.name for mesh in meshes] == ["lower panel", "upper panel"]
    ends = placed(WIRE[[0, -1]])
    vertices = np.vstack([mesh.vertices for mesh in meshes])
    assert max(np.linalg.norm(vertices - end, axis=1).min() for end in ends) < 1.0
    # on the surface, and its vertex normals point away from the sphere's middle
    assert np.abs(fitted.distance(vertices)).max() < 0.2
    middle = placed(np.array((0, RADIUS, 0)))
    assert np.mean([(mesh.normals * (mesh.vertices - middle)).sum(1) > 0 for mesh in meshes]) > 0.9


def test_patterns_and_files(fitted: Result, tmp_path: Path) -> None:
    pattern = fitted.patterns()
    assert [piece.name for piece in pattern.pieces] == ["lower panel", "upper panel"]
    assert pattern.pieces[0].sew[0].length == pytest.approx(np.pi * RADIUS, abs=1.5)
    fitted.save(tmp_path)
    names = {file.name for file in tmp_path.iterdir()}
    patterns = {"patterns.svg", "patterns.dxf", "patterns.pdf", "patterns_sheet.pdf"}
    assert names == patterns | {
        "cup.ply",
        "cup.obj",
        "stitches.json",
        "cup.glb",
        "points.ply",
        "report.html",
        "thumbnail.png",
        "fit.json",
    }
    fit = json.loads((tmp_path / "fit.json").read_text())
    assert fit["scan"] == "ball"
    assert fit["sources"]["apex"].startswith("not given")
    notches = {
        name: [(n["edge"], n["from_inner_end"]) for n in each] for name, each in fit["pattern"]["notches_mm"].items()
    }
    ridge = [[place for edge, place in each if edge == "seam"] for each in notches.values()]
    assert ridge[0] == ridge[1]


def test_right_breasts_are_mirror_images() -> None:
    points, _ = sphere_points(200)
    mirror = np.array((1.0, 1.0, -1.0))
    short = [*QUICK[:-1], "solver.stages=[{optimiser:adam,steps:20,penalty:1.0}]"]
    left = brafit.fit(placed(points), wire=placed(WIRE), settings=short)
    right = brafit.fit(placed(points) * mirror, wire=placed(WIRE) * mirror, side="right", settings=short)
    for a, b in zip(left.surface(), right.surface(), strict=True):
        np.testing.assert_allclose(a.vertices * mirror, b.vertices, atol=1e-6)
    for a, b in zip(left.patterns().pieces, right.patterns().pieces, strict=True):
        np.testing.assert_allclose(a.sew_outline() * (-1, 1), b.sew_outline(), atol=1e-4)


def test_settings_are_the_commands() -> None:
    with pytest.raises(ConfigError, match=r"did you mean cup\.panels"):
        brafit.fit(np.zeros((20, 3)), wire=WIRE, settings=["cup.pannels=3"])
    with pytest.raises(ConfigError, match=r"pattern\.allowance\.wire=-1.*: must be"):
        brafit.fit(np.ones((20, 3)), wire=WIRE, settings=["pattern.allowance.wire=-1"])
    for wrong in ({"cup.panels": 3}, [("cup.panels", 3)], 3):
        with pytest.raises(ConfigError, match=r"settings: must be a list of key=value, such as \["):
            brafit.fit(np.ones((20, 3)), wire=WIRE, settings=wrong)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("points", "wire", "side", "words"),
    [
        (np.zeros((5, 2)), WIRE, "left", "points.*shape"),
        (np.full((5, 3), np.nan), WIRE, "left", "points.*finite"),
        ([["a", "b", "c"]], WIRE, "left", "points.*numbers"),
        (np.ones((500, 3)), WIRE, "left", "points.*fewer than 100 distinct"),
        (BALL, WIRE[:2], "left", "wire.*fewer than 4"),
        (BALL, None, "left", "wire: is not given"),
        (BALL, WIRE, "middle", "side"),
        (
            BALL / 25.4,
            WIRE / 25.4,
            "left",
            r"wire: \d\.\d+ mm long.*Give points and marks in mill.*scan\.units=in",
        ),
        (
            BALL + np.array((0, 0, 500)),
            WIRE,
            "left",
            r"landmarks: wire: nowhere near the cloud, \d{3} mm away from it\. Give points and marks in one frame",
        ),
        (
            BALL / 1000,
            WIRE,
            "left",
            r"points: the whole cloud is only 0\.\d+ mm across, its wire is 2\d\d mm long\. "
            r"Give points and marks in one frame and one unit\.$",
        ),
        (BALL.T, WIRE, "left", r"points: has the shape \(3, \d+\): a point a column\. Give it transposed"),
        (BALL, WIRE.T, "left", r"wire: has the shape \(3, \d+\): a point a column\. Give it transposed"),
        (BALL + 0j, WIRE, "left", r"points: has complex numbers\. Give an array of shape \(n, 3\)"),
        (np.ma.masked_less(BALL, 1), WIRE, "left", r"points: has numbers that are not finite\. Leave"),
        (
            torch.from_numpy(BALL).requires_grad_(),
            WIRE,
            "left",
            r"points: is a tensor with derivatives, .*\.detach\(\)",
        ),
        (BALL, WIRE, "right", "runs the wrong way round.*give brafit.fit the scan"),
    ],
)
def test_wrong_arrays_are_refused_in_one_line(points, wire, side: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        brafit.fit(points, wire=wire, side=side)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"apex": [1, 2]}, r"apex: is \[1, 2\], not three finite numbers\. Give an array of shape \(3,\)"),
        ({"apex": [np.nan] * 3}, "apex: is .nan, nan, nan., not three finite numbers"),
        ({"strap_point": "apex"}, "strap_point: is no array of numbers"),
        ({"inside": np.full(len(BALL), np.nan)}, "inside: has entries that are neither true nor false"),
        ({"inside": [True] * 5}, "inside: has 5 entries for"),
        ({"name": 5}, 'name: 5 is no text. Give a text: name="5"'),
    ],
)
def test_what_is_given_beside_points_is_refused_in_one_line(changes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        brafit.fit(BALL, wire=WIRE, **changes)


def test_points_may_be_any_kind_of_array() -> None:
    """In whatever order of bytes, precision, or library."""
    expected = load_points(BALL)
    single = BALL.astype(np.float32)
    for points in (BALL.tolist(), np.asfortranarray(BALL), BALL.astype(">f8"), BALL.astype(object), torch.tensor(BALL)):
        np.testing.assert_array_equal(load_points(points), expected)
    np.testing.assert_array_equal(load_points(torch.tensor(single)), load_points(single.astype(float)))
    fixed = BALL.copy()
    fixed.flags.writeable = False
    np.testing.assert_array_equal(load_points(fixed), expected)


def load_points(points) -> np.ndarray:
    """What becomes of points before they are fitted."""
    from brafit.api import _scan_of

    none = dict.fromkeys(("neckline", "strap_point", "apex", "inside"))
    return _scan_of(points, {"wire": WIRE, **none}, "left", "cup", {"points": 300}).points


def test_a_folder_is_no_cloud(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is a folder, and brafit\.fit takes one cloud\. Name one of its files"):
        brafit.fit(tmp_path)


def test_a_folder_that_cannot_be_made_is_refused_in_one_line(fitted: Result, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=r"file/out: this folder cannot be made \(Not a dir.*\. Save to"):
        fitted.save(tmp_path / "file" / "out")


def test_inches_are_taken_where_they_are_said() -> None:
    result = brafit.fit(BALL / 25.4, wire=WIRE / 25.4, settings=["experiment=quick", "scan.units=in"])
    assert result.figures["wire_length_mm"] == pytest.approx(np.pi * RADIUS, abs=1.5)


def test_a_scan_has_marks_of_its_own() -> None:
    path = sample_paths()[0]
    with pytest.raises(InputError, match=r"wire: given beside a file\. A file has its own"):
        brafit.fit(path, wire=WIRE)
    with pytest.raises(InputError, match=r"side: given beside a scan\."):
        brafit.fit(load_scan(path), side="left")
    with pytest.raises(InputError, match=r"scan\.points: given beside a scan\."):
        brafit.fit(load_scan(path), settings="scan.points=500")


def mirrored(path: Path, folder: Path) -> Path:
    """The mirror image of a sample, so a right breast."""
    cloud, marks = read_cloud(path), read_landmarks(path.with_suffix(".json"))
    flip = np.array((-1.0, 1.0, 1.0))
    other = folder / f"{path.stem}_right.ply"
    other.write_bytes(cloud_ply(cloud.points * flip, inside=cloud.inside))
    right = marks.mapped(lambda p: p * flip, side="right", units="mm")
    other.with_suffix(".json").write_text(landmarks_text([right]))
    return other


def test_numbers_and_files_are_the_commands_for_left_and_right(tmp_path: Path) -> None:
    paths = [*sample_paths()[:2], *(mirrored(path, tmp_path) for path in sample_paths()[:2])]
    listed = ",".join(map(str, paths))
    command = [sys.executable, "-m", "brafit", f"scans=[{listed}]", "experiment=lean", f"out={tmp_path / 'out'}"]
    subprocess.run(command, check=True, capture_output=True)
    for number, path in enumerate(paths):
        cloud, marks = read_cloud(path), read_landmarks(path.with_suffix(".json"))
        arrays: dict[str, Any] = {name: marks.points.get(name) for name in ("strap_point", "apex")}
        arrays |= {"wire": marks.wire, "neckline": marks.upper_line, "inside": cloud.inside, "side": marks.side}
        arrays["name"] = path.stem
        by_command = tmp_path / "out" / path.stem
        # a file and a Scan by turns: left and right of each
        loaded = path if number in (0, 3) else load_scan(path)
        inputs: list[tuple[Any, dict[str, Any]]] = [(loaded, {}), (cloud.points, arrays)]
        for given, named in inputs:
            folder = tmp_path / f"{path.stem}_{type(given).__name__}"
            brafit.fit(given, settings=["experiment=lean"], **named).save(folder)
            own, other = (json.loads((where / "fit.json").read_text()) for where in (folder, by_command))
            # how long it took, what files it was and what was found out about their unit are not the same
            told_apart = {"seconds", "sources", "settings"} | ({"units", "notes", "note_codes"} if named else set())
            assert [key for key in own.keys() - told_apart if not same(own[key], other[key])] == []
            lines = [(where / "patterns.dxf").read_text().split("\n") for where in (folder, by_command)]
            assert same(*lines)


def same(one: Any, other: Any) -> bool:
    """Equal but for the last digits, which the company in a batch may change."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    try:
        return math.isclose(float(one), float(other), rel_tol=1e-6, abs_tol=2e-4)
    except (TypeError, ValueError):
        return one == other


def test_the_library_is_a_package_whose_fit_is_a_function() -> None:
    program = (
        "import brafit, inspect, sys; assert 'torch' not in sys.modules; "
        "assert inspect.isfunction(brafit.fit) and 'torch' not in sys.modules; "
        "import brafit.fitting.loop; from brafit import fit; assert fit is brafit.fit and inspect.isfunction(fit)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
