"""From scans to rows without a command line: batches, what goes wrong in them, what is kept and what is done again."""

from __future__ import annotations

import csv
import json
import math
import pickle
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import faulty
import numpy as np
import open3d as o3d
import pytest
import torch

from brafit.cli.fit import exit_status
from brafit.errors import InputError
from brafit.pattern import PatternOptions
from brafit.report.table import SUMMARY_KEYS
from brafit.run import Done, Job, run, stages
from brafit.run.closing import closing
from brafit.run.collect import collect
from brafit.run.dataset import ScanRef
from brafit.run.job import Overview
from brafit.run.recipe import Recipe
from brafit.run.sinks import Activity, Board, ErrorLog, Index, Nest, Progress, Sink, Table
from brafit.samples import sample_paths


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job(tmp_path / "out", faulty.plain, sinks=[Table(), ErrorLog()], workers=2)


def table(out: Path, name: str = "summary.csv") -> list[dict[str, str]]:
    with (out / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def timeless(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key != "seconds"} for row in rows]


def numbers(row: dict[str, Any]) -> dict[str, float]:
    return {key: value for key, value in row.items() if isinstance(value, float) and math.isfinite(value)}


def sample() -> Path:
    return sample_paths()[0]


class Heard(Sink):
    """Keeps what it hears."""

    watches = 1

    def __init__(self) -> None:
        self.done: list[Done] = []
        self.batches: set[int] = set()
        self.scans: set[str] = set()

    def step(self, batch: int, step: Any) -> None:
        self.batches.add(batch)
        self.scans |= set(step.scans)

    def scan(self, done: Done) -> None:
        self.done.append(done)


def test_batches_make_no_difference(job: Job, tmp_path: Path) -> None:
    """A scan alone in its batch gives what it gives beside others, to the last digit of the table."""
    together = run(replace(job, workers=1))
    said: list[str] = []
    alone = run(replace(job, batch=1, out=tmp_path / "alone"), say=said.append)
    assert [row["scan"] for row in together] == [row["scan"] for row in alone]
    for a, b in zip(together, alone, strict=True):
        for key in set(SUMMARY_KEYS) - {"seconds"}:
            assert a.get(key) == (
                pytest.approx(b[key], rel=1e-6, nan_ok=True) if isinstance(a.get(key), float) else b.get(key)
            ), key
    assert "3 of 3 scans ok" in said[0]


def test_sinks_hear_of_every_batch_and_scan_and_see_pictures_of_those_they_watch(job: Job) -> None:
    heard = Heard()
    run(replace(job, batch=1, sinks=[heard]))
    assert heard.batches == {1, 2, 3}
    assert {done.name for done in heard.done} == {"anny_01", "anny_04", "anny_09"}
    assert heard.scans == {"anny_01"}
    pictures = {done.name: set(done.pictures) for done in heard.done}
    assert pictures == {"anny_01": {"fit", "patterns"}, "anny_04": set(), "anny_09": set()}


def test_meshes_lie_where_the_scan_lies(job: Job) -> None:
    """Read by Open3D: the points of the fit, and a cup around them, are in the scan's own frame."""
    recipe = partial(everything, PatternOptions(formats=(), meshes=("ply",), report=False))
    run(replace(job, scans=[sample()], recipe=recipe))
    folder = job.out / sample().stem
    cloud = np.asarray(o3d.io.read_point_cloud(sample()).points)
    used = np.asarray(o3d.io.read_point_cloud(folder / "points.ply").points)
    gaps = np.abs(cloud[None, :, :] - used[:50, None, :]).max(-1).min(1)
    assert gaps.max() < 1e-3, "points of the fit are points of the file"
    cup = np.asarray(o3d.io.read_triangle_mesh(folder / "cup.ply").vertices)
    wire = np.array(json.loads(sample().with_suffix(".json").read_text())["wire"])
    for end in (wire[0], wire[-1]):
        assert np.linalg.norm(cup - end, axis=1).min() < 1.0


