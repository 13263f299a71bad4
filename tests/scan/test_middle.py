"""Cups of thick material: the middle of the material, half its thickness outside of the skin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from brafit.cloud.read import Cloud
from brafit.landmarks import Landmarks
from brafit.report.uncovered import uncovered_share
from brafit.result import Result
from brafit.run.fitting import fitted, result_of
from brafit.run.recipe import recipe_of
from brafit.samples import sample_paths
from brafit.scan import Scan, load_scan
from brafit.scan.middle import middle_of
from brafit.simulation.synthetic import quarter_sphere

RADIUS, THICKNESS = 60.0, 4.0
OUTER = RADIUS + THICKNESS / 2
MIDDLE = np.array([0.0, OUTER, 0.0])
ANGLE = np.linspace(0, np.pi, 51)


def around(radius: float, upright: bool) -> np.ndarray:
    """Half circle about MIDDLE from end to end: the wire in the plane z = 0, or the neckline in the plane x = 0."""
    out, zero = np.sin(ANGLE), 0 * ANGLE
    return MIDDLE + radius * np.stack([zero if upright else out, -np.cos(ANGLE), out if upright else zero], axis=1)


def ball() -> Scan:
    """A quarter sphere of skin on a wire of the outer radius."""
    points = quarter_sphere(4000, RADIUS, np.random.default_rng(0)).numpy() + np.array([0.0, OUTER - RADIUS, 0.0])
    wire, line = around(OUTER, upright=False), around(RADIUS, upright=True)
    line[[0, -1]] = wire[[0, -1]]
    apex = MIDDLE + RADIUS * np.array([0.5**0.5, 0.0, 0.5**0.5])
    marks = Landmarks(Path("ball"), "ball", "left", wire, line, {"strap_point": line[25], "apex": apex}, "mm")
    return load_scan(Cloud(Path("ball"), points, None, None), landmarks=marks, points=800, outliers=None, bridge=False)


def outer(places: np.ndarray) -> np.ndarray:
    """Places moved onto the outer sphere."""
    away = places - MIDDLE
    return MIDDLE + OUTER * away / np.linalg.norm(away, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def fits() -> list[Result]:
    """Of the skin with thick cloth, and of the outer sphere with thin cloth."""
    skin = ball()
    before, after = (np.linalg.norm(s.points - MIDDLE, axis=1) for s in (skin, middle_of(skin, THICKNESS)))
    np.testing.assert_allclose(after - before, THICKNESS / 2, atol=0.02)
    whole = replace(
        skin,
        **{name: outer(getattr(skin, name)) for name in ("points", "dense", "neckline", "strap_point", "apex")},
    )
    thin, thick = (recipe_of(["experiment=quick", f"pattern.cloth.thickness={t}"]) for t in (0, THICKNESS))
    cases = ((thick, skin), (thin, whole))
    return [result_of(recipe, scan, fitted(recipe, [scan])[0]) for recipe, scan in cases]


def test_thick_material_on_a_sphere_is_the_cup_of_the_sphere_half_its_thickness_larger(fits):
    thick, wanted = fits
    assert wanted.shape.distances(thick.shape.edges.reshape(-1, 3)).abs().max() < 0.1
    assert thick.figures["rms_mm"] == pytest.approx(wanted.figures["rms_mm"], abs=0.02)
    for result in (thick, wanted):  # the skin lies half the thickness inside of what either was fitted to
        from_skin = result.shape.distances(torch.as_tensor(thick.target.points)).mean()
        assert from_skin == pytest.approx(result.fit.distances.mean() - THICKNESS / 2, abs=0.1)
    for result in (thick, wanted):
        assert result.figures["wire_length_mm"] == pytest.approx(np.pi * OUTER, abs=0.05)


def test_seams_of_thick_cups_match_to_round_off(fits):
    assert fits[0].figures["seam_mismatch_mm"] < 1e-9
    assert fits[0].figures["isometry_mm"] < 1e-6
    assert fits[0].figures["twist_deg_max"] < 0.01


def test_result_says_what_the_cup_is_made_of(fits):
    thick, thin = fits
    assert thick.sources["cloth"] == "cloth 4.0 mm thick: the cup is its middle, 2.0 mm outside of the skin"
    assert "cloth" not in thin.sources
    assert all("cloth 4.0 mm thick" in p.label.whole for p in thick.patterns().pieces)
    away = np.linalg.norm(thick.target.points - MIDDLE, axis=1)
    np.testing.assert_allclose(away, RADIUS, atol=0.1)  # points stay on the skin, where they were seen
    middle = middle_of(ball(), THICKNESS).dense  # data count where the cup is, which is half the thickness outside
    assert thick.facts["uncovered_share"] == uncovered_share(thick.shape, middle)


@pytest.mark.parametrize("path", sample_paths(), ids=lambda path: path.stem)
def test_points_and_marks_of_a_breast_move_outwards(path):
    """Each point of the moved surface is half the thickness from the skin, on its outer side."""
    scan = load_scan(path)
    moved = middle_of(scan, 3.0)
    assert moved.neckline is not None
    assert scan.neckline is not None
    np.testing.assert_array_equal(moved.wire, scan.wire)
    np.testing.assert_array_equal(moved.neckline[[0, -1]], scan.neckline[[0, -1]])
    for name in ("points", "dense", "neckline"):
        before, after = getattr(scan, name), getattr(moved, name)
        away = np.linalg.norm(after - before, axis=1)
        np.testing.assert_allclose(away[1:-1], 1.5, atol=1e-9)
    for name in ("strap_point", "apex"):
        assert np.linalg.norm(getattr(moved, name) - getattr(scan, name)) == pytest.approx(1.5)
    middle = (scan.wire[0] + scan.wire[-1]) / 2
    outwards = ((moved.points - scan.points) * (scan.points - middle)).sum(axis=1)
    assert (outwards > 0).mean() > 0.99
    assert middle_of(scan, 0.0) is scan
