"""The commands brafit-sizes and brafit-nest on made populations and on a real fit."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ezdxf.filemanagement import readfile
from populations import SETTINGS, made_cup, write_fit, write_population

import brafit
from brafit.cli import nest, sizes
from brafit.naming import told_apart
from brafit.report.dimensions import PANELS_AREA
from brafit.samples import sample_paths
from brafit.scan import load_scan
from brafit.sizing.service import NEAR
from brafit.sizing.stored import pattern_of, shape_of, stored_fit

KINDS = [(60.0, 0.8), (60.0, 1.2), (75.0, 1.0)]


def run(command, *words: object) -> int:
    with pytest.raises(SystemExit) as end:
        command.main([str(word) for word in words])
    return int(end.value.code or 0)


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def population(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int]]:
    out = tmp_path_factory.mktemp("population")
    return out, write_population(out, KINDS, 5)


def test_kinds_are_found_and_everyone_gets_her_own(population, tmp_path: Path):
    results, kind_of = population
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path) == 0
    rows, members = table(tmp_path / "sizes.csv"), table(tmp_path / "members.csv")
    assert [row["size"] for row in rows] == ["1", "2", "3"]
    assert sorted(kind_of[row["scan"]] for row in rows) == [0, 1, 2]
    kind = {row["size"]: kind_of[row["scan"]] for row in rows}
    assert len(members) == 15
    assert all(kind[row["size"]] == kind_of[row["scan"]] for row in members)
    assert all(float(row["error_mm"]) < float(row["second_error_mm"]) for row in members)
    lengths = [float(row["wire_mm"]) for row in rows]
    assert lengths == sorted(lengths)
    own = {row["scan"]: float(row["error_mm"]) for row in members}
    assert all(own[row["scan"]] == 0 for row in rows)
    for row in rows:
        errors = [own[member["scan"]] for member in members if member["size"] == row["size"]]
        assert float(row["mean_mm"]) == pytest.approx(np.mean(errors), rel=1e-4)
        assert int(row["members"]) == 5
        near = np.mean([error <= NEAR for error in errors])
        assert float(row["within_3mm_percent"]) == pytest.approx(100 * near, rel=1e-4)
    curve = table(tmp_path / "curve.csv")
    means = [float(row["best_mean_mm"]) for row in curve]
    assert means == sorted(means, reverse=True)
    assert all(float(row["best_mean_mm"]) <= float(row["wire_groups_mean_mm"]) for row in curve)
    content = json.loads((tmp_path / "sizes.json").read_text())
    assert [row["scan"] for row in content["sizes"]] == [row["scan"] for row in rows]
    for name in ("index.html", "cups.svg", "cups.png", "served.svg", "served.png", "patterns.svg", "patterns.pdf"):
        assert (tmp_path / name).stat().st_size > 1000
    layers = {layer.dxf.name for layer in readfile(tmp_path / "patterns.dxf").layers}
    assert {"S_1", "S_2", "S_3"} <= layers


def test_the_gap_of_a_wearer_is_never_more_than_her_error(population, tmp_path: Path):
    """The nearest point is no farther than the corresponding one, but for the cups' stations."""
    run(sizes, population[0], "--sizes", 2, "--out", tmp_path)
    for row in table(tmp_path / "members.csv"):
        assert float(row["gap_mm"]) <= float(row["error_mm"]) + 0.05


