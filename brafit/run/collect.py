"""The table and the index of results that lie in one or several folders, from each scan's own fit.json."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from brafit.errors import InputError
from brafit.report.index import write_index
from brafit.report.table import write_parquet, write_summary
from brafit.run.job import Done
from brafit.run.store import done_of, scan_folders


def collect(folders: Sequence[str | Path], out: str | Path | None = None) -> list[Done]:
    """Write summary.csv, summary.parquet and index.html over all scans in the folders of runs.

    Scans come in the order of the dataset, which their fit.json tells; those of the same name in several folders are
    all taken, where they are shards of one dataset none is twice.

    Args:
        folders: folders of runs, such as of the shards of one dataset.
        out: where the table goes; None: into the first.

    Returns:
        the scans, in the table's order.

    Raises:
        InputError: a folder does not exist, or holds no result.
    """
    found: list[tuple[Path, Done]] = []
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise InputError(folder, "there is no such folder", "Name the folder of a run")
        own = [(path, done_of(content, content.get("position") or 0)) for path, content in scan_folders(folder)]
        if not own:
            raise InputError(
                folder, "it holds no fit.json of any scan", "Name the folder of a run: the one of summary.csv"
            )
        found += own
    found.sort(key=lambda one: (one[1].position, one[1].name))
    target = Path(out or folders[0])
    rows = [done.row for _, done in found]
    write_summary(target / "summary.csv", rows)
    write_parquet(target / "summary.parquet", rows)
    places = [Path(os.path.relpath(path, target)).as_posix() for path, _ in found]
    write_index(target / "index.html", rows, [done.warnings for _, done in found], places)
    return [replace(done, kept=False) for _, done in found]
