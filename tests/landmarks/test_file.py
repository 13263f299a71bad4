from __future__ import annotations

import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from breasts import cup_frame_landmarks, transformed, write_landmarks

from brafit.errors import InputError
from brafit.landmarks import landmarks_path, landmarks_text, read_breasts, read_landmarks
from brafit.landmarks.units import MILLIMETRES
from brafit.samples import sample_paths

SEE = "See brafit/landmarks/landmarks.schema.json for the format."
TRIPLE = "Give three finite numbers [x, y, z]."


def message(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_landmarks(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    return line.removeprefix(f"{path}: ")


def changed(folder: Path, **changes) -> Path:
    landmarks = {**cup_frame_landmarks(), **changes}
    return write_landmarks(folder / "a.json", {key: value for key, value in landmarks.items() if value is not None})


def test_all_fields_are_read(tmp_path):
    landmarks = cup_frame_landmarks()
    marks = read_landmarks(changed(tmp_path, name="Anna", frame="x = left", extra={"mid_shoulder": [1, 2, 3]}))
    assert (marks.name, marks.side) == ("Anna", "left")
    np.testing.assert_array_equal(marks.wire, landmarks["wire"])
    np.testing.assert_array_equal(marks.upper_line, landmarks["upper_line"])
    assert list(marks.points) == ["inner_end", "outer_end", "wire_bottom", "apex", "strap_point"]
    np.testing.assert_array_equal(marks.points["apex"], landmarks["landmarks"]["apex"])


def test_only_wire_and_side_are_required(tmp_path):
    marks = read_landmarks(changed(tmp_path, units=None, landmarks=None, upper_line=None))
    assert (marks.name, marks.points, marks.upper_line) == ("a", {}, None)


def test_repeated_wire_points_are_dropped(tmp_path):
    wire = [[0, 0, 0], [0, 0, 0], [1, 2, 0], [2, 3, 0], [2, 3, 0], [3, 3, 0]]
    read = read_landmarks(changed(tmp_path, wire=wire)).wire
    assert read is not None
    assert len(read) == 4


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"side": None}, 'side: missing. Add "side": "left" or "side": "right", the wearer\'s.'),
        (
            {"wire": None, "wires": []},
            "wire: missing; 'wires' looks like it. Rename 'wires' to 'wire', or remove it.",
        ),
        (
            {"upper_line": None, "Upper-Line": []},
            "upper_line: missing; 'Upper-Line' looks like it. Rename 'Upper-Line' to 'upper_line', or remove it.",
        ),
        (
            {"landmarks": {"apx": [1, 2, 3]}},
            "landmarks.apex: missing; 'apx' looks like it. Rename 'apx' to 'apex', or remove it.",
        ),
        (
            {"landmarks": {"bust_point": [1, 2, 3]}},
            "landmarks.apex: missing; 'bust_point' looks like it. Rename 'bust_point' to 'apex', or remove it.",
        ),
        (
            {"landmarks": {"Strap": {"x": 1, "y": 2, "z": 3}}},
            "landmarks.strap_point: missing; 'Strap' looks like it. Rename 'Strap' to 'strap_point', or remove it.",
        ),
        (
            {"upper_line": None, "neckline": [[1, 2, 3], [4, 5, 6], [7, 8, 9]]},
            "upper_line: missing; 'neckline' looks like it. Rename 'neckline' to 'upper_line', or remove it.",
        ),
        (
            {"landmarks": None, "points": {"apex": [1, 2, 3]}},
            "landmarks: missing; 'points' looks like it. Rename 'points' to 'landmarks', or remove it.",
        ),
        (
            {"landmarks": {}, "apex": [1, 2, 3]},
            "landmarks.apex: missing; 'apex' looks like it, but stands in the wrong place. "
            "Move it into landmarks, as 'apex', or remove it.",
        ),
        (
            {"landmarks": None, "bustApex": [1, 2, 3]},
            "landmarks.apex: missing; 'bustApex' looks like it, but stands in the wrong place. "
            "Move it into landmarks, as 'apex', or remove it.",
        ),
        (
            {"wire": None, "landmarks": {"wire": [[1, 2, 3], [4, 5, 6]]}},
            "wire: missing; 'landmarks.wire' looks like it, but stands in the wrong place. "
            "Move it to the top level of the file, as 'wire', or remove it.",
        ),
        ({"side": "links"}, 'side: "links" is neither "left" nor "right". Name the wearer\'s side.'),
        (
            {"units": "feet"},
            'units: "feet" is none of "mm", "cm", "in", "m". Write one of these, or leave it out.',
        ),
        ({"landmarks": {"apex": [1, 2]}}, f"landmarks.apex: 2 numbers, not 3. {TRIPLE}"),
        ({"landmarks": {"apex": [1, "2", 3]}}, f'landmarks.apex: "2" is not a number. {TRIPLE}'),
        ({"landmarks": {"apex": [1, True, 3]}}, f"landmarks.apex: true is not a number. {TRIPLE}"),
        ({"landmarks": {"apex": [1, float("nan"), 3]}}, f"landmarks.apex: NaN is not finite. {TRIPLE}"),
        ({"landmarks": {"apex": {"x": 1}}}, f"landmarks.apex: an object, not a point. {TRIPLE}"),
        (
            {"landmarks": [[1, 2, 3]]},
            f'landmarks: a list, not an object with named points. Write {{"apex": [x, y, z], ...}}. {SEE}',
        ),
        (
            {"wire": [[0, 0, 0], [100, 0, 0]]},
            "wire: 2 distinct points, at least 4 are needed. "
            "Trace the line with 4 points or more, from end to end (20 to 50 are good).",
        ),
        (
            {"wire": [[0, 0, 0], [1, 0, 0]] * 4},
            "wire: 2 distinct points, at least 4 are needed. "
            "Trace the line with 4 points or more, from end to end (20 to 50 are good).",
        ),
        ({"wire": [[0, 0, 0], [1, float("inf"), 0]]}, f"wire[1]: Infinity is not finite. {TRIPLE}"),
        ({"wire": [[0, 0, 0], [1, 1e308, 0]]}, f"wire[1]: 1e+308 is no place on a body in any unit. {TRIPLE}"),
        ({"wire": "bow"}, f"wire: a text, not a list of points. Write [[x, y, z], ...]. {SEE}"),
        ({"name": 7}, "name: 7 is not a text. Give the scan's name in quotes, or leave it out."),
    ],
)
def test_a_bad_field_is_named(tmp_path, changes, expected):
    assert message(changed(tmp_path, **changes)) == expected


