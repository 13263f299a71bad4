"""The command as a user runs it: a process of its own, in a folder of their own."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from brafit.app import main
from brafit.samples import sample_paths

# A fit that ends in a second or two; how good it is does not matter here.
TINY = [
    "scan.points=60",
    "restarts=1",
    "threads=1",
    "cup=frames",
    "solver=anneal",
    "cup.terms=2",
    "cup.stations=21",
    "solver.stages=[{optimiser:adam,steps:3,penalty:1.0},{optimiser:lbfgs,steps:5,penalty:10.0}]",
]
FILES = {
    "fit.json", "patterns.svg", "patterns.dxf", "patterns.pdf", "patterns_sheet.pdf", "cup.ply", "cup.obj", "cup.glb",
    "points.ply", "report.html", "thumbnail.png",
}  # fmt: skip


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


def in_a_process(folder: Path, *arguments: str) -> Done:
    """Run it as a user does."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "120"}
    command = [sys.executable, "-m", "brafit", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.fixture
def brafit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """Run it in `tmp_path`, but in this process, which saves its start."""
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.chdir(tmp_path)

    def command(*arguments: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["brafit", *arguments])
        with pytest.raises(SystemExit) as ending:
            main()
        shown = capsys.readouterr()
        code = ending.value.code
        assert isinstance(code, int)
        return Done(code, shown.out, shown.err)

    return command


def summary(out: Path) -> dict[str, dict[str, str]]:
    with (out / "summary.csv").open(newline="") as file:
        return {row["scan"]: row for row in csv.DictReader(file)}


def copied(sample: Path, folder: Path, name: str | None = None) -> Path:
    folder.mkdir(exist_ok=True)
    cloud = folder / f"{name or sample.stem}.ply"
    shutil.copy(sample, cloud)
    shutil.copy(sample.with_suffix(".json"), cloud.with_suffix(".json"))
    return cloud


@pytest.fixture
def sample() -> Path:
    return sample_paths()[0]


def test_one_scan_gives_all_files(tmp_path: Path, sample: Path) -> None:
    copied(sample, tmp_path / "my scans")
    done = in_a_process(tmp_path, "scans='my scans'", "out=res", *TINY)
    assert done.returncode == 0, done.stderr
    out = tmp_path / "res"
    assert {file.name for file in tmp_path.iterdir()} == {"my scans", "res"}, "litter"
    assert {file.name for file in out.iterdir()} == {
        sample.stem,
        "index.html",
        "summary.csv",
        "config.yaml",
        "tensorboard",
    }
    assert {file.name for file in (out / sample.stem).iterdir()} == FILES
    assert list((out / "tensorboard").glob("events.out.tfevents.*"))
    row = summary(out)[sample.stem]
    assert row["status"] == "ok"
    settings = {"cup": "frames", "solver": "anneal", "panels": "2", "terms": "2", "points": "60"}
    assert settings.items() <= row.items()
    fit = json.loads((out / sample.stem / "fit.json").read_text())
    assert list(fit)[: len(row)] == list(row)
    assert fit["cleaning"]["read"] == 4000
    assert fit["settings"]["scan"]["points"] == 60
    assert yaml.safe_load((out / "config.yaml").read_text())["cup"]["terms"] == 2
    assert sample.stem in done.stdout
    assert "1 of 1 scans ok" in done.stdout
    assert len(done.stderr) < 2000, "a log is not to be flooded"


def test_sweep_runs_every_job_in_its_folder(tmp_path: Path, sample: Path) -> None:
    done = in_a_process(tmp_path, "-m", f"scans='{sample}'", "out=sweep", *TINY, "cup.terms=2,3")
    assert done.returncode == 0, done.stderr
    assert {summary(tmp_path / "sweep" / job)[sample.stem]["terms"] for job in ("0", "1")} == {"2", "3"}
    assert {file.name for file in (tmp_path / "sweep").iterdir()} == {"0", "1", "multirun.yaml"}


def test_pattern_settings(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    """Only what is asked for is written, and a nest of all patterns in one file."""
    options = ["pattern.formats=[svg,dxf]", "pattern.meshes=[]", "pattern.report=false", "pattern.nest=true"]
    done = brafit(f"scans='{sample}'", "out=out", *TINY, *options, "pattern.allowance.wire=9.5", "pattern.size=75B")
    assert done.returncode == 0, done.stderr
    out = tmp_path / "out"
    assert {file.name for file in (out / sample.stem).iterdir()} == {"fit.json", "patterns.svg", "patterns.dxf"}
    names = {"config.yaml", "summary.csv", "tensorboard", "patterns.svg", "patterns.dxf", sample.stem}
    assert {file.name for file in out.iterdir()} == names
    drawing = (out / sample.stem / "patterns.svg").read_text(encoding="utf-8")
    assert "wire 9.5 mm" in drawing
    assert "size 75B" in drawing
    assert "LOWER_PANEL_75B" in (out / "patterns.dxf").read_text()


def test_sweep_goes_on_after_a_job_that_cannot_run(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    done = brafit("-m", f"scans=nowhere,'{sample}'", "out=sweep", *TINY)
    assert done.returncode == 2
    assert "nowhere" in done.stderr
    assert summary(tmp_path / "sweep" / "1")[sample.stem]["status"] == "ok"


def test_bad_scans_fail_and_the_others_go_on(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    scans = tmp_path / "scans"
    copied(sample, scans, "good")
    copied(sample, scans, "empty").write_text("")
    misspelt = copied(sample, scans, "misspelt").with_suffix(".json")
    misspelt.write_text(misspelt.read_text().replace('"wire"', '"wier"'))
    done = brafit("scans=scans", "out=out", *TINY)
    assert done.returncode == 1, done.stderr
    rows = summary(tmp_path / "out")
    states = {name: row["status"] for name, row in rows.items()}
    assert states == {"good": "ok", "empty": "failed", "misspelt": "failed"}
    assert "wire" in rows["misspelt"]["reason"]
    assert "misspelt.json" in rows["misspelt"]["reason"]
    assert "empty.ply" in rows["empty"]["reason"]
    assert json.loads((tmp_path / "out" / "empty" / "fit.json").read_text())["status"] == "failed"
    assert not (tmp_path / "out" / "empty" / "patterns.svg").exists()
    assert "Traceback" not in done.stderr


def test_one_bad_scan_alone_is_nothing_that_ran(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    done = brafit("scans=missing.ply", "out=out")
    assert done.returncode == 2
    assert summary(tmp_path / "out")["missing"]["status"] == "failed"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scans=nowhere"], "nowhere"),
        (["cup.pannels=3"], "did you mean cup.panels?"),
        (["scan.points=2"], "scan.points=2: must be at least 10"),
        (["device=cuda:99"], "device=cuda:99"),
        (["condition.connection_width=0"], "connection_width"),
    ],
)
def test_nothing_can_run(tmp_path: Path, arguments: list[str], words: str, brafit: Callable[..., Done]) -> None:
    done = brafit("out=out", *arguments)
    assert done.returncode == 2
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert words in lines[0]
    assert list(tmp_path.iterdir()) == [], "an empty folder is left"


def test_help_and_settings_are_shown(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    for argument, words in (("--help", "Exit status"), ("--cfg=job", "panels: 2")):
        done = brafit(argument)
        assert done.returncode == 0, done.stderr
        assert words in done.stdout
        assert list(tmp_path.iterdir()) == []
