from __future__ import annotations

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

from brafit.errors import InputError
from brafit.samples import sample_paths
from brafit.scan import landmarks_path, load_scan

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
    np.testing.assert_allclose(scan.points, expected[np.lexsort(expected.T[::-1])], atol=1e-9)
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
        "Write breast.json with at least wire and side, see brafit/scan/landmarks.schema.json."
    )
    path.unlink()
    assert message(path) == "there is no such file. Check the path."


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {"wire": None},
            "wire: missing. Add the field wire. See brafit/scan/landmarks.schema.json for the format.",
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
            "It looks like metres: multiply its coordinates by 1000, and the cloud's if it is alike.",
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
            f"upper_line: nowhere near the cloud, 381 mm away from it. {TOGETHER}",
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
            'The side is probably wrong: write "left", or list the wire from its inner to its outer end.',
        ),
    ],
)
def test_a_landmark_file_that_cannot_be_used(tmp_path, changes, expected):
    path = write_breast(tmp_path, **changes)
    assert message(path, landmarks_path(path)) == expected


@pytest.mark.parametrize(
    ("factor", "unit", "across"),
    [(1000, "metres", "0.159"), (10, "centimetres", "15.9"), (25.4, "inches", "6.26")],
)
def test_a_cloud_in_another_unit(tmp_path, factor, unit, across):
    path = write_breast(tmp_path)
    write_ply(path, cup_frame_points() / factor)
    assert message(path) == (
        f"the whole cloud is only {across} mm across, its wire is 204 mm long. "
        f"It looks like {unit}: multiply the cloud's coordinates by {factor:g}."
    )


def test_a_cloud_with_a_useless_flag(tmp_path):
    path = write_breast(tmp_path)
    write_ply(path, cup_frame_points(), np.zeros(1500, dtype=bool))
    assert message(path) == (
        "only 0 of 1500 points are flagged 'inside', at least 100 are needed. "
        "Set 'inside' to 1 for the points between wire and upper line, or remove the property to use all points."
    )


def test_a_whole_torso(tmp_path):
    path = write_breast(tmp_path)
    rest = np.random.default_rng(0).uniform([-400, -400, -250], [250, 300, 0], (20000, 3))
    points = np.concatenate([cup_frame_points(), rest])
    write_ply(path, points)
    line = message(path)
    assert line.startswith("the cloud is more than one breast: half of its points lie over ")
    assert line.endswith(
        "mm off the middle of its wire. "
        "Cut it along wire and upper line, or mark the breast's points by a property 'inside' of 1, all others 0."
    )
    write_ply(path, points, np.arange(len(points)) < 1500)
    assert load_scan(path).cleaning.outside > 19000


def test_a_cloud_of_one_point_many_times(tmp_path):
    path = write_breast(tmp_path)
    write_ply(path, np.repeat(cup_frame_points(60), 10, axis=0))
    assert message(path) == (
        "only 60 distinct points are left of 600 after cleaning. "
        "Raise scan.outliers (null keeps all points), or scan more densely."
    )