def test_two_runs_give_the_same(population, tmp_path: Path):
    assert run(sizes, population[0], "--sizes", 3, "--out", tmp_path / "a") == 0
    assert run(sizes, population[0], "--sizes", 3, "--out", tmp_path / "b") == 0
    for file in ("members.csv", "curve.csv", "graded.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_what_cannot_be_used_is_said_in_a_line_and_the_rest_goes_on(population, tmp_path: Path, capsys):
    results = tmp_path / "results"
    shutil.copytree(population[0], results)
    names = sorted(folder.name for folder in results.iterdir())
    (results / names[0] / "fit.json").write_text("{")
    old = json.loads((results / names[1] / "fit.json").read_text())
    (results / names[1] / "fit.json").write_text(json.dumps({k: v for k, v in old.items() if k != "wire"}))
    (results / names[2] / "fit.json").write_text(json.dumps(old | {"status": "failed", "reason": "x"}))
    odd = json.loads((results / names[3] / "fit.json").read_text())
    odd["parameters"]["angle"] = [*odd["parameters"]["angle"], 0.0]
    (results / names[3] / "fit.json").write_text(json.dumps(odd))
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path / "out") == 1
    said = capsys.readouterr()
    lines = [line for line in said.err.splitlines() if line.startswith("failed: ")]
    assert len(lines) == 3
    assert all(f"/{name}/fit.json: " in line for name, line in zip((names[0], names[1], names[3]), lines, strict=True))
    assert "no wire" in lines[1]
    assert "1 scan whose fit failed" in said.out
    assert len(table(tmp_path / "out" / "members.csv")) == 11
    assert run(nest, results, "--out", tmp_path / "nest") == 1
    said = capsys.readouterr()
    assert len([line for line in said.err.splitlines() if line.startswith("failed: ")]) == 3
    layers = [layer.dxf.name for layer in readfile(tmp_path / "nest" / "patterns.dxf").layers]
    assert sum(name.endswith("_SEW") for name in layers) == 11


def test_a_scan_that_failed_is_told_by_the_exit_status(population, tmp_path: Path):
    results = tmp_path / "results"
    shutil.copytree(population[0], results)
    file = min(results.iterdir()) / "fit.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"status": "failed", "reason": "x"}))
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path / "out") == 1
    assert run(nest, results, "--out", tmp_path / "nest") == 1


@pytest.mark.parametrize("out", ["run", "run/anna", "collected", "sweep", "other"])
@pytest.mark.parametrize("command", [sizes, nest])
def test_no_results_of_others_are_written_over(command, tmp_path: Path, capsys, out: str):
    write_fit(tmp_path / "run" / "anna", *made_cup(60.0, 1.0))
    for file in ("collected/summary.csv", "sweep/sweep.csv", "other/sizes.csv"):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).touch()
    before = sorted(tmp_path.rglob("*"))
    words = [tmp_path / "run", "--out", tmp_path / out, *(["--sizes", 1] if command is sizes else [])]
    if (command, out) == (sizes, "other"):  # of an earlier time
        assert run(command, *words) == 0
        return
    assert run(command, *words) == 2
    assert f"--out {tmp_path / out}: " in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def for_cloth(folder: Path, **cloth: float) -> None:
    """A scan's folder as if its fit had been made for other cloth."""
    content = json.loads((folder / "fit.json").read_text())
    content["settings"]["pattern"]["cloth"] = {"thickness": 0.0, "stretch": 0.0, "stretch_across": 0.0} | cloth
    (folder / "fit.json").write_text(json.dumps(content))


def test_cups_of_other_thickness_are_refused(population, tmp_path: Path, capsys):
    """Alone they would be good: of one thickness a population may be fitted."""
    results = tmp_path / "results"
    shutil.copytree(population[0], results)
    names = sorted(folder.name for folder in results.iterdir())
    for name in names[3:5]:
        for_cloth(results / name, thickness=5.0)
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert f"{names[3]}/fit.json: its cup was fitted for material 5 mm thick" in said
    assert "but 13 of the 15 cups for 0 mm" in said
    assert run(sizes, *(results / name for name in names[3:5]), "--sizes", 2, "--out", tmp_path / "out") == 0


