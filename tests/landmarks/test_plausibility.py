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


def test_a_whole_wire_is_none_whatever_is_about_it():
    breast = cup_frame_points(2000)
    check_scan(cloud(breast), landmarks(WIRE))
    margin = np.random.default_rng(0).uniform(-2.3 * RADIUS, 2.3 * RADIUS, (500, 3)) * (1, 1, 0)
    check_scan(cloud(np.concatenate([breast, margin])), landmarks(WIRE))


def test_a_flat_wire_on_a_torso_is_none():
    body = np.random.default_rng(0).uniform((-300, -200, 0), (300, 400, 300), (5000, 3))
    check_scan(cloud(np.concatenate([cup_frame_points(2000), body])), landmarks(WIRE[:16]))
