from __future__ import annotations

import numpy as np
import pytest
from breasts import cup_frame_points

from brafit.surface.thickness import fills_a_volume, thickness


def ball(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal((n, 3))
    return 65 * direction / np.linalg.norm(direction, axis=1, keepdims=True) * rng.uniform(0, 1, (n, 1)) ** (1 / 3)


def test_a_plane_has_none_and_a_solid_is_as_thick_as_wide():
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 100, (2000, 2)), np.zeros(2000)])
    assert thickness(flat) == pytest.approx(0, abs=1e-9)
    assert thickness(rng.uniform(0, 100, (8000, 3))) > 0.7


@pytest.mark.parametrize("n", [40, 300, 5000])
def test_a_surface_is_told_from_what_fills_a_volume(n):
    surface = cup_frame_points(n)
    noise = np.random.default_rng(1).standard_normal((n, 3))
    assert not fills_a_volume(surface)
    assert not fills_a_volume(surface + 2 * noise)
    assert fills_a_volume(ball(n))
    assert fills_a_volume(30 * noise)


def test_it_depends_on_neither_place_nor_size():
    points = cup_frame_points(500)
    assert thickness(7 * points + 1000) == pytest.approx(thickness(points), rel=1e-6)


def test_few_points_and_one_place_are_no_error():
    assert not fills_a_volume(np.zeros((5, 3)))
    assert not fills_a_volume(np.zeros((50, 3)))
