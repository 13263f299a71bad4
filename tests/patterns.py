"""Finished patterns of closed-form cups for the tests of the writers, and what independent readers measure in them."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from lunes import RADIUS, lune_cup, lune_flat

from brafit.geometry.development import FlatPanel
from brafit.pattern import Pattern, PatternOptions, Side, finish, marks_on, pieces_from_panels
from brafit.remarks import Remark

APEX = np.array([RADIUS * np.sin(np.pi / 4), RADIUS + 7.0, RADIUS * np.sin(np.pi / 4) + 14.0])
STRAP = np.array([0.0, RADIUS, RADIUS + 1])


def pattern(
    panels: int = 2, side: Side = "left", name: str = "lune", told: Sequence[Remark] = (), **options
) -> Pattern:
    """Two lunes, the apex on the upper one, so that everything that a piece can bear is there."""
    marks = marks_on(lune_cup(panels), APEX, STRAP)
    pieces = pieces_from_panels(lune_flat(panels), side, marks)
    return finish(pieces, PatternOptions(**options), name=name, side=side, date="2001-02-03", fit_warnings=told)


def small(panels: int = 2, scale: float = 0.6, **options) -> Pattern:
    """The same so much smaller, so that pieces fit on paper."""
    marks = marks_on(lune_cup(panels), APEX, STRAP)
    flat = [FlatPanel(panel.lower * scale, panel.upper * scale) for panel in lune_flat(panels)]
    pieces = [
        replace(
            piece,
            edges=tuple(
                replace(edge, marks=tuple(replace(m, distance=m.distance * scale) for m in edge.marks))
                for edge in piece.edges
            ),
        )
        for piece in pieces_from_panels(flat, "left", marks)
    ]
    return finish(pieces, PatternOptions(**options), name="lune", side="left", date="2001-02-03")


def program(name: str) -> str:
    """The path of a reader, or the test is skipped."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"the program {name} is not installed")
    return path
