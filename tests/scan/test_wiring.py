"""Wires that are found or laid on a body with two breasts: mirror images where the breasts are, else each its own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from torsos import mark, torso, write

from brafit.geometry.polyline import polyline_length
from brafit.landmarks import landmarks_path
from brafit.scan import Scan, load_sides
from brafit.surface.symmetry import mirror_of

NOISE = 0.2


def noisy(right: float) -> np.ndarray:
    """A torso of which no point is the image of another."""
    points = torso(40.0, n=40_000, right=right)
    return points + NOISE * np.random.default_rng(3).standard_normal(points.shape)


def loaded(path: Path, sides: tuple[str, ...] = ("left", "right"), **settings) -> list[Scan]:
    scans = load_sides(path, sides, points=500, **settings)
    assert all(isinstance(scan, Scan) for scan in scans), scans
    return [scan for scan in scans if isinstance(scan, Scan)]


def line_of(scan: Scan) -> np.ndarray:
    return scan.frame.to_scan(scan.wire)


def told(scan: Scan, code: str) -> list[str]:
    return [str(note) for note in scan.notes if note.code == code]


@pytest.fixture(scope="module")
def alike(tmp_path_factory):
    return write(tmp_path_factory.mktemp("alike"), noisy(40.0))


@pytest.fixture(scope="module")
def unlike(tmp_path_factory):
    return write(tmp_path_factory.mktemp("unlike"), noisy(52.0))


@pytest.mark.parametrize("wire", ["detect", "65x190"])
def test_alike_breasts_get_mirror_images_from_whatever_side(alike, wire):
    mirror = mirror_of(np.load(alike))
    left, right = loaded(alike, wire=wire)
    np.testing.assert_allclose(mirror(line_of(left)), line_of(right), atol=1e-6)
    assert right.apex is not None
    for side, both in (("left", left), ("right", right)):
        (alone,) = loaded(alike, (side,), wire=wire)
        np.testing.assert_allclose(line_of(alone), line_of(both), atol=1e-9)
    assert not told(left, "own_wires")


def test_a_wire_of_a_size_keeps_its_size_on_both_breasts(alike):
    for scan in loaded(alike, wire="65x190"):
        assert polyline_length(scan.wire) == pytest.approx(190.0, abs=0.02)


def test_unlike_breasts_keep_wires_of_their_own_and_are_told(unlike):
    mirror = mirror_of(np.load(unlike))
    left, right = loaded(unlike, wire="detect")
    assert np.abs(mirror(line_of(left)) - line_of(right)).max() > 1.0
    for scan in (left, right):
        (words,) = told(scan, "own_wires")
        for side, own in (("left", left), ("right", right)):
            assert f"{side} {polyline_length(own.wire):.0f} mm long" in words


def test_marks_of_both_sides_that_are_no_images_of_each_other_keep_their_own_wires(alike, tmp_path):
    points = np.load(alike)
    breasts = [
        {"side": side, "landmarks": {"apex": mark(points, x, y).tolist(), "strap_point": mark(points, x, 120).tolist()}}
        for side, x, y in (("left", 75, 40), ("right", -75, 48))
    ]
    path = tmp_path / "both.npy"
    np.save(path, points)
    landmarks_path(path).write_text(json.dumps({"breasts": breasts}))
    for scan in loaded(path):
        assert scan.origin.wire == "detected"
        assert scan.apex is not None
        given = breasts[0 if scan.side == "left" else 1]["landmarks"]["apex"]
        np.testing.assert_allclose(scan.frame.to_scan(scan.apex), given, atol=1e-6)


def test_a_side_that_is_not_marked_is_named_with_the_one_that_is(alike):
    left, right = loaded(alike)
    assert (left.origin.wire, right.origin.wire) == ("given", "mirrored")
    assert not told(left, "guessed_marks")
    (words,) = told(right, "guessed_marks")
    assert "the right breast is not marked: its landmarks and wire are the left one's, mirrored" in words
    _, right = loaded(alike, wire="detect")
    assert "its landmarks are the left one's, mirrored, its wire detected" in told(right, "guessed_marks")[0]
