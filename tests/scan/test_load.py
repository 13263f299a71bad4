from __future__ import annotations

import json
import re

import numpy as np
import pytest
from breasts import (
    RADIUS,
    cup_frame_landmarks,
    cup_frame_points,
    rotation,
    transformed,
    write_breast,
    write_landmarks,
    write_ply,
)

from brafit.errors import ConfigError, InputError
from brafit.landmarks import landmarks_path
from brafit.samples import sample_paths
from brafit.scan import load_scan

TOGETHER = "Check that the landmark file belongs to breast.ply and is in the same frame."


def message(path, file=None) -> str:
    """The one line of the error, which names `file` (the cloud if None)."""
    with pytest.raises(InputError) as caught:
        load_scan(path)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{file or path}: ")
    return line.removeprefix(f"{file or path}: ")


def present(position: np.ndarray | None) -> np.ndarray:
    assert position is not None
    return position


def write_posed(folder, name, function, side="left", inside=None):
    landmarks = transformed({**cup_frame_landmarks(), "side": side}, function)
    write_landmarks(folder / f"{name}.json", landmarks)
    return write_ply(folder / f"{name}.ply", function(cup_frame_points()), inside)


def test_a_breast_comes_back_in_the_cup_frame(tmp_path):
    path = write_posed(tmp_path, "a", lambda p: p @ rotation(3).T + [100, 1300, 50])
    scan = load_scan(path, points=None, outliers=None)
    expected = cup_frame_points()
    expected = expected[np.lexsort(expected.T[::-1])]
    np.testing.assert_allclose(scan.points[np.lexsort(scan.points.T[::-1])], expected, atol=1e-9)
    truth = cup_frame_landmarks()
    np.testing.assert_allclose(scan.wire, truth["wire"], atol=1e-9)
    np.testing.assert_allclose(present(scan.neckline), truth["upper_line"], atol=1e-9)
    np.testing.assert_allclose(present(scan.strap_point), [0, RADIUS, RADIUS], atol=1e-9)
    np.testing.assert_allclose(present(scan.apex), truth["landmarks"]["apex"], atol=1e-9)
    assert (scan.name, scan.path, scan.side) == ("a", path, "left")


def test_a_mirrored_right_breast_is_the_same_in_the_cup_frame(tmp_path):
    inside = cup_frame_points()[:, 2] > 10
    scans = []
    for side in ("left", "right"):
        mirror = np.array([1.0 if side == "left" else -1.0, 1, 1])
        path = write_posed(tmp_path, side, lambda p, m=mirror: (p @ rotation(5).T + [80, 1300, 90]) * m, side, inside)
        scans.append(load_scan(path, points=500))
    left, right = scans
    np.testing.assert_allclose(right.points, left.points, atol=1e-9)
    np.testing.assert_allclose(right.wire, left.wire, atol=1e-9)
    np.testing.assert_allclose(present(right.neckline), present(left.neckline), atol=1e-9)
    assert right.cleaning.used == left.cleaning.used == 500
    assert (left.frame.mirrored, right.frame.mirrored) == (False, True)
    np.testing.assert_allclose(right.frame.to_scan(right.points)[:, 0], -left.frame.to_scan(left.points)[:, 0])


def test_wire_and_neckline_may_be_given_from_the_outer_end(tmp_path):
    truth = cup_frame_landmarks()
    path = write_breast(tmp_path, wire=truth["wire"][::-1], upper_line=truth["upper_line"][::-1])
    scan = load_scan(path)
    np.testing.assert_allclose(scan.wire, truth["wire"], atol=1e-9)
    np.testing.assert_allclose(present(scan.neckline), truth["upper_line"], atol=1e-9)


def test_the_least_landmark_file(tmp_path):
    scan = load_scan(write_breast(tmp_path, landmarks=None, upper_line=None, units=None), points=300, name="Anna")
    assert (scan.name, scan.neckline, scan.strap_point, scan.apex) == ("Anna", None, None, None)
    assert scan.points[:, 2].min() > 0
    assert len(scan.points) == 300


