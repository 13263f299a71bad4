from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from torsos import FRONT, torso, write

from brafit.scan import load_scan
from brafit.surface.cleaning import lonely
from brafit.surface.neighbours import Neighbours
from brafit.surface.normals import surface_of
from brafit.surface.symmetry import apart, mirror_of


def test_surfaces_that_are_a_known_distance_apart():
    grid = np.random.default_rng(0).uniform(-50, 50, (6000, 2))
    noise = 0.3 * np.random.default_rng(1).standard_normal(6000)
    one = surface_of(np.column_stack([grid, noise]), FRONT)
    other = surface_of(np.column_stack([grid[::-1], 1.5 + noise]), FRONT)
    inner = one.points[np.abs(one.points[:, :2]).max(axis=1) < 40]
    assert abs(apart(one, other, inner) - 1.5) < 0.1
    assert apart(one, one, inner) < 0.01


def test_alike_breasts_give_the_same_points_for_both_sides(tmp_path):
    points = torso()
    path = write(tmp_path, points)
    left, right = (load_scan(path, side=side) for side in ("left", "right"))
    assert left.cleaning.other_side > 0
    assert left.notes[0].code == "both_breasts"
    np.testing.assert_allclose(right.points, left.points, atol=1e-3)
    np.testing.assert_allclose(right.wire, left.wire, atol=1e-9)
    steps = left.cleaning
    taken = sum(getattr(steps, step.name) for step in fields(steps) if step.default == 0)
    assert steps.read == len(points)
    assert taken + steps.used == steps.read + steps.other_side


def test_breasts_that_differ_keep_their_own_points(tmp_path):
    path = write(tmp_path, torso(left=36.0))
    scan = load_scan(path)
    assert scan.cleaning.other_side == 0
    assert not [note for note in scan.notes if note.code == "both_breasts"]


def test_points_of_both_are_taken_only_if_wanted(tmp_path):
    assert load_scan(write(tmp_path, torso()), symmetry=False).cleaning.other_side == 0


def test_the_plane_goes_with_the_body_and_not_with_its_points_order():
    points = torso(n=30_000) + 0.2 * np.random.default_rng(0).standard_normal((30_000, 3))
    q = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    mirror, place = mirror_of(points), np.array([100.0, 50, 80])
    moved = mirror_of(points @ q.T + [10, -400, 90])
    np.testing.assert_allclose(moved(place @ q.T + [10, -400, 90]), mirror(place) @ q.T + [10, -400, 90], atol=1e-6)
    twice = mirror_of(np.random.default_rng(1).permutation(np.concatenate([points, points])))
    np.testing.assert_allclose(twice(place), mirror(place), atol=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.4])
def test_strays_are_lonely_however_many(share):
    generator = np.random.default_rng(0)
    grid = generator.uniform(-80, 80, (6000, 2))
    plane = np.column_stack([grid, generator.normal(0, 2.0, 6000)])
    stray = generator.uniform(-120, 120, (round(share / (1 - share) * 6000), 3))
    found = lonely(Neighbours.of(np.concatenate([plane, stray]), 17), 16)
    assert found[:6000].mean() < 0.001
    far = np.r_[np.zeros(6000, dtype=bool), np.abs(stray[:, 2]) > 20]
    assert found[far].mean() > 0.95
