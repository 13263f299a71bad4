from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_landmarks, rotation

from brafit.errors import InputError
from brafit.geometry.polyline import evenly_spaced
from brafit.landmarks.cup_frame import frame_from_wire, from_inner_end, runs_backwards

WIRE = cup_frame_landmarks()["wire"]
APEX = cup_frame_landmarks()["landmarks"]["apex"]
SHIFT = np.array([120.0, 1290.0, -35.0])


def test_a_cup_frame_breast_stays_where_it_is():
    frame = frame_from_wire(WIRE, "left", APEX, "a.json")
    np.testing.assert_allclose(frame.axes, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame.origin, 0, atol=1e-12)
    assert not frame.mirrored


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("side", ["left", "right"])
def test_any_pose_is_undone_and_comes_back(seed, side):
    mirror = np.diag([1.0, 1.0, 1.0 if side == "left" else -1.0])
    points = np.random.default_rng(seed).uniform(-100, 100, (50, 3))

    def pose(p):
        return p @ mirror @ rotation(seed).T + SHIFT

    frame = frame_from_wire(pose(WIRE), side, pose(APEX), "a.json")
    assert frame.mirrored == (side == "right")
    np.testing.assert_allclose(frame.to_cup(pose(points)), points, atol=1e-10)
    np.testing.assert_allclose(frame.to_scan(frame.to_cup(pose(points))), pose(points), atol=1e-10)
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-14)


def test_axes_are_where_they_should_be_on_a_bent_wire():
    bent = WIRE + np.outer(np.sin(np.linspace(0, np.pi, len(WIRE))) ** 2, [0, 0, 4.0])
    cup = frame_from_wire(bent, "left", APEX, "a.json").to_cup(bent)
    np.testing.assert_allclose(cup[0], 0, atol=1e-12)
    np.testing.assert_allclose(cup[-1], [0, 2 * RADIUS, 0], atol=1e-9)
    assert cup[:, 0].max() > 0.9 * RADIUS


def test_marking_a_part_more_densely_does_not_turn_the_frame():
    bent = WIRE + np.outer(np.linspace(0, 1, len(WIRE)) ** 3, [0, 0, 5.0])
    dense = np.concatenate([evenly_spaced(bent[:6], 300)[:-1], bent[5:]])
    sparse, crowded = (frame_from_wire(wire, "left", APEX, "a.json") for wire in (bent, dense))
    np.testing.assert_allclose(crowded.axes, sparse.axes, atol=2e-3)


def test_a_wrong_side_is_recognised():
    with pytest.raises(InputError) as caught:
        frame_from_wire(WIRE, "right", APEX, "a.json")
    assert str(caught.value) == (
        "a.json: side: for a right breast the wire runs the wrong way round, its bottom would be above its ends. "
        'The side is probably wrong: write "left", or list the wire from its inner to its outer end.'
    )


def test_wires_that_are_no_bow():
    line = np.outer(np.linspace(0, 1, 10), [150.0, 0, 0])
    with pytest.raises(InputError, match=r"^a\.json: wire: nearly straight, 0\.0 mm high on 150 mm of span\. Trace"):
        frame_from_wire(line, "left", APEX, "a.json")
    angle = np.linspace(0, 2 * np.pi, 40)
    ring = 60 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    with pytest.raises(InputError, match=r"^a\.json: wire: its ends are only 0\.0 mm apart on 37\d mm of length\. "):
        frame_from_wire(ring, "left", APEX, "a.json")


def test_a_reversed_wire_is_turned_round():
    for wire in (WIRE, WIRE[::-1]):
        np.testing.assert_array_equal(from_inner_end(wire, WIRE[0] + [0, 0, 3.0], "a.json"), WIRE)
    with pytest.raises(
        InputError, match=r"^a\.json: landmarks\.inner_end: 40\.0 mm from the nearer end of the wire\. "
    ):
        from_inner_end(WIRE, WIRE[0] + [0, 0, 40.0], "a.json")


def test_the_outer_end_alone_tells_the_direction():
    for wire in (WIRE, WIRE[::-1]):
        np.testing.assert_array_equal(from_inner_end(wire, None, "a.json", WIRE[-1] + [0, 0, 3.0]), WIRE)
    assert from_inner_end(WIRE, None, "a.json", WIRE[15]) is WIRE


def test_the_side_tells_the_direction():
    front = np.array([30.0, 65.0, 40.0])
    for side, wire in (("left", WIRE), ("right", WIRE * (-1, 1, 1))):
        before = front if side == "left" else front * (-1, 1, 1)
        assert not runs_backwards(wire, side, before, "a.json")
        assert runs_backwards(wire[::-1], side, before, "a.json")