@pytest.mark.parametrize("path", sample_paths(), ids=lambda path: path.stem)
def test_the_samples_load(path, capfd):
    scan = load_scan(path)
    assert scan.points.shape == (2000, 3)
    np.testing.assert_allclose(scan.wire[0], 0, atol=1e-9)
    np.testing.assert_allclose(scan.wire[-1, [0, 2]], 0, atol=1e-9)
    assert scan.wire[:, 0].max() > 40
    assert 35 < present(scan.apex)[2] < 90
    assert 0 < present(scan.strap_point)[1] < scan.wire[-1, 1]
    assert path.stat().st_size < 150_000
    assert "CC0" in landmarks_path(path).read_text(encoding="utf-8")
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""


def test_missing_cloud_and_missing_landmark_file(tmp_path):
    path = write_breast(tmp_path)
    landmarks_path(path).unlink()
    assert message(path) == (
        "no landmark file breast.json beside the cloud. "
        "Write breast.json (by hand on a page of brafit-mark), or set scan.propose=true."
    )
    path.unlink()
    assert message(path) == "there is no such file. Check the path."


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"wire": None, "landmarks": None},
            "wire: its place is not given, and without inner_end, outer_end, apex, strap_point it is found on a whole "
            "torso only. "
            "Give wire, or landmarks inner_end, outer_end, apex and strap_point; or scan the whole torso.",
        ),
        (
            {"landmarks": {"apx": [45, 65, 45]}},
            "landmarks.apex: missing; 'apx' looks like it. Rename 'apx' to 'apex', or remove it.",
        ),
        (
            {"wire": [[0, 0, 0], [0, 130, 0]]},
            "wire: 2 distinct points, at least 4 are needed. "
            "Trace the line with 4 points or more, from end to end (20 to 50 are good).",
        ),
        (
            {"wire": cup_frame_landmarks()["wire"] / 1000},
            "wire: 0.2041 mm long, it must be 80 to 600 mm. "
            'It looks like metres: write "units": "m", or set scan.units=m, if the cloud is in metres too; '
            'take "units" out of breast.json, and scan.units off the command, if only the landmarks are.',
        ),
        (
            {"wire": cup_frame_landmarks()["wire"] * 10},
            "wire: 2041 mm long, it must be 80 to 600 mm. "
            "Check the unit, and that the points are in order from the inner to the outer end.",
        ),
        (
            {"wire": cup_frame_landmarks()["wire"] + [0, 0, -400], "landmarks": None},
            f"wire: nowhere near the cloud, 400 mm away from it. {TOGETHER}",
        ),
        (
            {"upper_line": cup_frame_landmarks()["upper_line"] + [0, 0, 400]},
            f"upper_line: nowhere near the cloud, 383 mm away from it. {TOGETHER}",
        ),
        (
            {"landmarks": {"apex": [65, 65, 300]}},
            f"landmarks.apex: 242 mm away from the cloud. {TOGETHER}",
        ),
        (
            {"landmarks": {"outer_end": [0, 118, 0]}},
            "landmarks.outer_end: 12.0 mm from the outer end of the wire. "
            "Both mark the same point: bring them within 5 mm.",
        ),
        (
            {"upper_line": cup_frame_landmarks()["upper_line"][:-4]},
            "upper_line: its ends are up to 27.0 mm from the ends of the wire. "
            "Let it start and end at the wire's ends (within 5 mm).",
        ),
        (
            {"side": "right"},
            "side: for a right breast the wire runs the wrong way round, its bottom would be above its ends. "
            'The side is probably wrong: write "left", or exchange inner_end and outer_end, if they are swapped '
            "(the inner end is the one towards the other breast).",
        ),
    ],
)
def test_a_landmark_file_that_cannot_be_used(tmp_path, changes, expected):
    path = write_breast(tmp_path, **changes)
    assert message(path, landmarks_path(path)) == expected


