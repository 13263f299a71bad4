"""The unit of a body by its depth, and of marks by the ends of their wire: one that is certain, or none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from breasts import cup_frame_landmarks, cup_frame_points

from brafit.cloud import Cloud
from brafit.errors import InputError
from brafit.landmarks.file import Landmarks
from brafit.landmarks.units import DEPTH_POSSIBLE, DEPTH_RARE, DEPTH_USUAL, MILLIMETRES, unit_of
from brafit.scan.marked import with_marks


@pytest.mark.parametrize("depth", [200.0, 250.0, 330.0])
@pytest.mark.parametrize("unit", MILLIMETRES)
def test_usual_depths_are_known_in_every_unit(depth, unit):
    assert unit_of(depth / MILLIMETRES[unit], DEPTH_POSSIBLE, DEPTH_USUAL, DEPTH_RARE) == unit


@pytest.mark.parametrize("depth", [452.0, 475.0])
@pytest.mark.parametrize("unit", ["mm", "m"])
def test_rare_depths_are_known_where_only_one_unit_can_be_meant(depth, unit):
    """Very large bodies, which were refused though nothing else can be meant (found on parametric bodies)."""
    assert unit_of(depth / MILLIMETRES[unit], DEPTH_POSSIBLE, DEPTH_USUAL, DEPTH_RARE) == unit


@pytest.mark.parametrize("depth", [15.0, 60.0, 1.0, 9000.0])
def test_what_could_be_two_units_or_none_is_not_known(depth):
    """15: 150 mm in centimetres or 381 in inches. 60: a breast alone, in millimetres, is no body in centimetres."""
    assert unit_of(depth, DEPTH_POSSIBLE, DEPTH_USUAL, DEPTH_RARE) is None


def marks(factor: float, *names: str, upper: bool = True) -> Landmarks:
    """Of a breast in millimetres, without a wire, divided by the factor."""
    breast = cup_frame_landmarks()
    points = {name: place / factor for name, place in breast["landmarks"].items() if name in names}
    return Landmarks(Path("a.json"), "a", "left", None, breast["upper_line"] / factor if upper else None, points)


@pytest.mark.parametrize("of_marks", MILLIMETRES)
@pytest.mark.parametrize("of_cloud", MILLIMETRES)
@pytest.mark.parametrize(
    "names", [("inner_end", "outer_end", "apex", "strap_point"), ("apex", "strap_point", "inner_end")]
)
def test_units_of_marks_without_a_wire_are_found_by_its_ends(of_marks, of_cloud, names):
    """Marked, or else the ends of the upper line; the cloud's unit then by how they lie on it."""
    cloud = Cloud(Path("a.ply"), cup_frame_points() / MILLIMETRES[of_cloud], None, None)
    marked = with_marks(cloud, marks(MILLIMETRES[of_marks], *names), None, propose=False)
    assert (marked.units.cloud, marked.units.marks) == (of_cloud, of_marks)
    np.testing.assert_allclose(marked.cloud.points, cup_frame_points(), atol=1e-9)


@pytest.mark.parametrize("of_marks", MILLIMETRES)
@pytest.mark.parametrize("of_cloud", ["mm", "m"])
def test_units_of_two_marks_on_a_body_are_found_by_how_they_lie(of_marks, of_cloud):
    box = np.random.default_rng(0).uniform((-200, 900, -130), (200, 1500, 130), (4000, 3))
    box[::2, 2] = 130.0
    skin = box[::2][:2]
    apex, strap = skin / MILLIMETRES[of_marks]
    points = {"apex": apex, "strap_point": strap}
    landmarks = Landmarks(Path("a.json"), "a", "left", None, None, points)
    cloud = Cloud(Path("a.ply"), box / MILLIMETRES[of_cloud], None, None)
    found = with_marks(cloud, landmarks, None, propose=False).units
    assert (found.cloud, found.marks) == (of_cloud, of_marks)


@pytest.mark.parametrize(("said", "apart"), [("cm", "1300.0"), ("in", "3302.0"), ("m", "130000.0")])
@pytest.mark.parametrize("by_setting", [True, False])
def test_a_unit_in_which_the_ends_of_a_wire_are_too_far_apart_is_refused(said, apart, by_setting):
    """Without a wire in the file it had been found on a breast ten times as large, and the cup was `ok`."""
    landmarks = replace(marks(1.0, "inner_end", "outer_end", "apex"), units=None if by_setting else said)
    cloud = Cloud(Path("a.ply"), cup_frame_points(), None, None)
    who = f"scan.units={said}: " if by_setting else f'units: "{said}", but '
    with pytest.raises(InputError, match=rf"{who}the wire's ends would be {apart} mm apart: it looks like millimetres"):
        with_marks(cloud, landmarks, said if by_setting else None, propose=False)


def test_a_unit_in_which_the_ends_of_a_wire_are_too_near_is_refused():
    landmarks = replace(marks(10.0, "inner_end", "outer_end", "apex"), units="mm")
    cloud = Cloud(Path("a.ply"), cup_frame_points() / 10, None, None)
    with pytest.raises(InputError, match=r"ends would be 13\.0 mm apart: it looks like centimetres, not millimetres"):
        with_marks(cloud, landmarks, None, propose=False)
