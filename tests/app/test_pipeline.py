"""From scans to rows without a command line: batches, failures of a whole batch, fits without a result."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest

from brafit import pipeline
from brafit.app import exit_status
from brafit.cup import FramesCup
from brafit.errors import InputError
from brafit.fit import Anneal, Conditions, CupFit, ResultCode, Stage, Target, fit_targets
from brafit.pipeline import Job, run
from brafit.report.table import SUMMARY_KEYS

Fit = Callable[..., list[CupFit]]


@pytest.fixture
def job(tmp_path: Path) -> Job:
    cup = partial(FramesCup, panels=2, terms=2, stations=21)
    solver = Anneal([Stage("adam", 3, 1.0), Stage("lbfgs", 5, 10.0)])
    return Job(["samples"], tmp_path / "out", cup, solver, Conditions(), scan={"points": 60}, threads=1)


def fits_through(monkeypatch: pytest.MonkeyPatch, change: Callable[[Sequence[Target], Fit], list[CupFit]]) -> None:
    """Put something between the pipeline and the fit."""

    def changed(targets: Sequence[Target], *args: Any, **kwargs: Any) -> list[CupFit]:
        return change(targets, lambda chosen: fit_targets(chosen, *args, **kwargs))

    monkeypatch.setattr(pipeline, "fit_targets", changed)


def test_batches_make_no_difference(job: Job, tmp_path: Path) -> None:
    """A scan alone in its batch gives what it gives beside others; and batches have a folder of events each."""
    together = run(job)
    said: list[str] = []
    alone = run(replace(job, batch=1, out=tmp_path / "alone"), say=said.append)
    assert [row["scan"] for row in together] == [row["scan"] for row in alone]
    for a, b in zip(together, alone, strict=True):
        for key in set(SUMMARY_KEYS) - {"seconds"}:
            assert a.get(key) == (
                pytest.approx(b[key], rel=1e-6, nan_ok=True) if isinstance(a.get(key), float) else b.get(key)
            ), key
    events = sorted((tmp_path / "alone" / "tensorboard").rglob("events.out.tfevents.*"))
    assert [file.parent.name for file in events] == ["batch_0001", "batch_0002", "batch_0003"]
    assert "3 of 3 scans ok" in said[0]


def test_meshes_lie_where_the_scan_lies(job: Job) -> None:
    """Read by Open3D: the points of the fit, and a cup around them, are in the scan's own frame."""
    run(replace(job, scans=[sample()], scan={"points": None, "outliers": None}))
    folder = job.out / sample().stem
    cloud = np.asarray(o3d.io.read_point_cloud(sample()).points)
    used = np.asarray(o3d.io.read_point_cloud(folder / "points.ply").points)
    gaps = np.abs(cloud[None, :, :] - used[:50, None, :]).max(-1).min(1)
    assert gaps.max() < 1e-3, "points of the fit are points of the file"
    cup = np.asarray(o3d.io.read_triangle_mesh(folder / "cup.ply").vertices)
    wire = np.array(json.loads(sample().with_suffix(".json").read_text())["wire"])
    for end in (wire[0], wire[-1]):
        assert np.linalg.norm(cup - end, axis=1).min() < 1.0


def test_a_batch_that_breaks_does_not_stop_the_others(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def breaking(targets: Sequence[Target], fit: Fit) -> list[CupFit]:
        if targets[0].name == "anny_04":
            raise RuntimeError("something\nnobody thought of")
        return fit(targets)

    fits_through(monkeypatch, breaking)
    rows = run(replace(job, batch=1))
    assert [row["status"] for row in rows] == ["ok", "failed", "ok"]
    assert "RuntimeError" in rows[1]["reason"]
    assert "\n" not in rows[1]["reason"]
    assert "breaking" in (job.out / "errors.log").read_text(), "the traceback"
    assert exit_status(rows) == 1
    with (job.out / "summary.csv").open(newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == ["ok", "failed", "ok"]


def test_diverged_and_unmeasurable_fits_fail_with_a_reason(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def spoiling(targets: Sequence[Target], fit: Fit) -> list[CupFit]:
        first, second, third = fit(targets)
        first = replace(first, code=ResultCode.DIVERGED, reason=ResultCode.DIVERGED.value)
        second = replace(second, figures=second.figures | {"twist_deg_max": float("nan")})
        return [first, second, replace(third, code=ResultCode.STEP_LIMIT)]

    run(job)
    fits_through(monkeypatch, spoiling)
    rows = run(job)
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


def sample() -> Path:
    return Path(pipeline.find_scans("samples")[0])
