"""What is front and what is back of bodies whose arms hang beside them."""

from __future__ import annotations

from zlib import crc32

import numpy as np
import pytest

from brafit.anatomy.body import Body
from brafit.anatomy.torso import FAR_OUT, RISEN, _rise, body_of
from brafit.simulation.bodies import KINDS, Bodies
from brafit.simulation.scanner import Scanner, simulate
from brafit.surface.normals import Surface

KIND = "whole, arms hanging"
FRONT = np.array([0.0, 0.0, 1.0])


def test_a_mound_counts_less_the_farther_it_is_beside_the_trunk() -> None:
    """A sphere's cap at three places: a breast's, the last one of breasts, and where an arm begins."""
    directions = np.random.default_rng(0).standard_normal((6000, 3))
    sphere = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    sphere = sphere[sphere[:, 2] > 0]
    body = Body(np.array([1.0, 0, 0]), np.array([0.0, 1, 0]), np.array([0.0, 0, 1]), 0.0)

    def counted(out: float) -> float:
        place = np.array([out, 0.0, 0.0])
        return _rise(body, "left", place + 50 * FRONT, Surface(place + 50 * sphere, sphere, 2.0))

    assert counted(100.0) == counted(FAR_OUT) == RISEN
    assert counted(FAR_OUT + 9) == pytest.approx(RISEN - 9)


@pytest.mark.slow
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
