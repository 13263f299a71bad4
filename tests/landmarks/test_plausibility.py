"""Lines and points that cannot be a breast's are called what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_landmarks, cup_frame_points

from brafit.cloud import Cloud
from brafit.errors import InputError
from brafit.landmarks.file import Landmarks
from brafit.landmarks.plausibility import check_scan

WIRE = cup_frame_landmarks()["wire"]


def cloud(points: np.ndarray, inside: np.ndarray | None = None) -> Cloud:
    return Cloud(path=Path("a.ply"), points=points, normals=None, inside=inside)


def landmarks(wire: np.ndarray) -> Landmarks:
    return Landmarks(path=Path("a.json"), name="a", side="left", wire=wire, upper_line=None, points={})


@pytest.mark.parametrize("part", [slice(0, 16), slice(15, None), slice(8, 24)])
@pytest.mark.parametrize("flagged", [False, True])
def test_half_a_wire(part: slice, flagged: bool):
    margin = np.random.default_rng(0).uniform((-40, -40, 0), (105, 170, 0), (500, 3))
    points = np.concatenate([cup_frame_points(2000), margin])
    inside = np.arange(len(points)) < 2000 if flagged else None
    with pytest.raises(InputError, match="wire: it covers only a part of the breast's line: it is 102 mm long"):
        check_scan(cloud(points, inside), landmarks(WIRE[part]))


def marked(**changes) -> Landmarks:
    breast = cup_frame_landmarks()
    points = {name: np.array(place) for name, place in (breast["landmarks"] | changes.pop("points", {})).items()}
    lines = (changes.get("wire", breast["wire"]), changes.get("upper_line"))
    return Landmarks(Path("a.json"), "a", "left", *lines, points)


def test_wires_whose_points_are_not_in_order_are_called_that():
    cloud, wire = Cloud(Path("a.ply"), cup_frame_points(), None, None), cup_frame_landmarks()["wire"]
    check_scan(cloud, marked())
    check_scan(cloud, marked(wire=wire[np.linspace(0, len(wire) - 1, 4).astype(int)]))
    jumping = wire + 5 * np.cos(np.pi * np.arange(len(wire)))[:, None] * [0, 0, 1]
    for wrong in (jumping, wire[np.random.default_rng(0).permutation(len(wire))]):
        with pytest.raises(InputError, match=r"a\.json: wire: its points run to and fro: .* List them in order"):
            check_scan(cloud, marked(wire=wrong))


def test_lines_whose_parts_are_not_in_order_are_called_that():
    """Each part is smooth, and its neighbours are near: the fit had gone on for a minute, to no likeness."""
    cloud, breast = Cloud(Path("a.ply"), cup_frame_points(), None, None), cup_frame_landmarks()
    check_scan(cloud, marked(upper_line=breast["upper_line"]))
    check_scan(cloud, marked(upper_line=breast["upper_line"][[0, 10, 15, 30]]))
    trembling = np.repeat(breast["wire"], 10, axis=0) + np.random.default_rng(0).normal(0, 0.5, (310, 3))
    check_scan(cloud, marked(wire=trembling[np.arange(310) % 10 < 1]))
    for name in ("wire", "upper_line"):
        line = breast[name]
        blocks = np.concatenate([line[:8], line[16:24], line[8:16], line[24:]])
        crossing = np.concatenate([line[:20], line[18:8:-1], line[20:]])
        for wrong in (blocks, crossing):
            with pytest.raises(InputError, match=rf"a\.json: {name}: its points run to and fro: .* List them in order"):
                check_scan(cloud, marked(**{name: wrong}))


def test_wires_of_two_breasts_in_one_line_are_called_that():
    wire = cup_frame_landmarks()["wire"]
    both = np.concatenate([wire[::-1] * [1, -1, 1], wire + np.array([0, 20.0, 0])])
    points = np.concatenate([cup_frame_points(), cup_frame_points() * [1, -1, 1]])
    for line in (both, both[::-1], both[3:-3]):
        with pytest.raises(InputError, match="wire: it is two bows, as if the wires of both breasts were one line"):
            check_scan(cloud(points), landmarks(line))


def test_a_closed_wire_is_called_that_whatever_the_size_of_the_cloud():
    breast = cup_frame_landmarks()
    closed = np.concatenate([breast["wire"], breast["upper_line"][::-1]])
    with pytest.raises(InputError, match=r"wire: its ends are only 0\.0 mm apart on .* not round the breast"):
        check_scan(cloud(cup_frame_points()), landmarks(closed))


@pytest.mark.parametrize(("name", "line"), [("strap_point", "upper_line"), ("wire_bottom", "wire")])
def test_points_away_from_the_line_on_which_they_lie_are_called_that(name, line):
    breast = cup_frame_landmarks()
    away = np.array(breast["landmarks"]["apex"]) - [0, 20.0, 0]
    places = {"upper_line": breast["upper_line"], "points": {name: away}}
    with pytest.raises(InputError, match=rf"landmarks\.{name}: \d+ mm from {line}, on which it should lie"):
        check_scan(cloud(cup_frame_points()), marked(**places))


def test_an_upper_line_that_is_no_upper_edge_is_called_that():
    breast, points = cup_frame_landmarks(), cloud(cup_frame_points())
    with pytest.raises(InputError, match=r"upper_line: it runs along the wire, 0\.0 mm from it, and leaves no cup"):
        check_scan(points, marked(upper_line=breast["wire"][::-1]))
    straight = np.array([[0, 0, 0], [0, RADIUS, 0], [0, 2 * RADIUS, 0]])  # two of its three points are on the skin
    with pytest.raises(InputError, match="upper_line: nowhere near the cloud"):
        check_scan(points, replace(marked(upper_line=straight), points={}))


@pytest.mark.parametrize(("one", "other"), [("wire_bottom", "apex"), ("apex", "strap_point")])
def test_two_marks_in_one_place_are_refused(one, other):
    cloud = Cloud(Path("a.ply"), cup_frame_points(), None, None)
    same = {other: cup_frame_landmarks()["landmarks"][one] + np.array([0, 2.0, 0])}
    with pytest.raises(InputError, match=f"landmarks.{one} and landmarks.{other} are 2.0 mm apart, which are two"):
        check_scan(cloud, marked(points=same))


def test_a_whole_wire_is_none_whatever_is_about_it():
    breast = cup_frame_points(2000)
    check_scan(cloud(breast), landmarks(WIRE))
    margin = np.random.default_rng(0).uniform(-2.3 * RADIUS, 2.3 * RADIUS, (500, 3)) * (1, 1, 0)
    check_scan(cloud(np.concatenate([breast, margin])), landmarks(WIRE))


def test_a_flat_wire_on_a_torso_is_none():
    body = np.random.default_rng(0).uniform((-300, -200, 0), (300, 400, 300), (5000, 3))
    check_scan(cloud(np.concatenate([cup_frame_points(2000), body])), landmarks(WIRE[:16]))


@pytest.mark.parametrize("count", [300, 1500, 20_000])
def test_marks_on_the_skin_are_off_no_cloud_however_sparse(count: int):
    """What is between a sparse cloud's points is not the marks' fault."""
    breast = cup_frame_landmarks()
    off = check_scan(cloud(cup_frame_points(count)), marked(upper_line=breast["upper_line"]))
    assert off.keys() == {"wire", "upper_line", *(f"landmarks.{name}" for name in breast["landmarks"])}
    length = np.pi * RADIUS
    assert max(off["wire"], off["upper_line"]) < 0.01 * length
    assert max(off.values()) < 0.03 * length
    apex = breast["landmarks"]["apex"] * 1.4
    lifted = replace(marked(wire=breast["wire"] + np.array([0, 0, -12.0])), points={"apex": apex})
    off = check_scan(cloud(cup_frame_points(count)), lifted)
    assert off["wire"] > (0.03 if count > 300 else 0.01) * length
    assert off["landmarks.apex"] > (0.12 if count > 300 else 0.08) * length


def test_a_line_of_which_a_part_has_no_points_is_called_that():
    points = cup_frame_points(4000)
    part = points[points[:, 1] < 0.4 * RADIUS]
    part = cloud(np.concatenate([part, part + np.array([120, -120, 0])]))
    with pytest.raises(
        InputError, match=r"wire: \d\d % of it is away from the cloud, the rest lies on it\. Check that a"
    ):
        check_scan(part, landmarks(WIRE))


@pytest.mark.parametrize(("turned", "words"), [((0, 2, 1), "x, -z, y"), ((2, 0, 1), "z, x, -y")])
def test_axes_that_are_exchanged_are_named(turned, words):
    """As where one program takes y for up and the other z."""
    signs = np.array([-1.0 if "-" in word else 1.0 for word in words.split(", ")])
    move = np.array([20.0, 1200.0, 90.0])
    breast = marked(upper_line=cup_frame_landmarks()["upper_line"]).mapped(lambda places: places + move)
    points = (cup_frame_points() + move)[:, turned] * signs
    with pytest.raises(InputError, match=f"wire: nowhere near .* same axes: with {words} for x, y, z they lie on it"):
        check_scan(cloud(points), breast)
    with pytest.raises(InputError, match=r"wire: nowhere near .* is in the same frame\.$"):
        check_scan(cloud(points + np.array([0, 300.0, 0])), breast)
