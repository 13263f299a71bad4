"""Where a wire's ends usually lie, by its bottom; in the breast's frame."""

from __future__ import annotations

import numpy as np
import pytest

from brafit.anatomy.body import BREAST_FRAME, Body
from brafit.anatomy.confidence import Confidence, evidence
from brafit.anatomy.wire_ends import INNER, OUTER, lowest, off_usual, usual_ends
from brafit.surface.normals import Surface


def usual_wire(back: float) -> np.ndarray:
    """A bow (outwards, up, front) whose bottom is so far behind the bust point, and whose ends lie as usual."""
    rough = np.array([[0.0, 0.0, 0.0], [0.0, -60.0, -back], [0.0, 0.0, 0.0]])
    inner, outer = usual_ends(np.repeat(rough, 4, axis=0) @ BREAST_FRAME.T) @ BREAST_FRAME
    angle = np.linspace(0, np.pi, 41)
    share = (1 - np.cos(angle)) / 2
    line = inner + share[:, None] * (outer - inner)
    bottom = line[lowest(line[:, 1] - 90 * np.sin(angle))]
    return line + np.sin(angle)[:, None] * ([0.0, -90.0 - bottom[1], -back - bottom[2]])


@pytest.mark.parametrize("back", [20.0, 40.0, 70.0])
def test_deeper_breasts_have_their_ends_farther_back(back: float) -> None:
    level = usual_ends(np.repeat([[0.0, 0.0, 0.0], [0.0, -60.0, 0.0], [0.0, 0.0, 0.0]], 4, axis=0) @ BREAST_FRAME.T)
    np.testing.assert_allclose(level @ BREAST_FRAME, [INNER, OUTER], atol=1e-9)
    deep = usual_ends(np.repeat([[0.0, 0.0, 0.0], [0.0, -60.0, -back], [0.0, 0.0, 0.0]], 4, axis=0) @ BREAST_FRAME.T)
    assert (((deep - level) @ BREAST_FRAME)[:, 2] < -0.5 * back).all()


def test_an_end_that_runs_on_behind_the_breast_is_told() -> None:
    """Of a usual wire nothing is said; with its outer end drawn back by 45 mm, that end is, and only that."""
    right, up, front = np.eye(3)
    body = Body(right, up, front, 0.0)
    apex = np.array([100.0, 0.0, 0.0])
    wire = usual_wire(40.0)
    assert off_usual(wire @ BREAST_FRAME.T).max() < 12
    outer = np.linspace(0, 1, len(wire))[:, None]
    long = wire + np.clip(2 * outer - 1, 0, 1) ** 2 * [0.0, 0.0, -45.0]
    points = np.random.default_rng(1).normal(0, 60, (3000, 3)) + apex
    surface = Surface(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), 4.0)
    keys = ("inner_usual", "outer_usual")

    def told(line: np.ndarray) -> tuple[str, ...]:
        found = evidence(surface, body, "left", apex, line + apex)
        return Confidence("left", {key: found[key] for key in keys}).doubts

    assert told(wire) == ()
    (said,) = told(long)
    assert said.startswith("the wire's outer end is")
