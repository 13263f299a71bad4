"""Every file of examples/ runs as its head says, with settings that make it quick, and what it prints is true.

The training loop is tested in tests/app/test_examples.py, examples/extending in tests/extending.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from brafit.geometry.polyline import polyline_length

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SAMPLE = ROOT / "brafit" / "samples" / "anny_01.ply"
FEW = ("cup.terms=4", "scan.points=300")
"""Settings that make a fit quick."""


def said(name: str, *arguments: object) -> str:
    """What an example prints, run in a process of its own."""
    interpreter = "sh" if name.endswith(".sh") else sys.executable
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", ""))),
        "PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])),
    }
    command = [interpreter, str(EXAMPLES / name), *map(str, arguments)]
    run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=500, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """The same in this process, which has imported already what takes seconds."""

    def told(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capfd.readouterr().out

    return told


def number(pattern: str, text: str) -> float:
    """The one number of a line."""
    (found,) = re.findall(pattern, text)
    return float(found)


def test_the_index_has_the_command_of_every_example():
    """And each file tells its command at its head, and is run by a test."""
    index = (EXAMPLES / "README.md").read_text()
    rows = dict(re.findall(r"^\| \[([\w./]+)\]\(\1?[\w./]*\) \| [^|]+ \| `([^`]+)` \|$", index, re.MULTILINE))
    files = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".sh")}
    assert set(rows) == files | {"extending/"}
    tests = Path(__file__).read_text() + (ROOT / "tests" / "app" / "test_examples.py").read_text()
    for name in files:
        interpreter = "sh" if name.endswith(".sh") else "python"
        command = f"{interpreter} examples/{name}"
        assert rows[name].startswith(command)
        assert command in (EXAMPLES / name).read_text()[:400]
        assert f'"{name}"' in tests, f"no test runs {name}"


def test_from_a_scan_to_its_pattern(told, tmp_path):
    printed = told("scan_to_pattern.py", SAMPLE, tmp_path, *FEW)
    wire = np.array(json.loads(SAMPLE.with_suffix(".json").read_text())["wire"])
    assert abs(number(r"lower panel: wire ([\d.]+) mm", printed) - polyline_length(wire)) < 0.5
    below, above = re.findall(r"seam ([\d.]+) mm", printed)
    assert below == above
    fit = json.loads((tmp_path / "fit.json").read_text())
    assert number(r"RMS ([\d.]+) mm", printed) == round(fit["rms_mm"], 2)
    count = int(number(r"(\d+) files in", printed))
    assert count == len(list(tmp_path.iterdir()))
    assert (tmp_path / "patterns.pdf").read_bytes().startswith(b"%PDF")


def test_from_a_scan_to_its_pattern_without_python(tmp_path):
    printed = said("scan_to_pattern.sh", SAMPLE, tmp_path, "experiment=lean", *FEW)
    assert "1 of 1 scans ok" in printed
    assert "anny_01" in (tmp_path / "marking" / "index.html").read_text()
    assert (tmp_path / "marking" / "anny_01.html").stat().st_size > 50_000
    with Image.open(tmp_path / "inspection" / "anny_01_left.png") as image:
        assert min(image.size) > 300
    assert json.loads((tmp_path / "results" / "anny_01" / "fit.json").read_text())["terms"] == 4


def test_from_points_to_a_pattern(told):
    printed = told("points_to_pattern.py", *FEW)
    wire, exact = re.findall(r"wire ([\d.]+) mm; of the dome ([\d.]+) mm", printed)[0]
    assert float(exact) == round(65 * math.pi, 2)
    assert abs(float(wire) - float(exact)) < 0.05
    depth, known = re.findall(r"edges reach ([\d.]+) mm; the dome ([\d.]+) mm", printed)[0]
    assert abs(float(depth) - float(known)) < 3
    assert 0.5 < number(r"RMS ([\d.]+) mm", printed) < 3  # a dome is not developable


def test_a_sweep_and_its_tables(told, tmp_path):
    printed = said(
        "sweep.py", tmp_path, "cup.panels=2,3", f"scans={SAMPLE.with_name('anny_04.ply')}", "experiment=lean", *FEW
    )
    medians = re.findall(r"cup.panels=(\d): 1 of 1 scans ok\n  rms_mm: median ([\d.]+)\n", printed)
    rms = {int(panels): float(value) for panels, value in medians}
    assert rms[3] < 0.8 * rms[2]  # this breast is one for three panels
    with (tmp_path / "sweep.csv").open(newline="") as file:
        table = {int(row["panels"]): float(row["rms_mm"]) for row in csv.DictReader(file)}
    assert rms == pytest.approx(table, abs=0.001)
    summed = told("read_results.py", tmp_path / "cup.panels=3")
    assert summed.startswith("1 of 1 scans ok\n")
    assert number(r"rms_mm: median ([\d.]+)", summed) == pytest.approx(rms[3], abs=0.006)


def sizes_are_right(printed: str, out: Path, count: int, sizes: int) -> None:
    """Everyone has a size, the one that is nearest to her, and the printed means are those of the table."""
    rows = re.findall(r"size (\d): (\w+), (\d+) members?, mean ([\d.]+) mm, wire (\d+)\.\d mm", printed)
    assert len(rows) == sizes
    assert [row[4] for row in rows] == sorted(row[4] for row in rows)
    with (out / "sizes" / "members.csv").open(newline="") as file:
        members = list(csv.DictReader(file))
    assert len(members) == count == sum(int(row[2]) for row in rows)
    for size, scan, _, mean, _ in rows:
        errors = {row["scan"]: float(row["error_mm"]) for row in members if row["size"] == size}
        assert errors[scan] == 0
        assert float(mean) == pytest.approx(np.mean(list(errors.values())), abs=0.051)


def test_sizes_from_a_population(tmp_path):
    sizes_are_right(said("sizes_from_a_population.sh", tmp_path, 4, 2), tmp_path, 4, 2)


def test_a_picture_of_the_points_that_move_the_ridge(told, tmp_path):
    ridge_is_right(told("which_points_move_the_ridge.py", SAMPLE, tmp_path / "ridge.png", *FEW), tmp_path / "ridge.png")


def ridge_is_right(printed: str, picture: Path) -> None:
    """Few points move the ridge most, and the picture has their colours."""
    most, median = (float(v) for v in re.findall(r"([\d.]+) mm a mm", printed))
    assert most > 2 * median > 0
    with Image.open(picture) as image:
        assert len(image.convert("RGB").getcolors(1 << 24) or ()) > 100


def test_one_step_towards_a_width_of_cloth(told):
    step_is_right(told("fit_a_width_of_cloth.py", SAMPLE, *FEW))


def step_is_right(printed: str) -> None:
    """One step brings the pattern most of the way to the width that is wanted."""
    before, wanted = (float(v) for v in re.findall(r"([\d.]+) mm wide; wanted: ([\d.]+)", printed)[0])
    found = number(r"its pattern ([\d.]+) mm wide", printed)
    assert wanted < before
    assert abs(found - wanted) < 0.4 * (before - wanted)


@pytest.mark.slow
def test_all_with_their_own_settings(tmp_path):
    """As the index has them."""
    ridge_is_right(said("which_points_move_the_ridge.py", SAMPLE, tmp_path / "ridge.png"), tmp_path / "ridge.png")
    step_is_right(said("fit_a_width_of_cloth.py"))
    sizes_are_right(said("sizes_from_a_population.sh", tmp_path / "sizes"), tmp_path / "sizes", 12, 3)
    assert said("sweep.py", tmp_path / "sweep").count("3 of 3 scans ok\n  rms_mm") == 4
    assert "RMS 2.9" in said("scan_to_pattern.py", SAMPLE.with_name("anny_04.ply"), tmp_path / "pattern")
