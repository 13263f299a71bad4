"""Breasts that are mirror images of each other: their proposed marks are one pair, from whatever side and file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torsos

from brafit.anatomy.apex import DENSE, about
from brafit.anatomy.body import Body
from brafit.anatomy.confidence import BOUNDS, Confidence, doubt
from brafit.anatomy.pair import Breast, are_alike, confidences, one_pair
from brafit.anatomy.torso import Proposal, body_and_trunk, proposals
from brafit.anatomy.wire_detection import FoundWire
from brafit.cloud import Cloud
from brafit.geometry.polyline import polyline_length
from brafit.scan import Scan, load_sides
from brafit.surface.symmetry import mirror_of

FILE = Path("body.ply")
FLIP = np.array([-1.0, 1.0, 1.0])
NOISE = 0.3


def trunk(left: float = 40.0) -> np.ndarray:
    """A torso with a neck and two breasts, the right one 40 mm high, with noise: no point is another one's image."""
    body = torsos.torso(left, right=40.0, n=60_000)
    neck = np.random.default_rng(1).uniform([-np.pi, 300.0], [np.pi, 420.0], (4000, 2))
    neck = np.stack([55 * np.sin(neck[:, 0]), neck[:, 1], 55 * np.cos(neck[:, 0])], axis=1)
    points = np.concatenate([body, neck])
    return points + NOISE * np.random.default_rng(2).standard_normal(points.shape)


@pytest.fixture(scope="module")
def alike() -> np.ndarray:
    return trunk()


@pytest.fixture(scope="module")
def proposed(alike) -> list[Proposal]:
    return proposals(FILE, alike)


def found_on(points: np.ndarray, proposed: list[Proposal], body: Body, lower: float = 0.0) -> list[Breast]:
    """The proposals as what was found of each breast; the left one's wire so much lower."""
    breasts = []
    for one in proposed:
        marks, shift = one.marks, np.array([0.0, -lower * (one.marks.side == "left"), 0.0])
        assert marks.wire is not None
        assert marks.upper_line is not None
        surface = about(points, marks.points["apex"], body.front, DENSE)
        strap = marks.points["strap_point"]
        wire = FoundWire(marks.wire + shift, 0.1, 0.1)
        breasts.append(Breast(marks.side, marks.points["apex"], wire, strap, marks.upper_line, surface))
    return breasts


def test_proposals_on_breasts_that_are_alike_are_mirror_images(alike, proposed):
    mirror, (left, right) = mirror_of(alike), proposed
    for one, other in zip(left.marks.positions(), right.marks.positions(), strict=True):
        np.testing.assert_allclose(mirror(one), other, atol=1e-9)
    assert left.confidence.evidence == right.confidence.evidence
    assert (left.marks.side, right.marks.side) == ("left", "right")


def test_both_sides_one_side_and_the_mirrored_file_give_one_cup(alike):
    """To round-off: nothing on this way keeps to the scan's own grid."""
    cloud = Cloud(FILE, alike, None, None)
    both = load_sides(cloud, ("left", "right"), propose=True, points=500)
    (alone,) = load_sides(cloud, ("right",), propose=True, points=500)
    flipped = load_sides(replace(cloud, points=alike * FLIP), ("left",), propose=True, points=500)
    first, *others = (scan for scan in [*both, alone, *flipped])
    assert isinstance(first, Scan)
    for scan in others:
        assert isinstance(scan, Scan)
        np.testing.assert_allclose(scan.points, first.points, atol=1e-6)
        np.testing.assert_allclose(scan.wire, first.wire, atol=1e-6)
        assert scan.neckline is not None
        assert first.neckline is not None
        np.testing.assert_allclose(scan.neckline, first.neckline, atol=1e-6)


def test_a_pair_is_the_mean_of_both_sides_and_tells_how_they_disagreed(alike, proposed):
    body, _ = body_and_trunk(alike)
    mirror, found = mirror_of(alike), found_on(alike, proposed, body, lower=20.0)
    (left, right), trusted = one_pair(mirror, body, found, confidences(body, found))
    middle = (found[0].wire.line + mirror(found[1].wire.line)) / 2
    np.testing.assert_allclose(left.wire.line, middle, atol=1e-9)
    np.testing.assert_allclose(mirror(left.upper_line), right.upper_line, atol=1e-9)
    np.testing.assert_allclose(left.upper_line[[0, -1]], left.wire.line[[0, -1]], atol=1e-6)
    for one in trusted:
        assert one.evidence["wires"] == pytest.approx(20.0, abs=0.1)
        assert "the two sides disagree: the wires are up to 20 mm from being mirror images" in doubt(one)


def test_impossible_marks_of_one_side_do_not_count_in_the_pair(alike, proposed):
    body, _ = body_and_trunk(alike)
    mirror, found = mirror_of(alike), found_on(alike, proposed, body, lower=20.0)
    trusted = confidences(body, found)
    impossible = Confidence("left", {**trusted[0].evidence, "guessed": 1.0})
    (left, right), told = one_pair(mirror, body, found, [impossible, trusted[1]])
    np.testing.assert_allclose(right.wire.line, found[1].wire.line, atol=1e-9)
    np.testing.assert_allclose(left.wire.line, mirror(found[1].wire.line), atol=1e-9)
    assert all("the two sides disagree" in doubt(one) for one in told)


def test_breasts_of_different_size_are_no_pair():
    points = trunk(left=46.0)
    body, _ = body_and_trunk(points)
    found = found_on(points, proposals(FILE, points), body)
    left = found[0]
    assert not are_alike(points, mirror_of(points), body, left.side, left.apex, left.wire.line)
    lengths = [polyline_length(breast.wire.line) for breast in found]
    trusted = confidences(body, found)
    assert [one.evidence["longer"] for one in trusted] == pytest.approx(
        [lengths[0] - lengths[1], lengths[1] - lengths[0]]
    )


def test_wires_that_differ_by_more_than_a_size_are_told_with_both_lengths():
    left = Confidence("left", {"wire": 231.0, "longer": 16.0})
    right = Confidence("right", {"wire": 215.0, "longer": -16.0})
    told = "the wires of the two sides differ by more than a size: left 231 mm, right 215 mm"
    assert told in doubt(left)
    assert told in doubt(right)
    assert BOUNDS["longer"].is_usual(14.0)
    assert doubt(Confidence("left", {"wire": 231.0, "longer": -14.0})) == ""
