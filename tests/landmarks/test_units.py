"""The unit of a body by its depth: one that is certain, or none."""

import pytest

from brafit.landmarks.units import DEPTH_POSSIBLE, DEPTH_RARE, DEPTH_USUAL, MILLIMETRES, unit_of


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
