import numpy as np
import pytest
import shapely
from shapely import LineString

from brafit.pattern.curve import Curve, curves_through, enclosed_area, offsets


def arc(radius: float, end: float = 2.4, n: int = 200) -> np.ndarray:
    angle = np.linspace(0, end, n)
    return radius * np.stack((np.cos(angle), np.sin(angle)), -1)


def radii(curve: Curve) -> np.ndarray:
    return np.linalg.norm(curve.polyline(1e-4), axis=1)


@pytest.mark.parametrize("tolerance", [0.001, 0.01, 0.1])
def test_few_arcs_stay_within_the_tolerance(tolerance):
    curve = Curve.through(arc(80.0), tolerance)
    assert np.abs(radii(curve) - 80).max() <= tolerance
    assert len(curve.controls) <= {0.001: 4, 0.01: 3, 0.1: 2}[tolerance]
    np.testing.assert_allclose([curve.start, curve.end], arc(80.0)[[0, -1]], atol=1e-12)
    assert curve.length == pytest.approx(80 * 2.4, abs=tolerance)


def test_wavy_curve_against_its_own_samples():
    x = np.linspace(0, 200, 400)
    points = np.stack((x, 8 * np.sin(x / 9) + 0.002 * x**2), -1)
    curve = Curve.through(points)
    dense = curve.polyline(1e-4)
    gaps = np.abs(points[:, None] - dense[None]).sum(-1).argmin(1)
    step = np.diff(dense, axis=0)
    for p, k in zip(points, gaps, strict=True):  # distance from the polyline's two segments at the nearest corner
        found = []
        for i in {max(k - 1, 0), min(k, len(step) - 1)}:
            t = np.clip((p - dense[i]) @ step[i] / (step[i] @ step[i]), 0, 1)
            found.append(np.linalg.norm(dense[i] + t * step[i] - p))
        assert min(found) < 0.0105
    assert len(curve.controls) < 40


def test_arcs_join_with_a_common_tangent():
    x = np.linspace(0, 100, 300)
    curve = Curve.through(np.stack((x, 10 * np.sin(x / 12)), -1))
    leave, arrive = curve.controls[1:, 1] - curve.controls[1:, 0], curve.controls[:-1, 3] - curve.controls[:-1, 2]
    turn = np.cross(np.pad(leave, ((0, 0), (0, 1))), np.pad(arrive, ((0, 0), (0, 1))))[:, 2]
    assert np.abs(turn / np.linalg.norm(leave, axis=1) / np.linalg.norm(arrive, axis=1)).max() < 1e-9


def test_places_by_arc_length():
    curve = Curve.through(arc(80.0), 1e-4)
    for distance in (0.0, 12.5, 100.0, 80 * 2.4):
        point, tangent = curve.at(distance)
        angle = distance / 80
        np.testing.assert_allclose(point, (80 * np.cos(angle), 80 * np.sin(angle)), atol=5e-4)
        np.testing.assert_allclose(tangent, (-np.sin(angle), np.cos(angle)), atol=1e-4)


def test_parallel_of_a_circle_is_a_circle():
    curve = Curve.through(arc(80.0), 1e-4)
    for distance in (6.0, -6.0, 40.0):  # counter-clockwise: the right side is outside
        parallel = curve.offset(distance)
        assert parallel is not None
        assert np.abs(radii(parallel) - 80 - distance).max() < 0.0105


def test_parallel_beyond_the_centre_is_refused():
    curve = Curve.through(arc(10.0))
    assert curve.offset(-9.0) is not None
    assert curve.offset(-10.5) is None


def test_polyline_keeps_its_tolerance():
    curve = Curve.through(arc(80.0), 1e-5)
    for tolerance in (0.5, 0.02):
        points = curve.polyline(tolerance)
        middles = (points[1:] + points[:-1]) / 2
        assert 80 - np.linalg.norm(middles, axis=1).min() <= tolerance
        assert len(points) < 2.6 * 80 * 2.4 / np.sqrt(8 * 80 * tolerance) + 4


def test_reversed_and_mapped():
    curve = Curve.through(arc(80.0))
    back = curve.reversed().map(lambda points: 2 * points + 1)
    np.testing.assert_allclose(back.start, 2 * curve.end + 1)
    assert back.length == pytest.approx(2 * curve.length)


def test_one_point_is_no_curve():
    with pytest.raises(ValueError, match="two distinct"):
        Curve.through(np.zeros((3, 2)))


def test_curves_fitted_together_are_those_fitted_alone():
    x = np.linspace(0, 200, 400)
    lines = [arc(80.0), np.stack((x, 8 * np.sin(x / 9)), -1), np.array(((0.0, 0.0), (50.0, 10.0)))]
    together = curves_through(lines)
    for line, curve in zip(lines, together, strict=True):
        np.testing.assert_array_equal(curve.controls, Curve.through(line).controls)
    moved = offsets(together, [5.0, 40.0, 0.0])
    assert moved[1] is None, "the waves are tighter than that"
    assert moved[2] is together[2]
    alone = together[0].offset(5.0)
    assert moved[0] is not None
    assert alone is not None
    np.testing.assert_array_equal(moved[0].controls, alone.controls)


@pytest.mark.parametrize("turn", [0.5, 1.5, 2.5])
def test_sharp_bends_are_followed(turn):
    """A bend of a tenth of a millimetre, as sharp as a corner to anyone who cuts."""
    leg = np.linspace(1, 60, 60)[:, None]
    bend = 0.1 * np.stack((np.sin(angle := np.linspace(0, turn, 40)), 1 - np.cos(angle)), -1)
    points = np.vstack((-leg[::-1] * (1, 0), bend, bend[-1] + leg * (np.cos(turn), np.sin(turn))))
    curve = Curve.through(points)
    away = shapely.distance(shapely.points(points), LineString(curve.polyline(1e-5)))
    assert np.max(away) < 0.0105
    assert len(curve.controls) < 40


def test_area_within_curves():
    half, back = Curve.through(arc(80.0, np.pi), 1e-5), Curve.line((-80.0, 0.0), (80.0, 0.0))
    assert enclosed_area([half, back]) == pytest.approx(np.pi * 80**2 / 2, abs=0.01)
    assert enclosed_area([back.reversed(), half.reversed()]) == pytest.approx(-np.pi * 80**2 / 2, abs=0.01)
