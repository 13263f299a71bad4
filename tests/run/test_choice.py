"""The fewest panels that keep a tolerance, and a seam through the bust point with its price."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import brafit
from brafit.cup import StripsCup, Wire
from brafit.errors import ConfigError
from brafit.fitting import CupFit, ResultCode, Step, fit_targets
from brafit.fitting import objective as objectives
from brafit.fitting.lm import LM
from brafit.fitting.loop import starting_problems
from brafit.fitting.measure import measured_cups
from brafit.run.choice import chosen
from brafit.run.course import Course
from brafit.run.fitting import fitted, result_of, target_of
from brafit.run.recipe import Recipe, recipe_of
from brafit.samples import sample_paths
from brafit.scan import Scan, load_scan

QUICK = ["experiment=quick"]


@pytest.fixture(scope="module")
def scans() -> list[Scan]:
    return [load_scan(path, points=500) for path in sample_paths()]


@pytest.fixture(scope="module")
def fit(scans: list[Scan]) -> CupFit:
    return fitted(recipe_of(QUICK), scans[:1])[0]


class Known:
    """Fits of known RMS by number of panels, scan by scan; 0: no cup."""

    def __init__(self, fit: CupFit, table: Sequence[Sequence[float]]):
        self.fit, self.table = fit, table
        self.asked: list[tuple[int, list[int]]] = []

    def __call__(self, recipe: Recipe, places: Sequence[int], name: str) -> list[CupFit]:
        assert isinstance(recipe.cup, partial)
        count = recipe.cup.keywords["panels"]
        self.asked.append((count, list(places)))
        return [self._fit(count, self.table[k][count - 2]) for k in places]

    def _fit(self, count: int, rms: float) -> CupFit:
        code = ResultCode.CONVERGED if rms else ResultCode.UNRESOLVED
        figures = self.fit.figures | {"rms_mm": rms or 0.1, "seam_to_apex_mm": 5.0}
        return replace(self.fit, code=code, figures=figures, panels=[self.fit.panels[0]] * count, seconds=1.0)


def test_the_fewest_panels_that_keep_the_tolerance(fit: CupFit) -> None:
    known = Known(
        fit,
        [
            [1.4, 1.0, 9.0, 9.0, 9.0],  # 2 do
            [2.9, 1.5, 1.2, 9.0, 9.0],  # 3 do, on the limit
            [0.0, 2.0, 1.6, 1.1, 0.8],  # 2 make no cup, 5 do
            [4.0, 3.0, 2.0, 2.5, 1.0],  # none does, 4 come closest
            [3.0, 1.2, 0.0, 9.0, 9.0],  # 3 do, 4 make no cup
        ],
    )
    fits = chosen(recipe_of(["cup.panels=auto", "cup.tolerance=1.5"]), 5, known)
    assert [len(one.panels) for one in fits] == [2, 3, 5, 4, 3]
    assert [one.choice["panels"] for one in fits] == [
        "2 panels: 1.40 mm; 3 would bring 1.00 mm",
        "3 panels: 1.50 mm; 4 would bring 1.20 mm",
        "5 panels: 1.10 mm; 6 would bring 0.80 mm",
        "4 panels: 2.00 mm; 5 would bring 2.50 mm",
        "3 panels: 1.20 mm; 4 would make no cup",
    ]
    assert fits[2].choice["rms_mm_by_panels"] == {"2": None, "3": 2.0, "4": 1.6, "5": 1.1, "6": 0.8}
    warned = [[told for told in one.warnings if told.code == "tolerance_missed"] for one in fits]
    assert [len(told) for told in warned] == [0, 0, 0, 1, 0]
    missed = "no cup of 2 to 5 panels keeps cup.tolerance=1.5: 4 come closest, with 2.00 mm RMS"
    assert str(warned[3][0]) == f"{missed}; cup.tolerance=2 is kept, or set cup.panels=6: 1.00 mm"
    assert known.asked == [(2, [0, 1, 2, 3, 4]), (3, [0, 1, 2, 3, 4]), (4, [1, 2, 3, 4]), (5, [2, 3]), (6, [2, 3])]
    assert [one.seconds for one in fits] == [2, 3, 5, 5, 3]


def test_what_a_missed_tolerance_is_told(fit: CupFit) -> None:
    """Only what was reached is advised: the tolerance that the closest cup keeps, and one panel more where it helps."""
    known = Known(fit, [[2.0, 1.5, 1.2, 0.7531, 0.4], [2.0, 1.5, 1.2, 0.7531, 0.6], [0.0, 0.0, 0.0, 0.0, 0.0]])
    fits = chosen(recipe_of(["cup.panels=auto", "cup.tolerance=0.5"]), 3, known)
    told = [[str(one) for one in each.warnings if one.code == "tolerance_missed"] for each in fits]
    missed = "no cup of 2 to 5 panels keeps cup.tolerance=0.5"
    reached = f"{missed}: 5 come closest, with 0.75 mm RMS; cup.tolerance=0.76 is kept"
    assert told == [[f"{reached}, or set cup.panels=6: 0.40 mm"], [reached], [f"{missed}: none of them makes a cup"]]


def test_the_price_is_that_of_cups_with_as_many_panels(fit: CupFit) -> None:
    known = Known(fit, [[1.4, 1.0, 1.0], [2.9, 1.5, 1.2]])
    fits = chosen(recipe_of(["cup.panels=auto", "condition.seam=apex"]), 2, known)
    assert known.asked[-2:] == [(2, [0]), (3, [1])]
    assert fits[1].choice["seam_price"] == {"rms_mm": 1.5, "closest_rms_mm": 1.5, "closest_seam_to_apex_mm": 5.0}


def test_panels_by_tolerance_as_the_command_fits_them(scans: list[Scan]) -> None:
    """Batched, each scan with its own number; the same as with that number given, and rows that say it."""
    auto = recipe_of([*QUICK, "cup.panels=auto"])
    assert auto.model["panels"] is None
    found = fitted(auto, scans[:2])
    assert [len(one.panels) for one in found] == [2, 3]
    (three,) = fitted(recipe_of([*QUICK, "cup.panels=3"]), scans[1:2])
    assert three.parameters == found[1].parameters
    result, rms = result_of(auto, scans[1], found[1]), three.figures["rms_mm"]
    assert result.row()["panels"] == 3
    assert result.facts["notes"][-1].startswith(f"{scans[1].name}: 3 panels: {rms:.2f} mm; 4 would bring ")


def test_a_seam_through_the_bust_point_and_its_price(scans: list[Scan]) -> None:
    closest, through = (
        fitted(recipe_of([*QUICK, f"condition.seam={seam}"]), scans[:1])[0] for seam in ("closest", "apex")
    )
    assert closest.figures["seam_to_apex_mm"] > 5
    assert through.figures["seam_to_apex_mm"] < 1
    assert through.figures["rms_mm"] > closest.figures["rms_mm"]
    price = through.choice["seam_price"]
    assert price["closest_rms_mm"] == closest.figures["rms_mm"]
    assert price["closest_seam_to_apex_mm"] == closest.figures["seam_to_apex_mm"]
    (note,) = through.notes
    assert (note.code, note.about) == ("seam_price", through.name)
    assert f"{through.figures['rms_mm']:.2f} mm RMS; without it {price['closest_rms_mm']:.2f}" in note.text


def test_of_several_ridges_the_best_runs_through_the_bust_point(scans: list[Scan]) -> None:
    """With 4 panels it is not the one that comes to lie nearest by itself: each in turn shows which it is."""
    recipe = recipe_of([*QUICK, "cup.panels=4", "condition.seam=apex"])
    (target,) = targets = [target_of(scans[2])]
    (found,) = fit_targets(targets, recipe.cup, recipe.solver, recipe.condition)
    assert found.figures["seam_to_apex_mm"] <= 1
    wires = Wire.stack([Wire.from_polyline(target.wire)])
    problems = starting_problems(targets, wires, recipe.cup, recipe.condition, 1, trials=3)
    solution = LM([replace(stage, keep=None) for stage in recipe.solver.stages]).solve(
        problems, problems.cup.flatten().detach(), None
    )
    problems.cup.load_flat(solution.flat)
    each = [one.figures for one in measured_cups(problems.cup, targets * 3)]
    assert problems.ridges is not None
    assert sorted(problems.ridges.tolist()) == [1, 2, 3]
    best = min(one["rms_mm"] for one in each if one["seam_to_apex_mm"] <= 1)
    assert found.figures["rms_mm"] == pytest.approx(best, rel=1e-3)
    assert each[0]["rms_mm"] > 1.1 * best  # the ridge that starts nearest


def test_a_pull_that_is_too_weak_is_raised(scans: list[Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectives, "SEAM", 0.1)
    recipe = recipe_of(QUICK)
    cup, solver = partial(StripsCup, terms=6), recipe.solver
    soft, firm = (
        fit_targets([target_of(scans[1])], cup, solver, replace(recipe.condition, seam=seam, ridge_apex=0.1))[0]
        for seam in ("closest", "apex")
    )
    assert soft.figures["seam_to_apex_mm"] > 2
    assert firm.figures["seam_to_apex_mm"] <= 1


def test_the_stronger_the_pull_the_nearer_the_seam_and_the_farther_the_points(scans: list[Scan]) -> None:
    """As it is where each weight's best cup is found."""
    recipe = recipe_of(QUICK)
    told = [target_of(scans[2])]
    weights = (0.02, 0.2, 2.0)
    runs = [
        fit_targets(told, recipe.cup, recipe.solver, replace(recipe.condition, ridge_apex=weight)) for weight in weights
    ]
    for fits in zip(*runs, strict=True):
        gaps, sizes = ([one.figures[key] for one in fits] for key in ("seam_to_apex_mm", "rms_mm"))
        assert gaps == sorted(gaps, reverse=True)
        assert sizes == sorted(sizes)


