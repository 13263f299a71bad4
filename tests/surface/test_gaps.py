from __future__ import annotations

import numpy as np
import pytest
from breasts import RADIUS, cup_frame_landmarks, cup_frame_points, write_breast, write_ply

from brafit.errors import InputError
from brafit.scan import load_scan
from brafit.surface.gaps import gaps

CENTRE = np.array([0.0, RADIUS, 0.0])
AREA = np.pi * RADIUS**2
"""Of the quarter sphere."""


def curve() -> np.ndarray:
    marks = cup_frame_landmarks()
    return np.concatenate([marks["wire"], marks["upper_line"][::-1][1:-1]])


def cap(points: np.ndarray, middle: np.ndarray, radius: float) -> np.ndarray:
    """Mask of the points of the sphere within an angle of a direction, as a length along the sphere."""
    direction = (points - CENTRE) / RADIUS
    return direction @ (middle / np.linalg.norm(middle)) > np.cos(radius / RADIUS)


def test_a_whole_breast_has_no_gap():
    points = cup_frame_points(4000)
    found = gaps(points, points, curve())
    assert (found.share, len(found.places)) == (0.0, 0)


@pytest.mark.parametrize("middle", [(1.0, 0.0, 1.0), (1.0, -0.5, 0.3), (0.4, 0.6, 1.0)])
def test_the_share_of_a_hole_and_the_sphere_in_it(middle):
    dense = cup_frame_points(12_000)
    hole = cap(dense, np.array(middle), 24.0)
    dense = dense[~hole]
    found = gaps(dense[:3000], dense, curve())
    assert found.share == pytest.approx(hole.mean(), rel=0.15)
    assert cap(found.places, np.array(middle), 24.0).all()
    assert np.abs(np.linalg.norm(found.places - CENTRE, axis=1) - RADIUS).max() < 1.0


def test_a_shadow_at_the_wire_is_bridged_from_the_wire():
    dense = cup_frame_points(12_000)
    dense = dense[~((dense[:, 2] < 18) & (dense[:, 0] > 25))]
    found = gaps(dense[:3000], dense, curve())
    assert len(found.places) > 100
    assert np.abs(np.linalg.norm(found.places - CENTRE, axis=1) - RADIUS).max() < 1.5
    assert found.places[:, 2].min() < 3.0


def test_the_bridge_mirrors_with_the_breast():
    dense = cup_frame_points(8000)
    dense = dense[~cap(dense, np.array([1.0, 0.4, 0.5]), 22.0)]
    flip = np.array([1.0, -1.0, 1.0])
    one, other = gaps(dense[:2000], dense, curve()), gaps(dense[:2000] * flip, dense * flip, curve() * flip)
    assert abs(one.share - other.share) < 0.002


def test_a_scan_says_what_it_assumes(tmp_path):
    path = write_breast(tmp_path)
    points = cup_frame_points(8000)
    write_ply(path, points[points[:, 2] > 14])
    scan = load_scan(path)
    assert scan.gap_share is not None
    assert 0.1 < scan.gap_share < 14 / RADIUS
    assert len(scan.assumed) > 100
    assert scan.points[:, 2].min() > 14 - 1e-6
    (words,) = [str(note) for note in scan.notes if note.code == "assumed_surface"]
    assert f"a surface is assumed on {100 * scan.gap_share:.0f} % of the cup" in words
    assert "standard deviations (±) take it as exact" in words
    unbridged = load_scan(path, bridge=False)
    assert not len(unbridged.assumed)
    assert "assumed_surface" not in [note.code for note in unbridged.notes]


def test_a_strip_of_a_breast_is_refused(tmp_path):
    path = write_breast(tmp_path)
    points = cup_frame_points(8000)
    write_ply(path, points[np.abs(points[:, 2] - points[:, 0]) < 8])
    with pytest.raises(InputError, match=r"^.*breast\.ply: \d\d % of the surface between wire and upper line has no "):
        load_scan(path)
