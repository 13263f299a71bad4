"""Finished dimensions, and how uncertain they are, against measuring one cup after another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from lunes import RADIUS, lune_cup, lune_flat

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel
from brafit.pattern import PatternOptions, finish, pieces_from_panels
from brafit.report.dimensions import MARKS, dimensions, survey_of

APEX, STRAP = np.array((60.0, 85.0, 50.0)), np.array((0.0, RADIUS, RADIUS))


@dataclass(frozen=True)
class Cup:
    shape: CupShape
    panels: list[FlatPanel]


def cup(panels: int, scale: float = 1.0) -> Cup:
    shape = lune_cup(panels)
    flat = [FlatPanel(panel.lower * scale, panel.upper * scale) for panel in lune_flat(panels)]
    return Cup(shape.scaled(torch.tensor(scale)), flat)


def measured(one: Cup) -> dict[tuple[str, str], float]:
    pattern = finish(pieces_from_panels(one.panels), PatternOptions(), name="x", side="left")
    return {(d.part, d.name): d.value for d in dimensions(one, pattern, APEX, STRAP)}


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_deviation_is_that_of_the_alternatives(panels):
    best, others = cup(panels), [cup(panels, 1.001), cup(panels, 0.998)]
    found = survey_of(best, others, APEX, STRAP).deviation
    own, apart = measured(best), [measured(other) for other in others]
    marks = ("cup", MARKS)
    assert own.pop(marks) == pytest.approx(np.linalg.norm(APEX - STRAP))
    assert set(found) == set(own), "the distance of two marks is no dimension of the cup, and has no deviation"
    for key, value in own.items():
        wanted = np.sqrt(sum((other[key] - value) ** 2 for other in apart))
        assert found[key] == pytest.approx(wanted, abs=0.005), key


def test_dimensions_have_the_order_and_units_of_the_pieces():
    pattern = finish(pieces_from_panels(lune_flat(2)), PatternOptions(), name="x", side="left")
    survey = replace(
        survey_of(cup(2), [], APEX, STRAP), deviation={("cup", "bust point to inner end, through the air"): 0.5}
    )
    table = dimensions(cup(2), pattern, APEX, STRAP, survey)
    assert [d.name for d in table[:5]] == ["wire", "seam", "width", "height", "area"]
    assert [d.part for d in table if d.name == "area"] == ["lower panel", "upper panel"]
    assert {d.unit for d in table if d.name.startswith("area")} == {"cm2"}
    assert {d.unit for d in table if not d.name.startswith("area")} == {"mm"}
    assert [d.sd for d in table if d.sd is not None] == [0.5]
    whole = next(d.value for d in table if d.name == "area of all panels")
    assert whole == pytest.approx(sum(d.value for d in table if d.name == "area"))


def test_no_alternatives_no_deviation():
    assert survey_of(cup(2), [], APEX).deviation == {}
