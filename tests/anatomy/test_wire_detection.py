"""Wires found in creases whose place is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from brafit.anatomy.body import PROTRUDING, Body
from brafit.anatomy.crease_sections import folds, rim
from brafit.anatomy.torso import apex_of
from brafit.anatomy.wire_detection import ABOVE, BODY_UP, concavity, laid, plainness, trace
from brafit.geometry.polyline import evenly_spaced
from brafit.samples import sample_paths
from brafit.scan import load_scan
from brafit.surface.cropping import facing, neckline_over
from brafit.surface.normals import Surface, surface_of
from brafit.underwires.sizes import wire_size

FRONT = np.array([0.0, 0.0, 1.0])
RADIUS = 65.0


def ball_on_a_chest(noise: float = 0.3) -> Surface:
    """The breast frame's half ball on a plane: the crease is the circle of RADIUS about the z axis at z = -RADIUS."""
    random = np.random.default_rng(0)
    flat = random.uniform(-150, 150, (16_000, 2))
    flat = flat[np.linalg.norm(flat, axis=1) > RADIUS]
    ball = random.standard_normal((9_000, 3))
    ball *= RADIUS / np.linalg.norm(ball, axis=1, keepdims=True)
    ball[:, 2] = np.abs(ball[:, 2])
    points = np.concatenate([np.column_stack([flat, np.zeros(len(flat))]), ball]) - [0, 0, RADIUS]
    return surface_of(points + noise * random.standard_normal(points.shape), FRONT)


def off_circle(line: np.ndarray) -> np.ndarray:
    return np.hypot(np.linalg.norm(line[:, :2], axis=1) - RADIUS, line[:, 2] + RADIUS)


@pytest.mark.parametrize("slope", [0.15, 0.6, 2.0])
def test_the_bottom_of_a_fold_is_found(slope):
    random = np.random.default_rng(1)
    flat = random.uniform(-90, 90, (20_000, 2))
    height = slope * np.abs(np.linalg.norm(flat, axis=1) - RADIUS)
    points = np.column_stack([flat, height]) + 0.2 * random.standard_normal((len(flat), 3))
    surface = surface_of(points, FRONT)
    angle = np.linspace(-1.2, 1.2, 30)
    beside = (RADIUS + 5) * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    places = beside
    for _ in range(2):
        places, strengths = folds(surface, places, 9.0)
    away = np.linalg.norm(places[:, :2], axis=1) - RADIUS, places[:, 2]
    assert np.median(np.abs(away[0])) < 1.0
    assert np.median(np.abs(away[1])) < 2.0, "the bell fills the bottom of a V"
    assert np.median(strengths) == pytest.approx(slope, rel=0.5)


def test_a_plane_has_no_fold():
    flat = np.random.default_rng(1).uniform(-60, 60, (8_000, 2))
    surface = surface_of(np.column_stack([flat, np.zeros(len(flat))]), FRONT)
    line = np.stack([np.zeros(20), np.linspace(-40, 40, 20), np.zeros(20)], axis=1)
    assert np.abs(folds(surface, line, 9.0)[1]).max() < 0.01


def test_strays_do_not_move_the_line():
    random = np.random.default_rng(2)
    angle = np.linspace(-1.6, 1.6, 80)
    truth = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0.1 * RADIUS * np.cos(angle)], axis=1)
    places = truth + 0.3 * random.standard_normal(truth.shape)
    places[::7] += [0, 0, 12.0]
    line = rim(places, np.ones(80))
    away = np.asarray(KDTree(evenly_spaced(line, 2000)).query(truth[5:-5])[0])
    assert away.max() < 1.5
    assert np.median(away) < 0.5


def test_the_wire_of_a_ball_on_a_chest():
    wire = trace(ball_on_a_chest()).line
    assert off_circle(wire).max() < 4
    assert np.sqrt((off_circle(wire) ** 2).mean()) < 1.5
    assert wire[0, 1] < 0 < wire[-1, 1]
    assert abs((wire[[0, -1]] @ BODY_UP).mean() - ABOVE) < 1.5, "the ends are above the apex, the origin, by the rule"


def test_how_plain_a_crease_is_needs_no_wire():
    surface = ball_on_a_chest()
    assert plainness(surface) == pytest.approx(trace(surface).hollow, rel=0.1)
    flat = np.random.default_rng(1).uniform(-150, 150, (16_000, 2))
    assert plainness(surface_of(np.column_stack([flat, np.full(len(flat), -RADIUS)]), FRONT)) < 0.02


