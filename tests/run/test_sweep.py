"""Sweeps: names of folders, what is checked beforehand, and the table over all jobs."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pyarrow.parquet
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from brafit.errors import ConfigError
from brafit.report.table import write_summary
from brafit.run.sweep import SweepJob, combinations, gather, parted, read_statuses, write_status
from brafit.settings.compose import LONGEST, job_folder


@pytest.mark.parametrize(
    ("overrides", "folder"),
    [
        ("cup.panels=2,cup.terms=8", "cup.panels=2,cup.terms=8"),
        ("scans=/data/a b.ply", "scans=_data_a_b.ply"),
        ("scans=../../etc", "scans=.._.._etc"),
        ("", "7"),
        ("..", "7"),
    ],
)
def test_folders_have_names_that_every_disk_takes(overrides: str, folder: str) -> None:
    assert job_folder(overrides, 7) == folder


def test_long_names_stay_apart() -> None:
    names = {job_folder("solver.stages=" + 50 * "{steps:10}", number) for number in range(3)}
    assert len(names) == 3
    assert max(map(len, names)) <= LONGEST + 4


def test_every_combination_is_checked_or_every_value() -> None:
    swept, fixed = parted(["cup.panels=2,3", "out=x", "cup.terms=range(4,7)", "scan.outliers=interval(1,3)"])
    assert swept == {"cup.panels": ["2", "3"], "cup.terms": ["4", "5", "6"], "scan.outliers": []}
    assert fixed == {"out": "x"}
    assert len(list(combinations(swept, fixed))) == 6
    many = {f"key{k}": [str(i) for i in range(10)] for k in range(3)}
    checked = list(combinations(many, fixed))
    assert len(checked) == 30
    assert {text for settings in checked for text in settings} == {"out=x"} | {
        f"{k}={v}" for k in many for v in many[k]
    }


def test_all_choices_of_a_group_and_of_what_is_none() -> None:
    assert parted(["cup=glob(*)"])[0] == {"cup": ["frames", "strips"]}
    assert parted(["cup=glob([f*])"])[0] == {"cup": ["frames"]}
    with pytest.raises(ConfigError, match=r"cup.panels=glob\(...\): .* name the values: cup.panels=VALUE,VALUE"):
        parted(["cup.panels=glob(*)"])
    with pytest.raises(ConfigError, match=r"here none; cup has frames, strips"):
        parted(["cup=glob(x*)"])


def row(scan: str, rms: float | None) -> dict:
    status = {"status": "ok", "rms_mm": rms} if rms is not None else {"status": "failed", "reason": "no cup"}
    told = {"seam_to_apex_mm": 4 * rms, "warning_count": 2} if rms is not None else {}
    return {"scan": scan, "cup": "strips", "panels": 2, **status, **told}


def test_one_table_over_all_jobs(tmp_path: Path) -> None:
    jobs = [SweepJob("cup.terms=4", {"cup.terms": "4"}, 0), SweepJob("cup.terms=8", {"cup.terms": "8"}, 1)]
    write_summary(tmp_path / "cup.terms=4" / "summary.csv", [row("a", 2.0), row("b", 1.0)])
    write_summary(tmp_path / "cup.terms=8" / "summary.csv", [row("a", 1.5), row("b", None)])
    for number, job in enumerate(jobs):
        write_status(tmp_path / "statuses", number, job)
    assert read_statuses(tmp_path / "statuses") == jobs
    gather(tmp_path, jobs)
    with (tmp_path / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = [(r["cup.terms"], r["scan"], r["rms_mm"], r["best"]) for r in rows]
    assert found == [("4", "a", "2", ""), ("4", "b", "1", "1"), ("8", "a", "1.5", "1"), ("8", "b", "", "")]
    read = pyarrow.parquet.read_table(tmp_path / "sweep.parquet").to_pylist()
    assert [(r["job"], r["rms_mm"], r["panels"]) for r in read][:2] == [
        ("cup.terms=4", 2.0, 2),
        ("cup.terms=4", 1.0, 2),
    ]
    page = (tmp_path / "index.html").read_text()
    heads, *lines = re.findall(r"<tr>.*?</tr>", page)
    columns = re.findall(r"<th[^>]*>(.*?)</th>", heads)
    for line, (ok, warnings, apex) in zip(lines, [("2", "4", "6.00"), ("1", "2", "6.00")], strict=False):
        cells = dict(zip(columns, re.findall(r"<td[^>]*>(.*?)</td>", line), strict=True))
        assert (cells["ok"], cells["warnings"], cells["seam to bust point"]) == (ok, warnings, apex)
    assert "cup.terms%3D8/index.html" in page
    events = EventAccumulator(str(tmp_path / "tensorboard" / "cup.terms=8")).Reload()
    assert events.Scalars("sweep/rms_mm")[0].value == 1.5
    assert "_hparams_/session_start_info" in events.PluginTagToContent("hparams")