def everything(pattern: PatternOptions):
    return replace(faulty.plain(pattern), scan={"points": None, "outliers": None})


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("breaks", "unexpected RuntimeError in fitting it: something nobody thought of"),
        ("crashes", "anny_04.ply: fitting it failed: the process crashed (SIGSEGV)"),
        ("hangs", "anny_04.ply: fitting it took longer than 5 s"),
        ("eats_memory", "most likely for want of memory"),
    ],
)
def test_a_scan_that_breaks_its_batch_costs_itself_alone(job: Job, fault: str, words: str) -> None:
    rows = run(replace(job, recipe=partial(faulty.faulty, "anny_04", fault), workers=1, patience=5.0))
    assert [row["status"] for row in rows] == ["ok", "failed", "ok"]
    assert words in rows[1]["reason"]
    assert "\n" not in rows[1]["reason"]
    assert exit_status(rows) == 1
    assert [row["status"] for row in table(job.out)] == ["ok", "failed", "ok"]
    assert json.loads((job.out / "anny_04" / "fit.json").read_text())["reason"] == rows[1]["reason"]
    if fault == "breaks":
        assert "in breaks" in (job.out / "errors.log").read_text(), "the traceback"


def test_diverged_and_unmeasurable_fits_fail_with_a_reason(job: Job) -> None:
    run(job)
    rows = run(replace(job, recipe=faulty.spoilt, resume="redo"))
    assert [row["status"] for row in rows] == ["failed", "failed", "ok"]
    assert "diverged" in rows[0]["reason"]
    assert "twist_deg_max" in rows[1]["reason"]
    assert {file.name for file in (job.out / "anny_01").iterdir()} == {"fit.json"}, "files of the run before are left"
    assert exit_status(rows) == 1


def test_a_scan_without_a_neckline_is_ok(job: Job, tmp_path: Path) -> None:
    marks = json.loads(sample().with_suffix(".json").read_text())
    del marks["upper_line"]
    (tmp_path / "plain.json").write_text(json.dumps(marks))
    (tmp_path / "plain.ply").write_bytes(sample().read_bytes())
    (row,) = run(replace(job, scans=[tmp_path]))
    assert row["status"] == "ok", row["reason"]


def test_no_scan_found_is_an_error(job: Job) -> None:
    with pytest.raises(InputError, match="nowhere"):
        run(replace(job, scans=["nowhere"]))
    assert not job.out.exists()


def test_the_same_run_again_keeps_what_is_finished(job: Job, tmp_path: Path) -> None:
    """What is whole is kept as it is; a scan whose files or landmarks are others, or gone, is done again."""
    scans = tmp_path / "scans"
    scans.mkdir()
    for name in ("one", "two", "three"):
        shutil.copy(sample(), scans / f"{name}.ply")
        shutil.copy(sample().with_suffix(".json"), scans / f"{name}.json")
    job = replace(job, scans=[scans])
    first = run(job)
    times = {name: (job.out / name / "fit.json").stat().st_mtime_ns for name in ("one", "two", "three")}
    (job.out / "two" / "patterns.svg").unlink()
    marks = json.loads((scans / "three.json").read_text())
    (scans / "three.json").write_text(json.dumps(marks | {"remark": "looked at"}))
    heard = Heard()
    again = run(replace(job, sinks=[*job.sinks, heard]))
    assert {done.name: done.kept for done in heard.done} == {"one": True, "two": False, "three": False}
    assert (job.out / "one" / "fit.json").stat().st_mtime_ns == times["one"]
    assert (job.out / "two" / "patterns.svg").is_file()
    for a, b in zip(timeless(first), timeless(again), strict=True):
        assert numbers(a) == pytest.approx(numbers(b))


class Ended(Sink):
    """Ends the run, as Ctrl+C and SIGTERM do, at the first scan that it hears of."""

    def __init__(self) -> None:
        self.ended = False

    def scan(self, done: Done) -> None:
        if not self.ended:
            self.ended = True
            raise KeyboardInterrupt


@pytest.mark.parametrize(("resume", "rows"), [("keep", 3), ("redo", 1)])
def test_a_run_that_is_broken_off_has_rows_of_all_that_is_finished(job: Job, resume: str, rows: int) -> None:
    """Of those of an earlier run that it has not come to, and of the one that it has written, but not heard of."""
    run(job)
    with pytest.raises(KeyboardInterrupt):
        run(replace(job, resume=resume, workers=1, sinks=[Ended(), Table()]))
    assert len(table(job.out)) == rows
    assert {row["status"] for row in table(job.out)} == {"ok"}