@pytest.mark.parametrize(("factor", "unit"), [(1000, "m"), (10, "cm"), (25.4, "in")])
def test_units_are_found_and_said(tmp_path, factor, unit):
    expected = load_scan(write_breast(tmp_path / "mm"), points=300)
    assert expected.notes == ()
    path = write_breast(tmp_path / "cloud")
    write_ply(path, cup_frame_points() / factor)
    with pytest.raises(InputError, match=r"the cloud is in .*, its landmark file .* says units 'mm'. Export the cloud"):
        load_scan(path, points=300)
    silent = {key: value for key, value in cup_frame_landmarks().items() if key != "units"}
    write_landmarks(landmarks_path(path), silent)
    alone = load_scan(path, points=300)
    assert (alone.units.cloud, alone.units.marks) == (unit, "mm")
    both = write_posed(tmp_path, "both", lambda p: p / factor)
    marks = {**transformed(cup_frame_landmarks(), lambda p: p / factor), "units": None}
    write_landmarks(landmarks_path(both), {key: value for key, value in marks.items() if value is not None})
    found = load_scan(both, points=300)
    assert (found.units.cloud, found.units.marks) == (unit, unit)
    for scan in (alone, found):
        assert scan.notes[0].code == "units"
        assert "found from" in str(scan.notes[0])
        np.testing.assert_allclose(scan.points, expected.points, atol=1e-6)
        np.testing.assert_allclose(scan.wire, expected.wire, atol=1e-9)
    said = load_scan(both, points=300, units=unit)
    assert (said.units.found, said.notes) == ("", ())


def test_a_unit_in_a_header_is_taken(tmp_path):
    """It serves where nothing else says it, and must not contradict the landmark file or how the marks lie."""
    expected = load_scan(write_breast(tmp_path, "mm"), points=300)
    silent = {key: value for key, value in cup_frame_landmarks().items() if key != "units"}

    def written(unit, factor, marks):
        rows = "\n".join(",".join(f"{value:.17g}" for value in point) for point in cup_frame_points() / factor)
        path = tmp_path / "a.csv"
        path.write_text(f"x [{unit}],y [{unit}],z [{unit}]\n{rows}")
        write_landmarks(tmp_path / "a.json", marks)
        return path

    scan = load_scan(written("cm", 10, silent), points=300)
    assert (scan.units.cloud, scan.units.marks) == ("cm", "mm")
    np.testing.assert_allclose(scan.points, expected.points, atol=1e-6)
    path = written("cm", 10, cup_frame_landmarks())
    assert message(path, path).startswith(
        "its header says units 'cm', its landmark file a.json says units 'mm'. Export"
    )
    path = written("m", 1, silent)
    assert message(path, path).startswith(
        "its header says units 'm', but the landmarks of a.json lie on it as if in millimetres. "
    )
    assert load_scan(path, points=300, units="mm").units.cloud == "mm", "a setting is the last word"


def test_a_unit_in_doubt_is_asked_for(tmp_path):
    # 13 cm would be a small wire, 13 inches a large one.
    scale = 13 / (np.pi * RADIUS)
    path = write_posed(tmp_path, "a", lambda p: p * scale)
    marks = transformed(cup_frame_landmarks(), lambda p: p * scale)
    write_landmarks(landmarks_path(path), {key: value for key, value in marks.items() if key != "units"})
    assert message(path, landmarks_path(path)) == (
        "units: a wire of length 12.99 can be in none or in two units. "
        'Say which: scan.units=UNIT, or "units": "UNIT" in the landmark file, with UNIT one of mm, cm, in, m.'
    )
    assert load_scan(path, units="in").units.cloud == "in"


def test_a_cloud_with_a_useless_flag(tmp_path):
    path = write_breast(tmp_path)
    write_ply(path, cup_frame_points(), np.zeros(1500, dtype=bool))
    assert message(path) == (
        "only 0 of 1500 points are flagged 'inside', at least 100 are needed. "
        "Set 'inside' to 1 for the points between wire and upper line, or remove the property to use all points."
    )


def chest(n: int = 40_000, seed: int = 1) -> np.ndarray:
    """A chest about the quarter sphere: the plane z = 0 beyond the wire, and a wall rising behind the upper line."""
    generator = np.random.default_rng(seed)
    points = np.zeros((n, 3))
    points[:, :2] = generator.uniform([-260, -200], [300, 330], (n, 2))
    below = points[:, 0] > 0
    inside_wire = np.hypot(points[:, 0], points[:, 1] - RADIUS) < RADIUS
    # Above the chord a slope that meets the sphere's rim: z = height of the rim there, falling off outwards.
    rim = np.sqrt(np.clip(RADIUS**2 - (points[:, 1] - RADIUS) ** 2, 0, None))
    points[:, 2] = np.where(below, 0.0, rim * np.exp(points[:, 0] / 60))
    return points[~(below & inside_wire)]


