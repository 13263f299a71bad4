"""The table and the index of results that lie in one or several folders, from each scan's own fit.json."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from brafit.errors import ConfigError, InputError
from brafit.naming import shown, told_apart
from brafit.report.index import write_index
from brafit.report.table import SUMMARY_KEYS, write_parquet, write_summary, write_table
from brafit.run.job import Done
from brafit.run.store import TABLE, done_of, refuse_taken, scan_folders, without_scans

FILES = (TABLE, "summary.parquet", "index.html")
"""What is written."""
RUN = "run"
"""The first column of a table over several folders: the name of the one that the scan's results lie in."""


def collect(folders: Sequence[str | Path], out: str | Path | None = None) -> list[Done]:
    """Write summary.csv, summary.parquet and index.html over all scans in the folders of runs.

    The table of one folder is the one that a run writes, in the order of the dataset, which each fit.json tells. That
    of several tells in its first column which folder each scan is of; scans of the same name are all taken, and stand
    together, in the order of the folders.

    Args:
        folders: folders of runs; one named twice counts once.
        out: where the table goes; None: into the folder, if it is one.

    Returns:
        the scans, in the table's order; those of several folders are called `RUN/NAME`.

    Raises:
        InputError: a folder does not exist, or holds no result.
        ConfigError: the table of a run would be lost.
    """
    runs = list({Path(folder).resolve(): Path(folder) for folder in folders}.values())
    found = [scan for run in runs for scan in _scans(run)]
    target = _target(runs, out)
    if len(runs) == 1:
        found.sort(key=lambda scan: (scan[1].position, scan[1].name))
    else:  # as a scan has another place in each dataset; the sort keeps the order of the runs
        found.sort(key=lambda scan: scan[1].name)
    places = [Path(os.path.relpath(path, target)).as_posix() for path, _ in found]
    if len(runs) == 1:
        told = [done for _, done in found]
        write_summary(target / FILES[0], [done.row for done in told])
        write_parquet(target / FILES[1], [done.row for done in told])
    else:
        names = dict(zip(runs, told_apart([run.resolve() for run in runs]), strict=True))
        rows, keys = [{RUN: names[path.parent], **done.row} for path, done in found], (RUN, *SUMMARY_KEYS)
        write_table(target / FILES[0], keys, rows)
        write_parquet(target / FILES[1], rows, keys)
        told = [_of_run(done, names[path.parent]) for path, done in found]
    write_index(target / FILES[2], [done.row for done in told], [done.warnings for done in told], places)
    return [replace(done, kept=False) for done in told]


def _scans(run: Path) -> list[tuple[Path, Done]]:
    """The scans of a run and their folders."""
    if not run.is_dir():
        raise InputError(run, "there is no such folder", "Name the folder of a run")
    own = [(path, done_of(content, content.get("position") or 0)) for path, content in scan_folders(run)]
    if not own:
        raise without_scans(run)
    return own


def _target(runs: Sequence[Path], out: str | Path | None) -> Path:
    """Where the table goes: never onto that of a run of which it is not."""
    if out is None and len(runs) > 1:
        raise ConfigError(f"a table of {len(runs)} folders is no run's own: say where it goes, with --out DIR")
    target = Path(out or runs[0])
    its_own = len(runs) == 1 and target.resolve() == runs[0].resolve()
    if not its_own:
        refuse_taken(target, TABLE)
    return target


def _of_run(done: Done, run: str) -> Done:
    """A scan that is called by its run as well."""
    name = shown(f"{run}/{done.name}")
    return replace(done, name=name, row=done.row | {"scan": name})