def test_a_further_run_adds_to_its_folders_table_unless_it_starts_over(job: Job) -> None:
    """As brafit-collect would make the table; scans of other settings are named, and left out."""
    said: list[str] = []
    first, *others = sample_paths()
    job = replace(job, scans=[first], sinks=[Table(), Index()])
    run(replace(job, scans=others))
    (row,) = run(job, say=said.append)
    assert row["scan"] == "anny_01", "a run answers for its own scans"
    assert "2 more scans of earlier runs in this folder, in its table too: anny_04, anny_09." in said[-1]
    made = (job.out / "summary.csv").read_bytes()
    assert "anny_09" in (job.out / "index.html").read_text()
    assert [done.name for done in collect([job.out])] == ["anny_01", "anny_04", "anny_09"]
    assert (job.out / "summary.csv").read_bytes() == made
    for other in ({"resume": "redo"}, {"recipe": partial(faulty.plain, settings={"restarts": 2})}):
        run(replace(job, **other), say=said.append)
        assert [row["scan"] for row in table(job.out)] == ["anny_01"]
        assert "2 more scans of earlier runs in this folder, not in its table: anny_04, anny_09." in said[-1]
    run(replace(job, shard="1/1"), say=said.append)
    assert [row["scan"] for row in table(job.out, "summary_1_of_1.csv")] == ["anny_01"]
    assert "more scan" not in said[-1], "they are of its peers"


def test_shards_together_are_the_whole(job: Job, tmp_path: Path) -> None:
    run(job)
    whole = table(job.out)
    shared = tmp_path / "shared"
    for k in (1, 2):
        run(replace(job, out=shared, shard=f"{k}/2"))
    assert [row["scan"] for row in table(shared, "summary_1_of_2.csv")] == ["anny_01", "anny_09"]
    assert [row["scan"] for row in table(shared, "summary_2_of_2.csv")] == ["anny_04"]
    collect([shared])
    assert timeless(table(shared)) == timeless(whole)


def test_a_table_can_be_rebuilt_from_the_folders(job: Job) -> None:
    run(replace(job, recipe=partial(faulty.faulty, "anny_04", "crashes")))
    before = (job.out / "summary.csv").read_bytes()
    (job.out / "summary.csv").unlink()
    collect([job.out])
    assert (job.out / "summary.csv").read_bytes() == before


def test_parquet_holds_the_same_numbers(job: Job) -> None:
    import pyarrow.parquet

    rows = run(job)
    read = pyarrow.parquet.read_table(job.out / "summary.parquet").to_pylist()
    assert list(read[0]) == list(SUMMARY_KEYS)
    assert [row["rms_mm"] for row in read] == [row["rms_mm"] for row in rows]
    assert read[0]["points"] == rows[0]["points"]


def test_nest_and_index_are_there_after_a_run_that_kept_scans(job: Job) -> None:
    nested = partial(faulty.plain, replace(faulty.LEAN, nest=True))
    job = replace(job, recipe=nested, sinks=[Nest(formats=["svg"]), Index()])
    run(job)
    first = (job.out / "patterns.svg").read_text()
    (job.out / "patterns.svg").unlink()
    (job.out / "anny_04" / "fit.json").unlink()
    run(job)
    assert (job.out / "patterns.svg").read_text() == first
    assert "anny_04" in (job.out / "index.html").read_text()


@pytest.mark.parametrize(
    ("rows", "status"),
    [
        ([("ok", 5), ("ok", 5)], 0),
        ([("ok", 5), ("failed", None)], 1),
        ([("failed", 5)], 1),
        ([("failed", None), ("failed", None)], 2),
    ],
)
def test_exit_status(rows: list[tuple[str, int | None]], status: int) -> None:
    assert exit_status([{"status": state, "iterations": count} for state, count in rows]) == status