def test_a_field_in_the_wrong_place_of_two_breasts(tmp_path):
    left = {key: value for key, value in cup_frame_landmarks().items() if key != "units"}
    path, right = tmp_path / "a.json", {**left, "side": "right"}
    bare = {**right, "landmarks": {}, "apex": [1, 2, 3]}
    write_landmarks(path, {"breasts": [left, bare]})
    assert message(path).endswith("Move it into breasts[1].landmarks, as 'apex', or remove it.")
    write_landmarks(path, {"breasts": [left, {**right, "units": "cm"}]})
    assert message(path).startswith("units: missing; 'breasts[1].units' looks like it")
    points = dict(left["landmarks"])
    apex = points.pop("apex")
    write_landmarks(path, {"apex": apex, "breasts": [{**left, "landmarks": points}]})
    assert message(path).startswith("breasts[...].landmarks.apex: missing; 'apex' looks like it")


@pytest.mark.parametrize(
    "kept",
    [
        {"bust": 92, "points": 5000, "strap": "elastic", "neckline": "plunge", "bottom": 3.5, "crease": [1, 2, 3]},
        {"bust_point": [1, 2, 3], "Underwire": [[1, 2, 3], [4, 5, 6]], "apex_left": [1, 2, 3]},
        {"extra": {"apex": [1, 2, 3]}, "mid_shoulder": [1, 2, 3], "measures": {"bust": 92}, "frame": "x = left"},
        {"apex": [1, 2, 3], "bust": [1, 2, 3]},
    ],
)
def test_what_people_keep_for_themselves_is_ignored(tmp_path, kept):
    """Beside a file that has all its fields, and under names that would be a landmark's if they held one."""
    plain, given = read_landmarks(changed(tmp_path)), read_landmarks(changed(tmp_path, **kept))
    assert given.points.keys() == plain.points.keys()
    np.testing.assert_array_equal(given.positions(), plain.positions())
    numbers = {"bust_point": 92, "strap": "elastic", "points": 5000, "nipple": [1, 2]}
    bare = read_landmarks(changed(tmp_path, upper_line=None, landmarks=None, neckline="plunge", **numbers))
    assert (bare.points, bare.upper_line) == ({}, None)
    twice = changed(tmp_path, landmarks={"apex": [1, 2, 3], "bust_point": [1, 2, 3]})  # not meant for strap_point
    assert list(read_landmarks(twice).points) == ["apex"]


