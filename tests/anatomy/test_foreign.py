"""What a scan holds beside a body is told where no breast is found on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from breasts import write_ply

from brafit.anatomy.foreign import foreign_cause
from brafit.errors import InputError
from brafit.scan import load_scan


def body(n: int = 6000) -> np.ndarray:
    """An elliptic cylinder without breasts, of a torso's size."""
    random = np.random.default_rng(0)
    angle, height = random.uniform(0, 2 * np.pi, n), random.uniform(900, 1500, n)
    return np.stack([160 * np.cos(angle), height, 110 * np.sin(angle)], axis=1)


def floor(n: int = 2000) -> np.ndarray:
    return np.random.default_rng(1).uniform((-700, 890, -700), (700, 892, 700), (n, 3))


def test_a_body_alone_has_nothing_beside_it() -> None:
    assert foreign_cause(body()) is None
    strays = np.random.default_rng(2).uniform(-3000, 3000, (200, 3))
    assert foreign_cause(np.concatenate([body(), strays])) is None


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5])
def test_a_floor_is_told(share: float) -> None:
    points = np.concatenate([body(6000), floor(round(6000 * share / (1 - share)))])
    cause, remedy = foreign_cause(points) or ("", "")
    told, rest = cause.split(" ", 1)
    assert (rest, remedy) == ("% of its points lie in one plane, as of a floor or a wall", "Cut the plane off")
    assert abs(int(told) - 100 * share) <= 2


def test_two_bodies_are_told(tmp_path: Path) -> None:
    points = np.concatenate([body(4000), body(6000) + np.array([700, 0, 0])])
    cause = "it falls apart into parts with 60 % and 40 % of its points, as of two bodies"
    assert foreign_cause(points) == (cause, "Leave one body in each file")
    with pytest.raises(InputError, match=f"no breast was found, and {cause}. Leave one body in each file, or mark it"):
        load_scan(write_ply(tmp_path / "a.ply", points), propose=True, units="mm")
