from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
from cups import half_circle

from brafit.cup import StripsCup, Wire
from brafit.cup.plain import HEIGHT, panel_of
from brafit.fitting import Target
from brafit.fitting.targets import Targets
from brafit.simulation.synthetic import quarter_sphere


def heights(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("panels", [1, 2, 3, 4, 6])
def test_the_higher_the_breast_the_wider_every_panel_in_the_middle(panels):
    """T_0, T_2 and T_4 are 1, -1 and 1 there. Angles do not count."""
    cup = StripsCup(half_circle(3), panels)
    values, counts = cup.plain(heights(0.28, 0.5, 0.75))
    width = (cup.split(values)["length"][..., :5:2] @ heights(1, -1, 1)).exp()
    assert (width.diff(dim=0) > 0).all()
    assert cup.split(counts[None])["angle"].abs().max() == 0


def test_panels_between_first_and_last_are_alike():
    assert [panel_of(k, 5) is panel_of(1, 5) for k in range(5)] == [False, True, True, True, False]
    values = StripsCup(half_circle(), 4).plain(heights(HEIGHT))[0]
    rib = StripsCup(half_circle(), 4).split(values)["rib"][0]
    assert torch.equal(rib[1], rib[2])


def test_the_height_of_a_quarter_sphere_wherever_it_lies():
    """Its points' mean height is R / 2 (Archimedes: slices of equal height have equal surface)."""
    radius = 80.0
    points = quarter_sphere(6000, radius, np.random.default_rng(1)).numpy()
    angle = np.linspace(0, np.pi, 80)
    wire = radius * np.stack((np.sin(angle), 1 - np.cos(angle), 0 * angle), axis=1)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    made = partial(Target, "sphere")
    targets = [made(points, wire), made(points @ turn.T + 7.0, wire @ turn.T + 7.0)]
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    found = Targets.stack(targets, wires.scale).height(wires) * wires.scale
    assert torch.allclose(found[0], found[1], rtol=0, atol=1e-9)
    assert found[0].item() == pytest.approx(radius / 2, rel=0.02)