def test_a_breast_is_cut_out_of_a_torso_along_wire_and_upper_line(tmp_path):
    path = write_breast(tmp_path)
    breast = cup_frame_points(6000)
    write_ply(path, np.concatenate([chest(), breast]))
    scan = load_scan(path, points=None, outliers=None)
    sphere = np.abs(np.linalg.norm(scan.points - [0, RADIUS, 0], axis=1) - RADIUS) < 1e-3
    assert sphere.sum() > 0.985 * len(breast)
    # What else was taken lies at the curve, within the distance between points.
    others = scan.points[~sphere]
    assert len(others) < 0.02 * len(breast)
    wire = np.hypot(others[:, 0], others[:, 1] - RADIUS) - RADIUS
    assert (np.minimum(np.abs(wire), np.abs(others[:, 0])) < 4.0).all()
    assert scan.cleaning.outside + scan.cleaning.elsewhere > 30_000
    assert scan.origin.neckline == "given"


def test_a_neckline_is_built_where_none_is_given(tmp_path):
    path = write_breast(tmp_path, upper_line=None)
    write_ply(path, np.concatenate([chest(), cup_frame_points(6000)]))
    scan = load_scan(path, points=500)
    assert scan.origin.neckline == "built"
    line = present(scan.neckline)
    np.testing.assert_allclose(line[[0, -1]], [[0, 0, 0], [0, 2 * RADIUS, 0]], atol=1e-9)
    assert np.linalg.norm(line - [0, RADIUS, RADIUS], axis=1).min() < 1e-6
    # Each half is planar and on the breast.
    for half in (line[:21], line[20:]):
        assert np.linalg.svd(half - half.mean(axis=0))[1][2] < 1e-6
    on_sphere = line[line[:, 0] > 0]
    assert np.abs(np.linalg.norm(on_sphere - [0, RADIUS, 0], axis=1) - RADIUS).max(initial=0) < 2.0


def test_a_torso_without_a_line_where_the_cup_ends(tmp_path):
    path = write_breast(tmp_path, upper_line=None, landmarks=None)
    write_ply(path, np.concatenate([chest(), cup_frame_points(3000)]))
    assert message(path) == (
        "the cloud is more than one breast, and nothing says where the cup ends. "
        "Mark landmarks.strap_point or upper_line, or give the points a property 'inside', 1 on the breast."
    )


def test_the_same_for_doubled_and_shuffled_points(tmp_path):
    path = write_breast(tmp_path)
    cloud = np.concatenate([chest(), cup_frame_points(6000)])
    write_ply(path, cloud)
    expected = load_scan(path, points=800)
    order = np.random.default_rng(3).permutation(2 * len(cloud))
    write_ply(path, np.concatenate([cloud, cloud])[order])
    again = load_scan(path, points=800)
    np.testing.assert_array_equal(again.points, expected.points)
    assert again.cleaning.duplicates > 10_000


def test_a_side_that_is_not_marked_needs_a_torso(tmp_path):
    path = write_breast(tmp_path)
    with pytest.raises(InputError, match=r"marks the left breast only, and .* no whole torso: it has no right breast"):
        load_scan(path, side="right")


@pytest.mark.parametrize(("said", "long"), [("cm", 2042), ("in", 5188), ("m", 204200)])
def test_a_unit_that_is_not_the_data_s_is_called_that(tmp_path, said: str, long: int):
    """The one who says it is named: the landmark file, or the setting."""
    path = write_breast(tmp_path)
    words = rf"breast\.ply: scan\.units={said}: the wire would be .*Take scan\.units away"
    with pytest.raises(InputError, match=words) as error:
        load_scan(path, units=said)
    assert abs(float(re.findall(r"be (\d+) mm", str(error.value))[0]) - long) < 0.01 * long
    marks = json.loads(path.with_suffix(".json").read_text())
    write_landmarks(path.with_suffix(".json"), {**marks, "units": said})
    words = rf'breast\.json: units: "{said}", but the wire .* it looks like millimetres, not .*Take "units" out'
    with pytest.raises(InputError, match=words):
        load_scan(path)
    write_landmarks(path.with_suffix(".json"), {**marks, "units": None})
    load_scan(path)


