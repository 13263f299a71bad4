"""What becomes of a run besides the scans' own folders: table, index, TensorBoard, progress, nest, log of errors.

A sink hears of everything in the conductor's process, so none imports anything heavy before it is needed.
"""

from __future__ import annotations

import os
import pickle
import re
import shutil
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brafit.report.fit_step import FitStep
from brafit.run.job import Done, Overview, Row

if TYPE_CHECKING:
    from brafit.report.tensorboard import Recorder


FIRST = 5.0
"""Seconds after which a run that no terminal shows says for the first time how far it is."""


@dataclass(frozen=True)
class Activity:
    """Scans in each stage just now."""

    loading: int = 0
    fitting: int = 0
    writing: int = 0

    def __str__(self) -> str:
        return f"loading {self.loading}, fitting {self.fitting}, writing {self.writing}"


class Sink:
    """Hears of a run from its beginning to its end; a sink overrides what it wants to hear of."""

    watches: int = 0
    """Scans, the first ones of the dataset, of which it wants every step of the fit, and pictures."""
    tells: bool = False
    """Whether it says each failure to the user as it happens."""

    def starting(self) -> None:
        """Nothing is known yet but that the run begins."""

    def open(self, overview: Overview) -> None:
        """The scans are found."""

    def note(self, line: str) -> None:
        """Something that the user should know of the dataset."""

    def activity(self, activity: Activity) -> None:
        """What the workers are at has changed."""

    def step(self, batch: int, step: FitStep) -> None:
        """A batch's fit has done a step."""

    def scan(self, done: Done) -> None:
        """A scan has ended."""

    def earlier(self, done: Done) -> None:
        """At the end: a scan of an earlier run with these settings, in the same folder, that this run does not name."""

    def close(self, complete: bool) -> None:
        """The run has ended; not complete if it was broken off."""


