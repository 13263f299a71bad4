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

from brafit import __version__
from brafit.cli.fit import main
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
    "stitches.json", "points.ply", "report.html", "thumbnail.png",
}  # fmt: skip


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


TELLING = """
import sys
from brafit.cli.fit import main
try:
    main()
finally:
    print("loaded:", *sorted({"torch", "scipy", "open3d", "matplotlib"} & set(sys.modules)))
"""
"""The command, which then says what of all that computes and draws its own process has loaded."""


def in_a_process(folder: Path, *arguments: str, program: tuple[str, str] = ("-m", "brafit")) -> Done:
    """Run it as a user does."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "120"}
    command = [sys.executable, *program, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300)
    return Done(done.returncode, done.stdout, done.stderr)


def test_a_command_that_is_ended_says_what_is_kept(tmp_path: Path) -> None:
    """SIGTERM, as a queue sends it, while scans are read."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "brafit", f"out={out}"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as running:
        assert running.stderr is not None
        assert running.stderr.readline().startswith("finding the scans")
        running.terminate()
        said = running.stderr.read()
    assert running.returncode == 143
    assert "brafit: terminated; finished scans are kept" in said
    assert f"the same command with out={out} goes on from there" in said


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
    done = in_a_process(tmp_path, "scans='my scans'", "out=res", *TINY, program=("-c", TELLING))
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("loaded:\n"), "only the workers compute and draw"
    out = tmp_path / "res"
    assert {file.name for file in tmp_path.iterdir()} == {"my scans", "res"}, "litter"
    assert {file.name for file in out.iterdir()} == {
        sample.stem,
        "index.html",
        "summary.csv",
        "summary.parquet",
        "config.yaml",
        "tensorboard",
    }
    assert {file.name for file in (out / sample.stem).iterdir()} == FILES
    for folder in ("batch_0001", "scans"):
        assert list((out / "tensorboard" / folder).glob("events.out.tfevents.*"))
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
    jobs = {f"cup.terms={terms}": terms for terms in ("2", "3")}
    assert {job: summary(tmp_path / "sweep" / job)[sample.stem]["terms"] for job in jobs} == jobs
    over_all = {"multirun.yaml", "sweep.csv", "sweep.parquet", "index.html", "tensorboard"}
    assert {file.name for file in (tmp_path / "sweep").iterdir()} == {*jobs, *over_all}


