"""What is front and what is back of bodies whose arms hang beside them."""

from __future__ import annotations

from zlib import crc32

import numpy as np
import pytest

from brafit.anatomy.torso import body_of
from brafit.simulation.bodies import KINDS, Bodies
from brafit.simulation.scanner import Scanner, simulate

KIND = "whole, arms hanging"


@pytest.mark.filterwarnings("ignore::Warning")  # the model's own
def test_an_arm_beside_the_back_is_no_breast() -> None:
    """The body of `scripts/check_bodies.py --seed 1` whose right arm's edge with the back rises by 30 mm."""
    pytest.importorskip("anny", reason="the model of bodies, anny, is not installed")
    random = np.random.default_rng((1, crc32(KIND.encode()), 1))
    body = Bodies().body(KINDS[KIND], random)
    points = simulate(body.vertices, body.faces, Scanner(Scanner.directions(0.4, 0.3), 120_000, 0.3, 0.01), random)
    found = body_of(points)
    assert found.front[2] > 0.9, "the body looks along z"
    assert found.up[1] > 0.9
    assert abs(found.left[0]) > 0.99