def test_concavity_at_some_points_is_that_of_all():
    surface = ball_on_a_chest()
    chosen = np.arange(0, len(surface.points), 37)
    np.testing.assert_allclose(concavity(surface, 12.0, chosen), concavity(surface, 12.0)[chosen], atol=1e-12)


@pytest.mark.parametrize(("size", "off"), [("65x190", 1.5), ("65x230", 2.5)])
def test_a_wire_of_a_size_lies_in_the_crease(size, off):
    """The first is an arc of the crease's circle, the other one a U, which no circle is."""
    arc = wire_size(size).line(51)
    found = laid(trace(ball_on_a_chest()), arc).line
    assert np.sqrt((off_circle(found) ** 2).mean()) < off
    lengths = np.linalg.norm(found[:, None] - found, axis=2) - np.linalg.norm(arc[:, None] - arc, axis=2)
    assert np.abs(lengths).max() < 1e-9, "it is not bent"


def test_what_a_wire_of_a_wrong_size_has_beside_the_crease_counts_as_guessed():
    crease = trace(ball_on_a_chest())
    guessed = [laid(crease, wire_size(size).line(51)).guessed for size in ("65x200", "44", "60")]
    assert guessed[0] == pytest.approx(crease.guessed, abs=0.03)
    assert guessed[0] < guessed[1] < guessed[2] < 1
    assert guessed[2] > 0.4


def test_a_neckline_is_two_sections_of_the_surface():
    surface = ball_on_a_chest(noise=0.0)
    surface = surface.select(surface.points[:, 2] > 2 - RADIUS)
    angle = np.linspace(-2, 2, 41)
    wire = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), 0 * angle - RADIUS], axis=1)
    front = facing(wire, FRONT)
    assert abs(front @ [0, 1, 0]) < 1e-9
    assert np.degrees(np.arctan2(front[0], front[2])) == pytest.approx(14.5)
    strap = RADIUS * np.array([-0.8, 0.1, np.sqrt(1 - 0.65) - 1])
    line = neckline_over(surface, wire[0], strap, wire[-1], front)
    inside_out = Surface(surface.points, -surface.normals, surface.spacing)
    np.testing.assert_array_equal(neckline_over(inside_out, wire[0], strap, wire[-1], front), line)
    np.testing.assert_allclose(line[[0, 20, 40]], [wire[0], strap, wire[-1]], atol=1e-9)
    for half in (line[:21], line[20:]):
        across = np.cross(half[-1] - half[0], front)
        np.testing.assert_allclose((half - half[0]) @ across / np.linalg.norm(across), 0, atol=1e-9)
        assert np.abs(np.linalg.norm(half[3:-3] + RADIUS * FRONT, axis=1) - RADIUS).max() < 1.5


@pytest.mark.parametrize("path", sample_paths()[:2], ids=lambda path: path.stem)
def test_the_wires_of_the_samples_are_found_again(path):
    given, found = load_scan(path), load_scan(path, wire="detect")
    truth = evenly_spaced(given.frame.to_scan(given.wire), 2000)
    away = np.asarray(KDTree(truth).query(evenly_spaced(found.frame.to_scan(found.wire), 200))[0])
    assert np.sqrt((away**2).mean()) < 3.0


@pytest.mark.parametrize("hole", [0.0, 10.0])
def test_the_bust_point_of_a_bump_on_a_torso(hole):
    """Two balls with nipples on a torso: it is found under noise and strays, and beside a hole."""
    random = np.random.default_rng(3)
    angle, height = random.uniform(0, 2 * np.pi, 60_000), random.uniform(-300, 300, 60_000)
    points = np.column_stack([150 * np.sin(angle), height, 100 * np.cos(angle)])
    ball = random.standard_normal((8_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    nipple = PROTRUDING / np.linalg.norm(PROTRUDING)
    ball *= 60 + 4 * np.exp(-(((ball - nipple) ** 2).sum(axis=1)[:, None]) / (2 * 0.12**2))
    middle = np.array([80.0, 0.0, 75.0])
    truth = middle + 64 * nipple
    for sign in (1, -1):
        outside = (ball[:, 2] > 0) & ((middle + ball)[:, 2] > 60)
        points = np.concatenate([points, (middle + ball[outside]) * [sign, 1, 1]])
    points += 0.4 * random.standard_normal(points.shape)
    points = np.concatenate([points, random.uniform(-300, 300, (500, 3))])
    points = points[np.linalg.norm(points - truth - [0, -12, 0], axis=1) > hole]
    body = Body(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), FRONT, 0.0)
    assert np.linalg.norm(apex_of(points, body, "left") - truth) < 6