def test_pattern_settings(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    """Only what is asked for is written, and a nest of all patterns in one file."""
    options = ["pattern.formats=[svg,dxf]", "pattern.meshes=[]", "pattern.report=false", "pattern.nest=true"]
    done = brafit(f"scans='{sample}'", "out=out", *TINY, *options, "pattern.allowance.wire=9.5", "pattern.size=75B")
    assert done.returncode == 0, done.stderr
    out = tmp_path / "out"
    assert {file.name for file in (out / sample.stem).iterdir()} == {"fit.json", "patterns.svg", "patterns.dxf"}
    names = {"config.yaml", "summary.csv", "summary.parquet", "tensorboard", ".nest", sample.stem}
    names |= {"patterns.svg", "patterns.dxf"}
    assert {file.name for file in out.iterdir()} == names
    drawing = (out / sample.stem / "patterns.svg").read_text(encoding="utf-8")
    assert "wire 9.5 mm" in drawing
    assert "size 75B" in drawing
    assert "LOWER_PANEL_75B" in (out / "patterns.dxf").read_text()


def test_sweep_goes_on_after_a_job_that_cannot_run(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    done = brafit("-m", f"scans=nowhere,'{sample}'", "out=sweep", *TINY)
    assert done.returncode == 2
    assert "nowhere" in done.stderr
    (job,) = (tmp_path / "sweep").glob("scans=*ply*")
    assert summary(job)[sample.stem]["status"] == "ok"


def test_sweep_with_a_bad_value_runs_nothing(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    for value, words in (("cup.terms=2,99", "cup.terms=99"), ("condition.connection_width=1,0", "connection_width")):
        done = brafit("-m", f"scans='{sample}'", "out=sweep", *TINY, value)
        assert done.returncode == 2
        assert words in done.stderr
        assert list(tmp_path.iterdir()) == []


def test_sweep_without_any_scan_runs_nothing(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    done = brafit("-m", "nowhere", "out=sweep", *TINY, "cup.terms=2,3")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("brafit: nowhere: there is no such file or folder. ")
    assert list(tmp_path.iterdir()) == []


def test_the_same_command_goes_on_and_other_settings_are_refused(
    tmp_path: Path, sample: Path, brafit: Callable[..., Done]
) -> None:
    command = [f"scans='{sample}'", "out=out", *TINY, "experiment=lean"]
    assert brafit(*command).returncode == 0
    again = brafit(*command)
    assert "1 kept from before" in again.stdout
    other = brafit(*command, "cup.panels=3")
    assert other.returncode == 2
    assert "cup.panels: 2, now 3" in other.stderr
    assert "resume=redo" in other.stderr
    assert summary(tmp_path / "out")[sample.stem]["panels"] == "2"
    assert brafit(*command, "cup.panels=3", "resume=redo").returncode == 0
    assert summary(tmp_path / "out")[sample.stem]["panels"] == "3"


def test_a_table_of_scans_with_settings_of_their_own(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    copied(sample, tmp_path, "a")
    (tmp_path / "list.csv").write_text("cloud,name,cup.panels,cup\na.ply,one,1,\na.ply,two,2,\na.ply,bad,99,\n")
    done = brafit("dataset.manifest=list.csv", "out=out", *TINY, "experiment=lean")
    assert done.returncode == 1, done.stderr
    rows = summary(tmp_path / "out")
    assert {name: row["panels"] for name, row in rows.items()} == {"one": "1", "two": "2", "bad": "2"}
    assert rows["bad"]["reason"] == "cup.panels=99: must be from 1 to 8"


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
    for reason in ("the file is empty", "'wier' looks like it"):
        assert (done.stdout + done.stderr).count(reason) == 1, "a failure is said once"


def test_a_failure_of_both_breasts_is_said_once(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    (tmp_path / "empty.ply").touch()
    done = brafit("empty.ply", "scan.side=both", "out=out")
    assert done.returncode == 2
    assert list(summary(tmp_path / "out")) == ["empty_left", "empty_right"]
    assert (done.stdout + done.stderr).count("the file is empty") == 1
    silent = brafit("empty.ply", "out=silent", "sinks.progress=null")
    assert silent.stdout.count("the file is empty") == 1
    assert silent.stderr == ""


def test_paths_and_letters_of_every_language(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    copied(sample, tmp_path / "Größe", "Müller (1) a=b")
    done = brafit("Größe", "out=Maß [x]", *TINY, "pattern.size=Ω 日本", "pattern.formats=[svg]", "pattern.meshes=[]")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "Maß [x]" / "Müller (1) a=b"
    assert "size Ω 日本" in (folder / "patterns.svg").read_text(encoding="utf-8")
    again = brafit("Größe/Müller (1) a=b.ply", "out=Maß [x]", *TINY, "resume=redo", "experiment=lean")
    assert again.returncode == 0, again.stderr


def test_what_is_swept_is_named_without_quotes(tmp_path: Path, sample: Path, brafit: Callable[..., Done]) -> None:
    done = brafit("-m", str(sample), "out=sweep", *TINY, "experiment=lean", "pattern.size=Größe,B")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "sweep" / "sweep.csv").open(newline="", encoding="utf-8") as file:
        rows = [(row["job"], row["pattern.size"]) for row in csv.DictReader(file)]
    assert rows == [("pattern.size=Größe", "Größe"), ("pattern.size=B", "B")]


@pytest.mark.parametrize("sweep", [[], ["-m", "cup.terms=2,3"]])
def test_out_that_cannot_be_written(tmp_path: Path, sweep: list[str], brafit: Callable[..., Done]) -> None:
    (tmp_path / "file").touch()
    done = brafit(*sweep, "out=file/results")
    assert done.returncode == 2
    assert (
        done.stderr.strip() == "brafit: out=file/results: file is no folder, so nothing can be in it; take another out"
    )


def test_one_bad_scan_alone_is_nothing_that_ran(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    (tmp_path / "empty.ply").touch()
    done = brafit("empty.ply", "missing.ply", "out=out")
    assert done.returncode == 2
    assert {row["status"] for row in summary(tmp_path / "out").values()} == {"failed"}
    assert "failed: missing.ply: there is no such file. Check the path." in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scans=nowhere"], "nowhere"),
        (["nowhere"], "nowhere: there is no such file or folder"),
        (["missing.ply"], "missing.ply: there is no such file. Check the path."),
        (["a.ply", "b.ply"], "a.ply: there is no such file, and none of the 2 files named exists"),
        (["--panels=3"], "settings have no dashes, write cup.panels=3"),
        (["~scan"], "unknown setting '~scan'"),
        (["+my.key=1"], "unknown setting '+my.key'"),
        (["pattern.allowance=8"], "pattern.allowance.wire=8"),
        (["cup.pannels=3"], "did you mean cup.panels?"),
        (["scan.points=2"], "scan.points=2: must be at least 10"),
        (["device=cuda:99"], "device=cuda:99"),
        (["condition.connection_width=0"], "connection_width"),
    ],
)
def test_nothing_can_run(tmp_path: Path, arguments: list[str], words: str, brafit: Callable[..., Done]) -> None:
    done = brafit("out=out", *arguments)
    assert done.returncode == 2
    *before, line = done.stderr.strip().splitlines()
    assert before in ([], ["finding the scans"]), done.stderr
    assert words in line
    assert list(tmp_path.iterdir()) == [], "an empty folder is left"


def test_help_and_settings_are_shown(tmp_path: Path, brafit: Callable[..., Done]) -> None:
    for argument, words in (
        ("--help", "Exit status"),
        ("--version", f"brafit {__version__}\n"),
        ("--cfg=job", "panels: 2"),
    ):
        done = brafit(argument)
        assert done.returncode == 0, done.stderr
        assert words in done.stdout
        assert list(tmp_path.iterdir()) == []
