"""Cups that are no likeness of their points, and what counts in figures and warnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from lunes import RADIUS, sphere_points

import brafit
from brafit.anatomy.confidence import Confidence
from brafit.errors import InputError
from brafit.fitting import CupFit, ResultCode
from brafit.landmarks.file import landmarks_path, read_landmarks
from brafit.remarks import Remark
from brafit.report.row import fitted_row
from brafit.run.fitting import fitted, target_of
from brafit.run.likeness import BOUNDS, code_of, judged, measures, seam_blamed
from brafit.run.recipe import Recipe, recipe_of
from brafit.samples import sample_paths
from brafit.scan import Scan, load_scan
from brafit.underwires.nearest import nearest_wire

QUICK = ["experiment=quick"]
MARKED = ("wire_off", "upper_off", "marks_off", "apex")
ANGLE = np.linspace(0, np.pi, 40)
WIRE = RADIUS * np.stack((np.sin(ANGLE), 1 - np.cos(ANGLE), 0 * ANGLE), -1)


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return recipe_of(QUICK)


@pytest.fixture(scope="module")
def scan() -> Scan:
    return load_scan(sample_paths()[0], points=500)


@pytest.fixture(scope="module")
def fit(recipe: Recipe, scan: Scan) -> CupFit:
    return fitted(recipe, [scan])[0]


def test_a_breasts_cup_is_a_likeness_of_it(fit: CupFit, scan: Scan) -> None:
    assert fit.code is ResultCode.CONVERGED
    found = measures(fit, scan)
    assert found.keys() == BOUNDS.keys() - {"uncovered"}  # that is asked of proposed marks only
    assert all(BOUNDS[key].usual[0] <= value <= BOUNDS[key].usual[1] for key, value in found.items())
    assert fit.figures["rms_mm"] == pytest.approx(np.sqrt(np.mean(fit.distances**2)))


def test_a_wire_of_a_size_far_from_the_own_wire_is_warned_of(fit: CupFit, scan: Scan) -> None:
    def warned(size: str) -> list[Remark]:
        laid = replace(scan, origin=replace(scan.origin, wire=f"size {size}"), own_wire=scan.wire)
        return [told for told in judged(fit, laid).warnings if told.code == "chosen_wire_far"]

    near = str(nearest_wire(scan.wire).wire.name)
    assert not warned(near)
    (told,) = warned("orange:52")
    assert f"nearest to that, of those sold, is {near}" in told.text


@pytest.mark.parametrize("key", BOUNDS)
def test_what_is_unusual_is_warned_of_and_what_is_impossible_fails(fit: CupFit, scan: Scan, key: str) -> None:
    length = np.linalg.norm(np.diff(scan.wire, axis=0), axis=1).sum()

    def with_value(value: float) -> tuple[CupFit, Scan]:
        if key in ("rms", "p95", "max"):
            return replace(fit, figures=fit.figures | {f"{key}_mm": value * length}), scan
        if key == "wire":
            return fit, replace(scan, wire=scan.wire * (value / length))
        if key == "gap":
            return fit, replace(scan, gap_share=value)
        if key == "uncovered":  # points taken away from the inner end on, until so much of the cup has none
            along = scan.dense[scan.dense[:, 1].argsort()]
            cut = (replace(scan, dense=along[k:], confidence=Confidence("left", {})) for k in range(0, len(along), 100))
            return fit, next(less for less in cut if measures(fit, less)["uncovered"] > value)
        if key.endswith("_off"):
            name = {"wire_off": "wire", "upper_off": "upper_line", "marks_off": "landmarks.strap_point"}[key]
            return fit, replace(scan, away={**scan.away, name: value * length})
        if key == "apex":
            assert scan.apex is not None
            return fit, replace(scan, apex=scan.apex * [1, 1, value * scan.dense[:, 2].max() / scan.apex[2]])
        points = scan.points.copy()
        if key == "depth":
            points[:, 2] *= value * length / points[:, 2].max()
        else:
            points[: round(value * len(points)), 2] = -0.1 * length
        return fit, replace(scan, points=points)

    usual, possible = BOUNDS[key].usual, BOUNDS[key].possible
    warned = judged(*with_value(1.2 * usual[1]))
    assert warned.code is fit.code
    (new,) = (told for told in warned.warnings if told.code == code_of(key))
    assert new.remedy == BOUNDS[key].remedy
    if key == "marks_off":
        assert new.text.startswith("the marked strap point is ")
    if np.isfinite(possible[1]):
        failed = judged(*with_value(1.2 * possible[1]))
        assert failed.code is ResultCode.UNLIKE
        row = fitted_row(failed, "left", 500, {}, True)
        assert row["status"] == "failed"
        assert row["reason"].startswith("no likeness of the points: ")
        assert BOUNDS[key].remedy in row["reason"]


def test_marks_that_are_off_the_skin_are_warned_of() -> None:
    """Marks in front of the skin, a wire that runs on into the air, a bust point at the foot of the breast."""

    def unlike(**changes) -> set[str]:
        scan = load_scan(path, landmarks=replace(own, **changes), points=300)
        (found,) = fitted(recipe_of(QUICK), [scan])
        return {told.code for told in found.warnings} & {f"unlike_{key}" for key in MARKED}

    path = sample_paths()[1]
    own = read_landmarks(landmarks_path(path))
    assert own.wire is not None
    assert not unlike()
    normal = np.linalg.svd(own.wire - own.wire.mean(axis=0))[2][2]
    moved = own.mapped(lambda places: places + 14 * normal)
    assert unlike(wire=moved.wire, upper_line=moved.upper_line, points=moved.points) >= {"unlike_wire_off"}
    onward = own.wire[-1] + np.outer(np.linspace(3, 60, 20), own.wire[-1] - own.wire[-2]) / 4
    assert unlike(wire=np.concatenate([own.wire, onward]), upper_line=None, points={}) == {"unlike_wire_off"}
    foot = {**own.points, "apex": own.points["wire_bottom"] + [0, 2, 9.0]}
    assert unlike(points=foot) == {"unlike_apex"}


def test_a_failed_fit_keeps_its_own_reason(fit: CupFit, scan: Scan) -> None:
    failed = replace(fit, code=ResultCode.DIVERGED, figures=fit.figures | {"rms_mm": 1e3})
    assert judged(failed, scan) is failed


def test_a_cup_that_is_not_regular_says_first_that_its_points_are_no_breast(fit: CupFit, scan: Scan) -> None:
    bent = replace(fit, code=ResultCode.UNRESOLVED, reason="not a cup of developable panels: the margin is 0.1")
    assert judged(bent, scan) is bent
    told = judged(replace(bent, figures=fit.figures | {"rms_mm": 40.0}), scan)
    assert told.code is ResultCode.UNRESOLVED
    assert told.reason.startswith("no likeness of the points: ")
    assert told.reason.endswith(". not a cup of developable panels: the margin is 0.1")


def test_points_on_a_box_are_refused() -> None:
    random = np.random.default_rng(0)
    points = random.uniform(0, 1, (3000, 3))
    face = random.integers(0, 3, len(points))
    points[np.arange(len(points)), face] = random.integers(0, 2, len(points))
    box = (points - (0.1, 0.5, 0.1)) * 2.5 * RADIUS + (0, RADIUS, 0)
    with pytest.raises(InputError, match=r"no likeness of the points|nowhere near"):
        brafit.fit(box, wire=WIRE, inside=np.ones(len(box)), settings=["experiment=quick"])


def test_assumed_places_count_in_no_figure_and_no_warning(recipe: Recipe) -> None:
    """Bad ones, which no cup comes near, beside points that lie on a cup."""
    points = sphere_points(300)[0]
    none = {"neckline": None, "strap_point": None, "apex": None}
    scan = replace(load_scan(sample_paths()[0], points=300), points=points, wire=WIRE, gap_share=0.05, **none)
    places = np.random.default_rng(0).uniform((0, 0, 0), (0.5 * RADIUS, 2 * RADIUS, 0.5 * RADIUS), (60, 3))
    told = target_of(replace(scan, assumed=places))
    assert told.weights is not None
    assert len(told.weights) == 360
    told = replace(told, weights=np.repeat((1.0, 1e-6), (300, 60)))  # so that the cup does not follow them
    seen = []
    (fit,) = recipe.fit([told], seen.append)
    assert len(fit.distances) == 300
    assert fit.figures["max_mm"] == pytest.approx(np.abs(fit.distances).max())
    assert (fit.shape.distances(torch.as_tensor(places)).abs() > 5).double().mean() > 0.5
    assert (np.abs(fit.distances) > 5).mean() < 0.05
    assert "far_points" not in {told.code for told in fit.warnings}
    # what the steps tell on the way is of the scan's own points too
    assert seen[-1].terms["rms_mm"][0].item() == pytest.approx(fit.figures["rms_mm"], rel=0.05)


def test_a_seam_that_costs_much_is_named_as_the_cause(fit: CupFit) -> None:
    """Else the user would look for strays in a good scan."""
    far, edge, other = (Remark(code_of(key), "it is so", remedy=BOUNDS[key].remedy) for key in ("rms", "max", "wire"))
    free, through = (replace(fit, warnings=told) for told in ((other,), (far, edge, other)))
    (told, again, kept) = seam_blamed(through, free).warnings
    assert (told.code, told.text) == (far.code, far.text)
    assert "condition.seam=closest" in told.remedy
    assert "the seam through the bust point" in again.remedy
    assert "condition.seam" not in again.remedy, "once is enough"
    assert kept == other
    many = Remark("far_points", "many are", remedy="more panels follow it closer")
    (told,) = seam_blamed(replace(fit, warnings=(many,)), free).warnings
    assert "condition.seam=closest" in told.remedy
    alone = replace(fit, warnings=(far,))
    assert seam_blamed(alone, alone).warnings == (far,)  # the closest cup is as far
    often = replace(fit, warnings=(many,), distances=np.repeat((6.0, 0.0), (30, 70)))
    seldom = replace(often, distances=np.repeat((6.0, 0.0), (10, 90)))
    (told,) = seam_blamed(often, seldom).warnings
    assert told.remedy.startswith("the seam through the bust point costs most of that: take more panels")
    assert seam_blamed(often, often).warnings == (many,)
    worse = replace(fit, code=ResultCode.UNLIKE, reason="the scan's fault", faults=(far,))
    assert "condition.seam=closest" in seam_blamed(worse, free).reason, "a fit that failed for it"
    assert "brafit-inspect" not in seam_blamed(worse, free).reason, "the scan is good"
    assert seam_blamed(worse, replace(fit, code=ResultCode.UNLIKE)).reason == "the scan's fault"


def test_points_that_are_far_for_noise_are_no_reason_for_more_panels(fit: CupFit, scan: Scan) -> None:
    far = replace(fit, warnings=(Remark("far_points", "many are", remedy="more panels follow it closer"),))
    rough = replace(scan, cleaning=replace(scan.cleaning, scatter_mm=2.3))
    assert "more panels" in judged(far, scan).warnings[0].remedy
    assert "scatter by 2.3 mm" in judged(far, rough).warnings[0].remedy