def test_a_file_that_is_no_landmark_file(tmp_path):
    path = tmp_path / "a.json"
    assert message(path) == f"there is no such landmark file. Write it beside the cloud. {SEE}"
    path.write_text('{"side": "left",\n "wire" [[1, 2, 3]]}')
    assert message(path) == (
        "is not valid JSON (line 2, column 9: Expecting ':' delimiter). Correct the file at that place."
    )
    path.write_text("[1, 2]")
    assert message(path) == f"holds a list, not an object with named fields. {SEE}"
    path.write_bytes(b"\xff\xfe\x00\x01\x80")
    assert message(path) == "is no text in UTF-16. Save it as JSON in UTF-8."
    path.write_text('{"side": "left", "name": "Größe"}', encoding="latin-1")
    assert message(path) == "is no text in UTF-8. Save it as JSON in UTF-8."
    path.write_text("[" * 100_000)
    assert message(path) == f"is not a JSON text file. Write the landmarks as JSON. {SEE}"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_the_encoding_is_found(tmp_path, encoding):
    path = changed(tmp_path, name="Größe")
    text = path.read_text(encoding="utf-8")
    expected = read_landmarks(path)
    path.write_text(text, encoding=encoding)
    assert read_landmarks(path).name == expected.name


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ('{"side": "right", "side": "left"}', "side"),
        ('{"side": "left", "landmarks": {"apex": [1, 2, 3], "apex": [1, 2, 4]}}', "apex"),
    ],
)
def test_a_field_that_stands_twice_is_refused(tmp_path, text, field):
    """JSON lets the last one count, without a word."""
    path = tmp_path / "a.json"
    path.write_text(text)
    assert message(path).startswith(f"{field}: written twice in one place")


def test_samples_agree_with_the_schema():
    jsonschema = pytest.importorskip("jsonschema")
    text = resources.files("brafit.landmarks").joinpath("landmarks.schema.json").read_text(encoding="utf-8")
    validator = jsonschema.Draft202012Validator(json.loads(text))
    for cloud in sample_paths():
        validator.validate(json.loads(landmarks_path(cloud).read_text(encoding="utf-8")))
    assert not validator.is_valid({"side": "left", "wire": [[0, 0, 0], [100, 0, 0]]})
    assert not validator.is_valid({"side": "left", "units": "feet", "wire": [[0, 0, 0]] * 4})


def test_both_breasts_of_a_file(tmp_path):
    left = {key: value for key, value in cup_frame_landmarks().items() if key != "units"}
    path = tmp_path / "a.json"
    write_landmarks(path, {"units": "cm", "breasts": [left, {**left, "side": "right", "wire": None}]})
    assert [(marks.side, marks.units, marks.wire is None) for marks in read_breasts(path)] == [
        ("left", "cm", False),
        ("right", "cm", True),
    ]
    assert read_landmarks(path, "right").side == "right"
    again = tmp_path / "b.json"
    again.write_text(landmarks_text(read_breasts(path)))
    for first, second in zip(read_breasts(path), read_breasts(again), strict=True):
        assert (first.side, first.units) == (second.side, second.units)
        np.testing.assert_allclose(second.positions(), first.positions(), atol=1e-3)
    write_landmarks(path, {"breasts": [left, left]})
    assert message(path) == "breasts: the left one twice. Give each side once."
    write_landmarks(path, {"side": "left", "breasts": [left]})
    assert message(path) == "side: stands beside breasts, but belongs into it. Write it in each of breasts."


@pytest.mark.parametrize("unit", MILLIMETRES)
def test_what_is_written_is_exact_in_every_unit(tmp_path, unit: str):
    given = cup_frame_landmarks()
    path, factor = tmp_path / "a.json", MILLIMETRES[unit]
    write_landmarks(path, transformed({**given, "units": unit}, lambda places: np.asarray(places) / factor))
    exact = read_landmarks(path)
    path.write_text(landmarks_text([exact]))
    off = factor * np.abs(read_landmarks(path).positions() - exact.positions())
    assert off.max() < 0.002