def test_cups_of_other_thickness_are_not_nested_but_lie_side_by_side(population, tmp_path: Path, capsys):
    results = tmp_path / "results"
    shutil.copytree(population[0], results)
    for_cloth(min(results.iterdir()), thickness=5.0)
    assert run(nest, results, "--out", tmp_path / "out") == 2
    assert "but 14 of the 15 cups for 0 mm" in capsys.readouterr().err
    assert not (tmp_path / "out" / "patterns.svg").exists()
    assert run(nest, results, "--out", tmp_path / "out", "--align", "none") == 0
    said = capsys.readouterr().err
    assert "different cloth or ease" in said
    assert "cloth 5.0 mm thick, no ease: 1)" in said
    assert "cloth 5.0 mm thick" in (tmp_path / "out" / "patterns.svg").read_text(encoding="utf-8")


def test_warnings_of_fits_are_said_and_drawn(tmp_path: Path, capsys):
    write_population(tmp_path / "run", KINDS[:1], 2)
    told: dict[str, Any] = {"warnings": ["the wire's outer end is a guess"], "warning_codes": ["proposed_landmarks"]}
    write_fit(tmp_path / "run" / "guessed", *made_cup(*KINDS[0]), **told)
    assert run(nest, tmp_path / "run", "--out", tmp_path / "nest") == 0
    words = "guessed: the wire's outer end is a guess"
    assert capsys.readouterr().err.count(f"warning: {words}") == 1
    assert (tmp_path / "nest" / "patterns.svg").read_text(encoding="utf-8").count(f">WARNING: {words}<") == 1
    texts = readfile(tmp_path / "nest" / "patterns.dxf").modelspace().query('TEXT[layer=="WARNINGS"]')
    assert [text.dxf.text for text in texts] == [f"WARNING: {words}"]


def test_cups_of_different_numbers_of_panels_are_told(tmp_path: Path, capsys):
    """Their lower panels are different parts of the cup."""
    settings = SETTINGS | {"cup": SETTINGS["cup"] | {"panels": 3}}
    write_fit(tmp_path / "run" / "two", *made_cup(*KINDS[0]))
    write_fit(tmp_path / "run" / "three", *made_cup(*KINDS[0], panels=3), settings=settings)
    words = "the cups have different numbers of panels (2 panels: two; 3 panels: three)"
    assert run(nest, tmp_path / "run", "--out", tmp_path / "nest") == 0
    assert capsys.readouterr().err.count(f"warning: {words}") == 1
    assert f"WARNING: {words}" in (tmp_path / "nest" / "patterns.svg").read_text(encoding="utf-8")
    assert run(nest, tmp_path / "run", "--align", "none", "--out", tmp_path / "apart") == 0
    assert words not in capsys.readouterr().err


def test_scans_of_one_name_are_told_apart_by_their_folders(population, tmp_path: Path):
    for run_of in ("before", "after"):
        shutil.copytree(population[0] / "cup_0_0", tmp_path / "runs" / run_of / "anna")
    shutil.copytree(population[0] / "cup_1_0", tmp_path / "runs" / "after" / "berta")
    assert run(nest, *(tmp_path / "runs").iterdir(), "--out", tmp_path / "out") == 0
    told = (tmp_path / "out" / "patterns.svg").read_text(encoding="utf-8")
    assert all(f">{name}<" in told for name in ("before/anna", "after/anna", "berta"))
    layers = {layer.dxf.name for layer in readfile(tmp_path / "out" / "patterns.dxf").layers}
    assert {"S_BEFORE_ANNA", "S_AFTER_ANNA", "S_BERTA"} <= layers
    assert told_apart([Path("/a/x/s"), Path("/b/x/s"), Path("/b/y/s")]) == ["a/x/s", "b/x/s", "y/s"]


def test_pieces_for_other_stretch_are_told(population, tmp_path: Path, capsys):
    results = tmp_path / "results"
    shutil.copytree(population[0], results)
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path / "out") == 0
    assert "different cloth or ease" not in capsys.readouterr().out
    for_cloth(min(results.iterdir()), stretch=20.0)
    assert run(sizes, results, "--sizes", 3, "--out", tmp_path / "out") == 0
    (told,) = (line for line in capsys.readouterr().out.splitlines() if "different cloth or ease" in line)
    assert "stretch 20 % along grain: 16.7 % less, no ease: 1)" in told
    assert "different cloth or ease" in (tmp_path / "out" / "index.html").read_text()


