"""A wire that covers only a part of a breast's line is called that."""

from __future__ import annotations

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
    return Landmarks(Path("a.json"), "a", "left", changes.get("wire", breast["wire"]), None, points)


def test_wires_whose_points_are_not_in_order_are_called_that():
    cloud, wire = Cloud(Path("a.ply"), cup_frame_points(), None, None), cup_frame_landmarks()["wire"]
    check_scan(cloud, marked())
    check_scan(cloud, marked(wire=wire[np.linspace(0, len(wire) - 1, 4).astype(int)]))
    jumping = wire + 5 * np.cos(np.pi * np.arange(len(wire)))[:, None] * [0, 0, 1]
    for wrong in (jumping, wire[np.random.default_rng(0).permutation(len(wire))]):
        with pytest.raises(InputError, match=r"a\.json: wire: its points run to and fro: .* List them in order"):
            check_scan(cloud, marked(wire=wrong))


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