@pytest.mark.parametrize("left_out", [("strap_point",), ("wire_bottom",), ()])
def test_wire_and_upper_line_that_are_swapped_are_called_that(tmp_path, left_out):
    path = write_breast(tmp_path)
    marks = json.loads(path.with_suffix(".json").read_text())
    points = {name: place for name, place in marks["landmarks"].items() if name not in left_out}
    other = {"wire": marks["upper_line"], "upper_line": marks["wire"], "landmarks": points}
    write_landmarks(path.with_suffix(".json"), marks | other)
    with pytest.raises(InputError, match=r"breast\.json: wire and upper_line seem to be swapped: landmarks\."):
        load_scan(path)
    ends = {name: points[name] for name in ("inner_end", "outer_end")}
    write_landmarks(path.with_suffix(".json"), marks | other | {"landmarks": ends})
    with pytest.raises(InputError, match=r"The side is probably wrong: .*, or exchange wire and upper_line, if each"):
        load_scan(path)


def test_a_mesh_that_is_mostly_floor_is_called_that(tmp_path):
    import trimesh
    from scipy.spatial import Delaunay

    path = write_breast(tmp_path).with_suffix(".off")
    points = cup_frame_points(1500)
    breast = trimesh.Trimesh(points, Delaunay(points[:, 1:] + points[:, :1] * [0, 0.3]).simplices, process=False)
    floor = trimesh.creation.box([7_000.0, 10.0, 7_000.0]).apply_translation([0, -1500.0, 0])
    trimesh.util.concatenate([breast, floor]).export(path)
    line = message(path)
    assert "sampled on its mesh by area: " in line
    assert line.endswith("Cut off what is no body, such as floor and walls, or raise scan.mesh_points.")


def test_a_cloud_of_one_point_many_times(tmp_path):
    path = write_breast(tmp_path)
    write_ply(path, np.repeat(cup_frame_points(60), 10, axis=0))
    assert message(path) == (
        "only 60 distinct points are left of 600 after cleaning and cropping. "
        "Check wire and upper line; raise scan.outliers (null keeps all points), or scan more densely."
    )


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("marked", [("inner_end", "outer_end"), ("outer_end",), ()])
def test_a_wire_from_its_outer_end_is_turned_and_noted(tmp_path, side, marked):
    def pose(points):
        return points * (1, 1, 1 if side == "left" else -1) + (0, 1200, 0)

    landmarks = transformed({**cup_frame_landmarks(), "side": side}, pose)
    landmarks["wire"] = landmarks["wire"][::-1]
    for name in {"inner_end", "outer_end"} - set(marked):
        del landmarks["landmarks"][name]
    write_landmarks(tmp_path / "a.json", landmarks)
    scan = load_scan(write_ply(tmp_path / "a.ply", pose(cup_frame_points())))
    np.testing.assert_allclose(scan.wire, cup_frame_landmarks()["wire"], atol=1e-9)
    assert scan.origin.wire_turned
    (note,) = (str(note) for note in scan.notes if note.code == "wire_turned")
    assert note.startswith("a.ply: the wire is given from its outer end, and is turned")
    assert ("so is the side" in note) == (not marked)


def test_half_a_wire_is_not_more_than_one_breast(tmp_path):
    landmarks = cup_frame_landmarks()
    landmarks = {"side": "left", "units": "mm", "landmarks": {}, "wire": landmarks["wire"][:16]}
    write_landmarks(tmp_path / "a.json", landmarks)
    path = write_ply(tmp_path / "a.ply", cup_frame_points())
    assert message(path, tmp_path / "a.json") == (
        "wire: it covers only a part of the breast's line: it is 102 mm long and hardly bent, the points reach over "
        "159 mm. Trace the whole crease, from its inner to its outer end."
    )


def test_points_on_no_surface_are_called_that(tmp_path):
    write_landmarks(tmp_path / "a.json", cup_frame_landmarks())
    noise = np.random.default_rng(0).uniform(0, (65, 130, 65), (6000, 3))
    path = write_ply(tmp_path / "a.ply", noise)
    assert message(path).startswith("its points lie on no surface: they fill a volume. Export the surface")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"point": 300}, r"scan\.point: there is no such setting; did you mean points\? known are points, outliers"),
        ({"outliers": True}, r"scan\.outliers: True, but it must be a number"),
        ({"points": 3}, r"scan\.points: 3, but at least 10 are needed"),
    ],
)
def test_settings_given_to_a_function_are_checked_like_those_of_the_command(tmp_path, settings, words):
    path = write_breast(tmp_path)
    with pytest.raises(ConfigError, match=words):
        load_scan(path, **settings)