class Table(Sink):
    """summary.csv: a line as soon as a scan has ended, in the dataset's order at the end, and then as summary.parquet.

    Each shard of a dataset has a table of its own, `summary_003_of_016.csv`, so that all can share one folder.
    """

    def __init__(self, parquet: bool = True):
        self._parquet = parquet
        self._rows: list[tuple[int, str, Row]] = []
        self._path = Path()

    def open(self, overview: Overview) -> None:
        from brafit.report.table import write_summary

        self._rows = []
        self._path = overview.out / f"{table_name(overview.shard)}.csv"
        write_summary(self._path, [])

    def scan(self, done: Done) -> None:
        from brafit.report.table import summary_line

        self.earlier(done)
        line = summary_line(done.row).encode("utf-8", errors="replace")
        # one write of one line: whoever reads the table, or a kill, finds whole lines only
        file = os.open(self._path, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(file, line)
        finally:
            os.close(file)

    def earlier(self, done: Done) -> None:
        self._rows.append((done.position, done.name, done.row))

    def close(self, complete: bool) -> None:
        from brafit.report.table import write_parquet, write_summary

        rows = [row for *_, row in sorted(self._rows, key=lambda entry: entry[:2])]
        write_summary(self._path, rows)
        if self._parquet:
            write_parquet(self._path.with_suffix(".parquet"), rows)


def table_name(shard: str | None) -> str:
    """Name of the table of a run, or of one of its shards."""
    if shard is None:
        return "summary"
    from brafit.run.dataset import shard_of

    number, count = shard_of(shard)
    width = len(str(count))
    return f"summary_{number:0{width}d}_of_{count}"


class Index(Sink):
    """index.html over all scans of a run; written anew while it grows, ever less often."""

    GROWTH = 1.5

    def __init__(self, wanted: bool = True):
        self._wanted = wanted
        self._done: list[Done] = []
        self._written = 0
        self._path: Path | None = None

    def open(self, overview: Overview) -> None:
        self._done, self._written = [], 8
        self._path = overview.out / "index.html" if self._wanted and not overview.shard else None

    def scan(self, done: Done) -> None:
        if self._path is None:
            return
        self.earlier(done)
        if len(self._done) >= self.GROWTH * self._written:
            self._write()

    def earlier(self, done: Done) -> None:
        self._done.append(Done(done.position, done.name, done.row, done.warnings))

    def close(self, complete: bool) -> None:
        if self._done:
            self._write()

    def _write(self) -> None:
        if self._path is None:
            return
        from brafit.report.index import write_index

        self._written = len(self._done)
        ordered = sorted(self._done, key=lambda done: (done.position, done.name))
        write_index(self._path, [done.row for done in ordered], [done.warnings for done in ordered])


class Board(Sink):
    """TensorBoard: each batch's course, and of some scans each one's course, patterns, picture and 3D view.

    Args:
        scans: how many scans, the first ones, are shown one by one.
        batches: how many batches, the first ones, have their course recorded; TensorBoard becomes slow beyond some
            hundred.
    """

    def __init__(self, scans: int = 4, batches: int = 50):
        self.watches = scans
        self._batches = batches
        self._folder = Path()
        self._recorders: dict[int, Recorder] = {}
        self._scans: Recorder | None = None
        self._first = 0
        self._watched: frozenset[str] = frozenset()

    def open(self, overview: Overview) -> None:
        name = "tensorboard" if overview.shard is None else f"tensorboard/shard_{overview.shard.replace('/', '_of_')}"
        self._folder = overview.out / name
        if not overview.resumed:
            shutil.rmtree(self._folder, ignore_errors=True)  # TensorBoard would draw both runs as one
        self._first = len(list(self._folder.glob("batch_*")))
        self._recorders, self._scans = {}, None
        self._watched = frozenset(overview.watched)

    def step(self, batch: int, step: FitStep) -> None:
        if self._first + batch > self._batches:
            return
        if batch not in self._recorders:
            from brafit.report.tensorboard import Recorder

            self._recorders[batch] = Recorder(self._folder / f"batch_{self._first + batch:04d}")
        self._recorders[batch].step(step)

    def scan(self, done: Done) -> None:
        if done.name not in self._watched or done.kept or not done.ok:
            return
        if self._scans is None:
            from brafit.report.tensorboard import Recorder

            self._scans = Recorder(self._folder / "scans")
        for kind, picture in done.pictures.items():
            self._scans.image(f"{done.name}/{kind}", picture)
        if done.mesh is not None:
            self._scans.mesh(f"{done.name}/cup", *done.mesh)
        self._scans.text(f"{done.name}/figures", _figures_text(done))

    def close(self, complete: bool) -> None:
        for recorder in (*self._recorders.values(), self._scans):
            if recorder is not None:
                recorder.close()
        self._recorders, self._scans = {}, None


def _figures_text(done: Done) -> str:
    """A scan's row as a table in Markdown."""
    lines = ["| | |", "| --- | --- |"]
    for key, value in done.row.items():
        if value is not None:
            lines.append(f"| {key} | {f'{value:.6g}' if isinstance(value, float) else value} |")
    return "\n".join([*lines, *(f"| warning | {words} |" for words in done.warnings)])


class Nest(Sink):
    """All patterns of a run in one file of each format, beside the table."""

    def __init__(self, wanted: bool = True, formats: Sequence[Any] = ("svg", "dxf", "pdf")):
        self._wanted, self._formats = wanted, tuple(formats)
        self._ok: list[tuple[int, str]] = []
        self._out = Path()

    def open(self, overview: Overview) -> None:
        self._ok, self._out = [], overview.out

    def scan(self, done: Done) -> None:
        if done.ok:
            self._ok.append((done.position, done.name))

    def close(self, complete: bool) -> None:
        if not (complete and self._wanted and self._ok):
            return
        from brafit.pattern.writers import write_patterns  # takes seconds
        from brafit.run.store import nest_file

        names = [name for _, name in sorted(self._ok)]
        patterns = [pickle.loads(nest_file(self._out, name).read_bytes()) for name in names]
        write_patterns(self._out, patterns, self._out.name, f"{len(names)} scans", self._formats)


class ErrorLog(Sink):
    """errors.log: the tracebacks of what nobody expected."""

    def __init__(self) -> None:
        self._path = Path()

    def open(self, overview: Overview) -> None:
        self._path = overview.out / "errors.log"

    def scan(self, done: Done) -> None:
        if done.trace:
            with self._path.open("a", encoding="utf-8", errors="replace") as log:
                log.write(f"{done.name}: {done.row['reason']}\n{done.trace}\n")


@dataclass
class Tally:
    """How many scans ended how."""

    ok: int = 0
    warned: int = 0
    failed: int = 0
    kept: int = 0
    kept_warned: int = 0
    causes: Counter[str] = field(default_factory=Counter)

    def add(self, done: Done) -> None:
        self.ok += done.ok
        self.failed += not done.ok
        self.warned += done.ok and bool(done.warnings)
        self.kept += done.kept
        self.kept_warned += done.kept and done.ok and bool(done.warnings)
        if not done.ok:
            self.causes[done.cause] += 1

    @property
    def total(self) -> int:
        return self.ok + self.failed

    def __str__(self) -> str:
        return f"ok {self.ok}, of them warned {self.warned}, failed {self.failed}"


class Progress(Sink):
    """Scans done, their rate, the time left, and how many are ok, warned of, failed: a bar on a terminal, a line now
    and then in a log. Notes, warnings and failures are said as they come; in large runs failures only.

    Args:
        seconds: between two lines in a log, at most: the first ones come sooner.
        details: largest number of scans whose notes and warnings are said one by one.
    """

    tells = True

    def __init__(self, seconds: float = 30.0, details: int = 60):
        self._seconds, self._details = seconds, details
        self._watched = sys.stderr.isatty()
        self._bar: Any = None
        self._tally = Tally()
        self._failures: set[str] = set()
        self._notes: set[tuple[str, str]] = set()
        self._activity = Activity()
        self._begun = self._said = self._pause = 0.0
        self._total = 0

    def starting(self) -> None:
        self._watched = sys.stderr.isatty()
        print("finding the scans", end="\r" if self._watched else "\n", file=sys.stderr, flush=True)

    def open(self, overview: Overview) -> None:
        from tqdm import tqdm

        self._tally, self._total = Tally(), len(overview.names)
        self._failures, self._notes = set(), set()
        self._bar = tqdm(
            total=self._total,
            desc="scans",
            unit="scan",
            mininterval=0.2 if self._watched else self._seconds,
            dynamic_ncols=True,
            leave=True,
            disable=False if self._watched else None,
            smoothing=0.05,
        )
        if not self._watched:
            self._bar.disable = True
            self._line(f"0 of {self._total} scans")
            self._begun = self._said = time.monotonic()
            self._pause = min(FIRST, self._seconds)

    def note(self, line: str) -> None:
        self._line(f"note: {line}")

    def activity(self, activity: Activity) -> None:
        if self._bar is None:
            return
        if self._watched and activity != self._activity:
            self._activity = activity
            self._show()
        self._activity = activity
        if not self._watched:
            self._now_and_then()

    def scan(self, done: Done) -> None:
        self._tally.add(done)
        if done.kept:
            pass  # it was said when it was fitted
        elif not done.ok:
            self._failure(_failure_line(done))
        elif self._total <= self._details:
            for note in done.notes:
                self._note(re.sub(r"_(left|right)$", "", done.name), note)
            for warning in done.warnings:
                self._line(f"warning: {done.name}: {warning}")
        if self._watched:
            self._bar.update()
            self._show()
        else:
            self._now_and_then()

    def close(self, complete: bool) -> None:
        if self._bar is not None:
            self._bar.close()

    def _now_and_then(self) -> None:
        """A line in a log, the first ones soon, later ones every so many seconds."""
        if time.monotonic() - self._said >= self._pause:
            self._said = time.monotonic()
            self._pause = min(2 * self._pause, self._seconds)
            self._line(self._state())

    def _state(self) -> str:
        done, seconds = self._tally.total, time.monotonic() - self._begun
        fresh = done - self._tally.kept
        if not fresh:
            kept = ", all as they were" * bool(done)
            return f"{done} of {self._total} scans{kept}; {self._activity}"
        rate = fresh / seconds
        left = (self._total - done) / rate
        return (
            f"{done} of {self._total} scans: {self._tally}; {self._activity}; {rate:.2f} scans/s, {_clock(left)} left"
        )

    def _show(self) -> None:
        self._bar.set_postfix_str(f"{self._tally}; {self._activity}", refresh=False)

    def _failure(self, line: str) -> None:
        """Say why a scan failed; what keeps both breasts of a file from being fitted is one failure."""
        if line not in self._failures:
            self._failures.add(line)
            self._line(line)

    def _note(self, file: str, note: str) -> None:
        """Say a note; what holds for both breasts of a file is said once."""
        if (file, note) not in self._notes:
            self._notes.add((file, note))
            self._line(f"note: {note}")

    def _line(self, text: str) -> None:
        from tqdm import tqdm

        tqdm.write(text, file=sys.stderr)


def _failure_line(done: Done) -> str:
    """Why a scan failed, and which: mostly the file that the reason begins with says which."""
    named = done.file and Path(done.file).stem in done.name
    return f"failed: {done.row['reason']}" if named else f"failed: {done.name}: {done.row['reason']}"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