def test_names_that_are_no_text_or_a_runs_own_are_written_everywhere(tmp_path: Path) -> None:
    """Bytes that are no UTF-8 in the names of folder and scan, and scans that are called like files of the run."""
    folder, out = tmp_path / "B\udcfcste", tmp_path / "out\udcff"
    folder.mkdir()
    for name in ("B\udcfcste", "Tensorboard"):
        for suffix in (".ply", ".json"):
            shutil.copy(sample().with_suffix(suffix), folder / f"{name}{suffix}")
    (folder / "bad\udce4.ply").write_text("ply\n")
    (folder / "bad\udce4.json").write_text("{}")
    sinks = [Table(), Index(), Board(), Nest(), ErrorLog(), Progress()]
    said: list[str] = []
    job = Job(out, partial(faulty.plain, PatternOptions(meshes=(), nest=True)), scans=[folder], sinks=sinks)
    rows = run(job, say=said.append)
    assert [row["status"] for row in rows] == ["ok", "ok", "failed"]
    assert [row["scan"] for row in rows] == ["B\ufffdste", "scan_Tensorboard", "bad\ufffd"]
    assert rows[2]["reason"].startswith(f"{tmp_path}/B\ufffdste/bad\ufffd.ply: ")
    assert [row["scan"] for row in table(out)] == [row["scan"] for row in rows]
    assert all((out / row["scan"] / "report.html").is_file() for row in rows if row["status"] == "ok")
    names = ("index.html", "summary.parquet", "patterns.svg", "patterns.dxf", "patterns.pdf")
    assert all((out / name).is_file() for name in names)
    assert any((out / "tensorboard" / "scans").iterdir())
    "\n".join(said).encode()
    assert len(collect([out])) == 3


def test_a_log_hears_how_far_a_run_is_before_a_scan_has_ended(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(seconds=0.0)
    progress.open(Overview(Path("out"), ("a", "b"), (0, 1)))
    progress.activity(Activity(loading=2))
    progress.scan(Done(0, "a", {"status": "ok"}))
    said = capsys.readouterr().err
    assert "0 of 2 scans; loading 2, fitting 0, writing 0" in said
    assert "1 of 2 scans: ok 1, of them warned 0, failed 0; loading 2" in said


def test_warnings_of_kept_scans_are_counted_and_not_said_again(capsys: pytest.CaptureFixture[str]) -> None:
    row = dict.fromkeys(SUMMARY_KEYS) | {"scan": "a", "status": "ok", "warning_count": 2}
    kept = Done(0, "a", row, ("the cup is far from the points", "a point is far"), kept=True)
    progress = Progress()
    progress.open(Overview(Path("out"), ("a",), (0,)))
    progress.scan(kept)
    assert "far" not in capsys.readouterr().err
    told = closing([kept], Path("out"))
    assert "1 of 1 scans ok, 1 of them with warnings, 1 kept from before (1 with warnings, which their reports" in told
    assert "warnings" in told.splitlines()[0]


def test_what_holds_for_both_breasts_is_noted_once(capsys: pytest.CaptureFixture[str]) -> None:
    names = ("a_left", "a_right", "b_left")
    progress = Progress()
    progress.open(Overview(Path("out"), names, (0, 1, 2)))
    for k, name in enumerate(names):
        progress.scan(Done(k, name, {"status": "ok"}, notes=("it is in cm", f"only of {name}")))
    said = capsys.readouterr().err
    assert said.count("it is in cm") == 2, "once of each file"
    assert all(f"only of {name}" in said for name in names)


def solved_elsewhere() -> Recipe:
    """Solves where the processor is called another device: what it solves is measured by whoever finishes it."""
    return faulty.plain(device="cpu:0")


def test_what_another_device_solves_is_measured_alike_by_whoever_finishes_it(job: Job) -> None:
    here = run(job)
    there = run(replace(job, recipe=solved_elsewhere, out=job.out.parent / "there", one_fit=True))
    assert {row["status"] for row in here} == {"ok"}
    for one, other in zip(timeless(here), timeless(there), strict=True):
        assert numbers(other) == pytest.approx(numbers(one), rel=1e-6, abs=1e-9)


def test_a_fit_is_handed_on_alone(tmp_path: Path) -> None:
    """What is sent of a fit does not grow with its batch."""

    def tell(_: object) -> None:
        pass

    source = pickle.dumps(faulty.plain)
    refs = [ScanRef(path, (path.stem,), (None,), (k,)) for k, path in enumerate(sample_paths())]
    loaded = [stages.load(source, ref, tmp_path, False, tell)[0] for ref in refs]
    together = stages.fit(source, [one for one in loaded if isinstance(one, bytes)], (), tell)
    for one, fit in zip(loaded, together, strict=True):
        assert isinstance(one, bytes)
        (alone,) = stages.fit(source, [one], (), tell)
        assert len(fit) < 1.05 * len(alone)
        assert torch.allclose(pickle.loads(fit).shape.edges, pickle.loads(alone).shape.edges, atol=1e-4)
