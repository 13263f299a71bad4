"""The catalogue's wire that is nearest to a wire line, against wires of the catalogue themselves."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from brafit.geometry.rotation import rotation_exp
from brafit.underwires.nearest import chosen_wire, nearest_wire, wanted_wire
from brafit.underwires.sizes import CATALOGUE, WireSize

TURN = rotation_exp(torch.tensor([0.3, -1.1, 0.6], dtype=torch.float64)).numpy()


def somewhere(wire: WireSize) -> np.ndarray:
    """The wire as a line in space."""
    points = wire.line(2000)
    return np.column_stack([points, 0 * points[:, 0]]) @ TURN.T + [10.0, -200.0, 35.0]


@pytest.mark.parametrize("wire", CATALOGUE, ids=lambda wire: wire.name)
def test_a_wire_of_the_catalogue_is_its_own_nearest(wire):
    near = nearest_wire(somewhere(wire))
    assert near.wire is wire
    assert abs(near.length) < 1e-3
    assert abs(near.span) < 1e-6


def test_differences_are_wire_less_line():
    """A line 2 mm shorter and 1 mm narrower than Harriet's 40, which no other wire is nearer to."""
    harriet = next(wire for wire in CATALOGUE if wire.name == "harriet:40")
    near = nearest_wire(somewhere(WireSize("line", harriet.radius - 0.5, harriet.length - 2)))
    assert near.wire is harriet
    assert near.length == pytest.approx(2.0, abs=1e-3)
    assert near.span == pytest.approx(1.0, abs=1e-6)
    assert str(near) == "harriet:40, 2.0 mm longer and 1.0 mm wider"


def test_a_chosen_wire_is_compared_with_the_own_line():
    line = somewhere(next(wire for wire in CATALOGUE if wire.name == "harriet:40"))
    own, far = chosen_wire("harriet:40", line)
    assert not far
    assert own.endswith("nearest to that, of those sold, is harriet:40, as long and as wide")
    told, far = chosen_wire("harriet:44", line)
    assert far
    assert told.startswith(
        "compared with the scan's own wire line, the wire harriet:44 is 29.8 mm longer and 16.9 mm wider"
    )


def test_no_other_wire_is_nearer():
    line = np.column_stack([np.linspace(0, 140, 101), 55 * np.sin(np.linspace(0, np.pi, 101)), np.zeros(101)])
    length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
    apart = {wire.name: (wire.length - length) ** 2 + (wire.span - 140) ** 2 for wire in CATALOGUE}
    near = nearest_wire(line)
    assert near.wire.name == min(apart, key=lambda name: apart[name])
    assert near.length**2 + near.span**2 == pytest.approx(apart[near.wire.name])


def test_wire_with_play_and_spring_is_shorter_and_narrower():
    """On a half circle: the chord between the wire's ends, less what it is opened by."""
    angle = np.linspace(0, np.pi, 20001)
    line = 80 * np.stack((np.sin(angle), -np.cos(angle), 0 * angle), -1)
    length, span = wanted_wire(line, play=6.0, spring=10.0)
    assert length == pytest.approx(80 * np.pi - 12, abs=1e-3)
    assert span == pytest.approx(160 * np.cos(6 / 80) - 10, abs=1e-3)
    assert wanted_wire(line) == pytest.approx((80 * np.pi, 160), abs=1e-3)
    plain, sprung = nearest_wire(line), nearest_wire(line, play=6.0, spring=10.0)
    assert sprung.wire.span < plain.wire.span
    assert sprung.wire.length - sprung.length == pytest.approx(length)
    assert sprung.wire.span - sprung.span == pytest.approx(span)