def test_finished_dimensions_say_whether_they_are_as_cut_or_as_worn(tmp_path: Path):
    write_fit(
        tmp_path / "fits" / "one",
        *made_cup(60.0, 1.0),
        pattern={
            "dimensions": [
                ["lower panel", "seam", 200.0, "mm", None],
                ["cup", "depth of the cup", 50.0, "mm", None],
                ["cup", PANELS_AREA, 200.0, "cm2", None],
                ["over the surface", "wire line", 200.0, "mm", None],
            ]
        },
    )
    assert run(sizes, tmp_path / "fits", "--sizes", 1, "--out", tmp_path / "out") == 0
    assert [row["measured"] for row in table(tmp_path / "out" / "graded.csv")] == [
        "as cut",
        "as worn",
        "as cut",
        "as worn",
    ]
    assert "<th>measured</th>" in (tmp_path / "out" / "index.html").read_text()


def test_whose_size_has_a_wire_that_is_not_hers_is_told(tmp_path: Path, capsys):
    """Half circles of 60 and 66 mm are 19 mm apart in length, of 60 and 62 mm 6 mm: a size is 15 mm."""
    for name, radius in (("anna", 60.0), ("berta", 60.0), ("clara", 62.0), ("dora", 66.0)):
        write_fit(tmp_path / "run" / name, *made_cup(radius, 1.0))
    assert run(sizes, tmp_path / "run", "--sizes", 1, "--out", tmp_path / "out") == 0
    members = {row["scan"]: row for row in table(tmp_path / "out" / "members.csv")}
    (row,) = table(tmp_path / "out" / "sizes.csv")
    for member in members.values():
        longer = float(row["wire_mm"]) - float(member["wire_mm"])
        assert float(member["size_wire_diff_mm"]) == pytest.approx(longer, abs=1e-3)
    assert {name for name, member in members.items() if member["warning"]} == {"dora"}
    assert "mm shorter than her own, more than a size (15 mm)" in members["dora"]["warning"]
    assert row["members_far_wire"] == "1"
    (told,) = (line for line in capsys.readouterr().out.splitlines() if "more than a size" in line)
    assert told.startswith("warning: 1 of 4 wearers get a wire more than a size (15 mm) longer or shorter")
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert f'class="warnings"><b>Warnings</b><ul><li>{told.removeprefix("warning: ")}</li>' in page
    assert run(sizes, tmp_path / "run", "--sizes", 3, "--out", tmp_path / "out") == 0
    assert "more than a size" not in capsys.readouterr().out


def labelled_in(folder: Path, unit: str) -> None:
    """A scan's folder as if it had been fitted with that `pattern.units`."""
    content = json.loads((folder / "fit.json").read_text())
    content["settings"]["pattern"]["units"] = unit
    (folder / "fit.json").write_text(json.dumps(content))


def test_a_nest_has_one_unit_that_of_most_fits_or_the_one_asked_for(tmp_path: Path, capsys):
    for name in ("a", "b", "c"):
        write_fit(tmp_path / "run" / name, *made_cup(*KINDS[0]))
    for name in ("a", "b"):
        labelled_in(tmp_path / "run" / name, "inch")
    assert run(nest, tmp_path / "run", "--out", tmp_path / "out") == 0
    said = "(2 in inches and 1 in mm): here all are in inches (--units)"
    assert said in capsys.readouterr().err
    drawn = (tmp_path / "out" / "patterns.svg").read_text(encoding="utf-8")
    assert ">lengths in inches, true size (1:1)<" in drawn
    assert len(re.findall(r">[abc]: wire 7\.\d\d in, depth of cup \d\.\d\d in<", drawn)) == 3
    assert run(nest, tmp_path / "run", "--out", tmp_path / "out", "--units", "mm") == 0
    assert said not in capsys.readouterr().err
    assert len(re.findall(r">[abc]: wire 18\d\.\d mm, depth", (tmp_path / "out" / "patterns.svg").read_text())) == 3