def test_an_unmarked_bust_point_is_the_scans_farthest_point_and_is_said_so(scans: list[Scan]) -> None:
    """Not the cup's, which always lies on an edge: no seam runs through it but by chance."""
    unmarked = [replace(scan, apex=None) for scan in scans]
    recipe = recipe_of(QUICK)
    for scan, bare, found in zip(scans, unmarked, fitted(recipe, unmarked), strict=True):
        assert [note.code for note in found.notes] == ["bust_point_guessed"]
        result = result_of(recipe, bare, found)
        assert scan.apex is not None
        assert np.linalg.norm(result.apex - scan.apex) < 10
        assert abs(result.apex[2] - scan.points[:, 2].max()) < 1
        edge = found.shape.edges[1].numpy()
        away = np.linalg.norm(edge - result.apex, axis=1).min()
        assert found.figures["seam_to_apex_mm"] == pytest.approx(away, abs=0.1)
        assert away > 1
        assert "bust_point_guessed" in result.facts["note_codes"]
        assert "bust_point_guessed" in [told.code for told in result.patterns().fit_warnings]
        assert str(found.notes[0]).endswith("; mark it (landmarks.apex) where that is another")


def test_a_cup_of_one_panel_says_that_it_takes_two(scans: list[Scan]) -> None:
    (found,) = fitted(recipe_of([*QUICK, "cup.panels=1"]), scans[1:2])
    assert found.code is ResultCode.UNRESOLVED
    assert found.reason.endswith("set cup.panels to 2 or more")
    assert "starts" not in found.reason


