"""What brafit-collect makes of one run and of several: every row says where it is from, and no run's table is lost."""

from __future__ import annotations

import csv
from pathlib import Path

import pyarrow.parquet
import pytest
from populations import made_cup, write_fit

from brafit.cli import collect as command
from brafit.errors import ConfigError, InputError
from brafit.report.table import SUMMARY_KEYS
from brafit.run.collect import collect


@pytest.fixture
def runs(tmp_path: Path) -> tuple[Path, Path]:
    """Two runs with tables of their own, of which one scan has the same name."""
    one, other = tmp_path / "one", tmp_path / "other"
    for run, names in ((one, ("anna", "berta")), (other, ("anna",))):
        for name in names:
            write_fit(run / name, *made_cup(60.0, 1.0))
        collect([run])
    return one, other


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_rows_of_several_runs_say_which_they_are_of(runs: tuple[Path, Path], tmp_path: Path):
    found = collect(runs, tmp_path / "all")
    assert [done.name for done in found] == ["one/anna", "other/anna", "one/berta"]
    rows = table(tmp_path / "all" / "summary.csv")
    assert list(rows[0]) == ["run", *SUMMARY_KEYS]
    assert [(row["run"], row["scan"]) for row in rows] == [("one", "anna"), ("other", "anna"), ("one", "berta")]
    assert [{k: v for k, v in row.items() if k != "run"} for row in rows if row["run"] == "one"] == table(
        runs[0] / "summary.csv"
    )
    read = pyarrow.parquet.read_table(tmp_path / "all" / "summary.parquet").to_pylist()
    assert [row["run"] for row in read] == ["one", "other", "one"]
    page = (tmp_path / "all" / "index.html").read_text(encoding="utf-8")
    assert ">other/anna</a>" in page
    assert 'href="../other/anna/report.html"' in page


def test_rows_of_one_scan_stand_together(tmp_path: Path):
    """Where it has another place in each run's dataset too."""
    for run, names in (("one", ("anna", "berta")), ("other", ("berta", "anna"))):
        for place, name in enumerate(names):
            write_fit(tmp_path / run / name, *made_cup(60.0, 1.0), position=place)
    runs = tmp_path / "one", tmp_path / "other"
    assert [done.name for done in collect([runs[1]])] == ["berta", "anna"]
    assert [done.name for done in collect(runs, tmp_path / "all")] == [
        "one/anna",
        "other/anna",
        "one/berta",
        "other/berta",
    ]


@pytest.mark.parametrize("out", [None, "one", "one/anna", "other", "sweep"])
def test_no_run_loses_its_table_to_rows_of_another(runs: tuple[Path, Path], tmp_path: Path, out: str | None):
    (tmp_path / "sweep").mkdir()
    (tmp_path / "sweep" / "sweep.csv").touch()
    before = [(run / "summary.csv").read_bytes() for run in runs]
    with pytest.raises(ConfigError, match="--out"):
        collect(runs, out and tmp_path / out)
    assert [(run / "summary.csv").read_bytes() for run in runs] == before


def test_one_run_named_twice_is_one_run(runs: tuple[Path, Path]):
    before = (runs[0] / "summary.csv").read_bytes()
    assert len(collect([runs[0], runs[0] / "anna" / ".."])) == 2
    assert (runs[0] / "summary.csv").read_bytes() == before


def test_what_is_no_run_is_told_with_what_to_name_instead(runs: tuple[Path, Path], tmp_path: Path):
    collect(runs, tmp_path / "all")
    for folder, words in (
        (tmp_path / "all", "Name the folders of the runs whose scans"),
        (tmp_path, f"Name those: {runs[0]}, {runs[1]}"),
        (runs[0] / "anna", "the folder of one scan"),
    ):
        with pytest.raises(InputError, match=words):
            collect([folder])


def test_of_many_runs_some_are_named_and_the_others_counted(tmp_path: Path):
    for k in range(5):
        write_fit(tmp_path / f"run_{k}" / "anna", *made_cup(60.0, 1.0))
    with pytest.raises(InputError, match=r"run_0, \S*run_1, \S*run_2 and 2 more\.$"):
        collect([tmp_path])


def test_the_command_says_which_files_it_wrote(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as end:
        command.main([*map(str, runs), "--out", str(tmp_path / "all")])
    assert end.value.code == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith(f"Written: {tmp_path}/all/summary.csv, ")