def test_finished_dimensions_of_sizes_are_in_the_unit_of_the_fits(tmp_path: Path, capsys):
    dimensions = [["cup", "wire", 254.0, "mm", None], ["cup", PANELS_AREA, 64.516, "cm2", None]]
    write_fit(tmp_path / "run" / "one", *made_cup(60.0, 1.0), pattern={"dimensions": dimensions})
    labelled_in(tmp_path / "run" / "one", "inch")
    assert run(sizes, tmp_path / "run", "--sizes", 1, "--out", tmp_path / "out") == 0
    found = [(row["unit"], float(row["1"])) for row in table(tmp_path / "out" / "graded.csv")]
    assert found == [("in", 10.0), ("in2", 10.0)]
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert page.count(">10.00</td>") == 2
    assert ">in²</td>" in page
    assert re.search(r"size 1: one, .*wire 7\.\d\d in", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--sizes", "0"], "must be 1 or more"),
        (["--sizes", "16"], "there are 15 good fits"),
    ],
)
def test_wrong_numbers_of_sizes_are_refused(population, tmp_path: Path, capsys, words, said):
    assert run(sizes, population[0], *words, "--out", tmp_path) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("command", [sizes, nest])
def test_folders_without_fits_are_refused_in_one_line(command, tmp_path: Path, capsys):
    assert run(command, tmp_path / "none", "--out", tmp_path / "out") == 2
    assert "no such folder" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert run(command, tmp_path / "empty", "--out", tmp_path / "out") == 2
    assert "no fit.json" in capsys.readouterr().err


def test_a_scan_named_twice_counts_once(population, tmp_path: Path):
    results = population[0]
    assert run(nest, results / "cup_0_0", results / "cup_0_0" / "..", "--out", tmp_path, "--align", "none") == 0
    layers = [layer.dxf.name for layer in readfile(tmp_path / "patterns.dxf").layers]
    assert sum(name.endswith("_SEW") for name in layers) == 15


def test_a_right_cup_is_drawn_as_a_left_one(tmp_path: Path):
    cup, line = made_cup(65.0, 1.0)
    for side in ("left", "right"):
        write_fit(tmp_path / side, cup, line, side)
    left, right = (stored_fit(tmp_path / side) for side in ("left", "right"))
    assert left is not None
    assert right is not None
    assert run(sizes, tmp_path, "--sizes", 1, "--out", tmp_path / "out") == 0
    assert [float(row["error_mm"]) for row in table(tmp_path / "out" / "members.csv")] == pytest.approx(
        [0, 0], abs=1e-4
    )
    for one, other in zip(pattern_of(left, "1").pieces, pattern_of(right, "1").pieces, strict=True):
        np.testing.assert_allclose(one.cut_outline(), other.cut_outline())


@pytest.mark.parametrize("marked", [True, False])
def test_a_real_fit_is_made_again_to_the_last_thousandth(tmp_path: Path, marked: bool):
    scan = load_scan(sample_paths()[0], points=200)
    scan = scan if marked else replace(scan, apex=None)
    result = brafit.fit(scan, settings=["pattern.report=false", "pattern.meshes=[]"])
    result.save(tmp_path / "scan")
    stored = stored_fit(tmp_path / "scan")
    assert stored is not None
    np.testing.assert_allclose(shape_of(stored).edges.numpy(), result.shape.edges.numpy(), atol=1e-6)
    for piece, own in zip(pattern_of(stored, "1").pieces, result.patterns().pieces, strict=True):
        for line, before in zip(piece.sew, own.sew, strict=True):
            assert line.length == pytest.approx(before.length, abs=1e-3)
        assert {notch.name for notch in piece.notches} == {notch.name for notch in own.notches}
        assert [hole.name for hole in piece.holes] == [hole.name for hole in own.holes]
        for hole, before in zip(piece.holes, own.holes, strict=True):
            np.testing.assert_allclose(hole.point, before.point, atol=1e-3)