def test_a_marked_bust_point_is_no_guess(scans: list[Scan], fit: CupFit) -> None:
    assert "bust_point_guessed" not in [note.code for note in fit.notes]
    np.testing.assert_array_equal(result_of(recipe_of(QUICK), scans[0], fit).apex, scans[0].apex)


def test_a_seam_through_an_unmarked_bust_point_is_said(scans: list[Scan]) -> None:
    (found,) = fitted(recipe_of([*QUICK, "condition.seam=apex"]), [replace(scans[0], apex=None)])
    assert found.figures["seam_to_apex_mm"] < 1
    assert found.notes[-1].code == "bust_point_guessed"


def test_several_fits_are_told_of_as_one() -> None:
    heard: list[Step] = []
    course = Course(heard.append)
    for places, name in (((0, 1, 2), ""), ((2,), "3 panels")):
        tell = course.of(places, name)
        assert tell is not None
        for index in range(2):
            tell(Step("1 lm", index, 5, {}, torch.arange(len(places))))
    assert [(step.stage, step.index, step.total) for step in heard] == [
        ("1 lm", 0, 5), ("1 lm", 1, 5), ("3 panels, 1 lm", 5, 10), ("3 panels, 1 lm", 6, 10)
    ]  # fmt: skip
    assert [step.scans.tolist() for step in heard] == [[0, 1, 2], [0, 1, 2], [2], [2]]
    assert Course(None).of([0], "") is None


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["cup.panels=auto", "cup.tolerance=0"], ["cup.tolerance=0", "above 0 mm"]),
        (["cup.panels=auto", "cup.tolerance=-1"], ["cup.tolerance=-1", "at least 0"]),
        (["cup.panels=many"], ["cup.panels=many", "auto or a whole number from 1 to 8"]),
        (["cup.panels=2.5"], ["cup.panels=2.5", "auto or a whole number from 1 to 8"]),
        (["cup.panels=9"], ["cup.panels=9", "from 1 to 8"]),
        (["condition.seam=nipple"], ["condition.seam=nipple", "closest, apex"]),
        (["condition.seam=apex", "cup.panels=1"], ["condition.seam=apex", "cup.panels to 2 or more"]),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: list[str], words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        recipe_of(settings)
    assert all(word in str(error.value) for word in words), error.value


def test_derivatives_need_a_number_of_panels(scans: list[Scan]) -> None:
    with pytest.raises(ConfigError, match="need a number of panels"):
        brafit.layer(scans[:1], settings=["cup.panels=auto"])
