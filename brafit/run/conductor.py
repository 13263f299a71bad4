"""Conducts a run: hands files, batches and fits to the workers, as a stream, and what comes of them to the sinks.

A free worker takes a fit to finish, if there is one; else a batch to fit, if one is full or nothing more will come;
else a file to load, as long as no more than two batches for each worker wait. So all workers are busy, and memory does
not grow with the dataset. What crashes or hangs is charged to its own scan: a batch that does is halved until one scan
is left.
"""

from __future__ import annotations

import math
import pickle
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from brafit.errors import BrafitError
from brafit.processes import Event, Lost, Pool, Raised, Returned, Told
from brafit.run.dataset import ScanRef
from brafit.run.folder import is_about_writing, why_not
from brafit.run.job import KEEP, PRELOAD, Doing, Done, Job, Overview, Row
from brafit.run.sinks import Activity
from brafit.run.store import Earlier, earlier, left_behind

STAGES = "brafit.run.stages"
LEAST = 4
"""Scans that are worth a batch of their own."""
AHEAD = 2
"""Files of each worker that may be loaded ahead of a batch, in batches."""
_REMEDIES = {
    Doing.READING: "Export it again, as a binary .ply; a very large file may need more: scan.read_seconds",
    Doing.PREPARING: "Look at it in a viewer; a very large cloud may need more: scan.read_seconds",
    Doing.FITTING: "Fit it alone, or with other settings; a slow fit may need more: patience",
    Doing.WRITING: "Run it again; a slow disk may need more: patience",
}


def run(job: Job, say: Callable[[str], None] | None = None) -> list[Row]:
    """Fit all scans of a job.

    A scan that cannot be read or fitted becomes a row of status `failed` with its reason, and the others go on.

    Args:
        job: what to do, with how many processes, and who hears of it.
        say: takes the closing table and where the results are, as a text of several lines; None: nothing is said.

    Returns:
        a row for each scan, in the dataset's order.

    Raises:
        InputError: no scan was found.
        BrafitError: nothing can run (a setting out of its range, Open3D missing).
    """
    from brafit.run.closing import closing  # after the workers are on their way

    with Pool(job.workers, PRELOAD) as pool:
        conductor = _Conductor(job, pool)
        conductor.begin()
        try:
            conductor.go_on()
        finally:
            conductor.close()
    if say is not None:
        told = any(sink.tells for sink in job.sinks)
        say(closing(conductor.done, job.out, told=told, earlier=conductor.earlier))
    return [done.row for done in conductor.done]


def batch_size(count: int, most: int, workers: int) -> int:
    """Scans of a batch where there are so many: no more than asked for, and work for every worker."""
    batches = math.ceil(count / most)
    batches += -batches % _worth(count, workers)
    return max(1, math.ceil(count / max(1, batches)))


def last_size(left: int, share: int, idle: int) -> int:
    """Scans of a batch where no more will come: a share of what was left then, and of less than that a part for every
    worker that fits nothing. To part anew whatever a batch leaves would end in many small ones, which cost more a scan;
    and a worker that fits has the files of its own batch to write, while another fits the last.

    Args:
        left: scans that are not fitted yet.
        share: the `batch_size` of what was left when no more came, for the workers that fitted nothing.
        idle: workers that fit nothing.
    """
    return min(share, math.ceil(left / _worth(left, idle)))


def _worth(count: int, workers: int) -> int:
    """Workers for whom so many scans are worth batches of their own."""
    return max(1, min(workers, count // LEAST))


@dataclass
class _Loading:
    ref: ScanRef
    again: bool = False
    stage: Doing = Doing.READING


@dataclass(frozen=True, eq=False)
class _Loaded:
    """A scan that waits for its fit: its file, which breast of it, and the scan as bytes."""

    ref: ScanRef
    k: int
    scan: bytes

    @property
    def name(self) -> str:
        return self.ref.names[self.k]


@dataclass(frozen=True, eq=False)
class _Fitting:
    number: int
    scans: tuple[_Loaded, ...]
    again: bool = False


@dataclass(frozen=True, eq=False)
class _Finishing:
    loaded: _Loaded
    fit: bytes
    again: bool = False


@dataclass(frozen=True, eq=False)
class _Failing:
    """Writes down a failure that its own worker could not."""

    ref: ScanRef
    k: int
    cause: str
    trace: str = ""


@dataclass
class _Queues:
    refs: deque[_Loading] = field(default_factory=deque)
    loaded: dict[tuple[str, ...], list[_Loaded]] = field(default_factory=dict)
    fits: deque[_Fitting] = field(default_factory=deque)
    finishing: deque[_Finishing | _Failing] = field(default_factory=deque)

    @property
    def waiting(self) -> int:
        return sum(map(len, self.loaded.values()))


class _Conductor:
    def __init__(self, job: Job, pool: Pool):
        self.job, self.pool = job, pool
        self.source = pickle.dumps(job.recipe)
        self.queues = _Queues()
        self.busy: dict[int, Any] = {}
        self.done: list[Done] = []
        self._next = 0
        self._batches = 0
        self._shares: dict[tuple[str, ...], int] = {}  # of the last batches, by their scans' own settings
        self._total = 0
        self._overview: Overview | None = None
        self._settings: Mapping[str, Any] = {}
        self.earlier = Earlier()
        self._begun = 0.0
        self._watched: frozenset[str] = frozenset()

    def begin(self) -> None:
        """Find the scans and open the sinks."""
        job = self.job
        for sink in job.sinks:
            sink.starting()
        refs, notes, self._settings = self._ask("begin", self.source, job.scans, job.side, job.manifest, job.shard)
        self.queues.refs.extend(map(_Loading, refs))
        names = tuple(name for ref in refs for name in ref.names)
        self._total = len(names)
        wanted = max((sink.watches for sink in job.sinks), default=0)
        self._watched = frozenset(names[:wanted])
        overview = Overview(
            out=job.out,
            names=names,
            positions=tuple(position for ref in refs for position in ref.positions),
            shard=job.shard,
            resumed=job.resume == KEEP and job.out.is_dir(),
            watched=names[:wanted],
        )
        job.out.mkdir(parents=True, exist_ok=True)
        self._overview, self._begun = overview, time.time()
        for sink in job.sinks:
            sink.open(overview)
            for note in notes:
                sink.note(note)

    def _ask(self, function: str, *arguments: Any) -> Any:
        """A call that everything else waits for."""
        self.pool.submit(0, f"{STAGES}:{function}", *arguments)
        while True:
            for _, event in self.pool.events():
                if isinstance(event, Returned):
                    return event.value
                if isinstance(event, Raised):
                    raise event.error
                if isinstance(event, Lost):
                    raise BrafitError(f"a process of this run {event.reason} as it started")

    def go_on(self) -> None:
        """All scans, to their ends."""
        while True:
            while self.pool.free and (task := self._next_task()) is not None:
                self._start(task)
            if not self.busy:
                break
            self._show()
            for key, event in self.pool.events():
                self._hear(key, event)
        self.done.sort(key=lambda done: done.position)

    def close(self) -> None:
        complete = len(self.done) == self._total
        if not complete and self._overview is not None:
            self.pool.close()  # no worker writes another result behind what is read now
            since = None if self._overview.resumed else self._begun
            for done in left_behind(self._overview, {done.name for done in self.done}, since):
                self._finished(done)
        if self._overview is not None:
            self.earlier = earlier(self._overview, self._settings)
            for sink in self.job.sinks:
                for done in self.earlier.taken:
                    sink.earlier(done)
        for sink in self.job.sinks:
            sink.close(complete)

    # What is next

    def _next_task(self) -> Any:
        queues = self.queues
        if queues.finishing:
            return queues.finishing.popleft()
        if not (self.job.one_fit and any(isinstance(task, _Fitting) for task in self.busy.values())):
            if queues.fits:
                return queues.fits.popleft()
            if (batch := self._batch()) is not None:
                return batch
        ahead = AHEAD * self.job.batch * self.job.workers
        if queues.refs and queues.waiting + self._loading() < ahead:
            return queues.refs.popleft()
        return None

    def _loading(self) -> int:
        return sum(len(task.ref.names) for task in self.busy.values() if isinstance(task, _Loading))

    def _batch(self) -> _Fitting | None:
        """A full batch, or, where no more will come, a fair share of what is left."""
        job, last = self.job, not self.queues.refs
        fitters = 1 if job.one_fit else job.workers
        idle = fitters - sum(isinstance(task, _Fitting) for task in self.busy.values())
        for overrides, waiting in self.queues.loaded.items():
            if not waiting:
                continue
            size = batch_size(self._total, job.batch, fitters)
            if last:
                left = len(waiting) + self._loading()
                share = self._shares.setdefault(overrides, batch_size(left, job.batch, idle))
                size = last_size(left, share, idle)
            if last or len(waiting) >= size:
                waiting.sort(key=lambda one: one.ref.positions[one.k])
                chosen, self.queues.loaded[overrides] = waiting[:size], waiting[size:]
                self._batches += 1
                return _Fitting(self._batches, tuple(chosen))
        return None

    def _start(self, task: Any) -> None:
        self._next += 1
        key, job = self._next, self.job
        self.busy[key] = task
        patience = job.patience
        call: tuple[Any, ...]
        if isinstance(task, _Loading):
            patience = job.read_patience
            call = ("load", self.source, task.ref, job.out, job.resume == KEEP)
        elif isinstance(task, _Fitting):
            watched = [one.name for one in task.scans if one.name in self._watched]
            call = ("fit", self.source, [one.scan for one in task.scans], watched)
        elif isinstance(task, _Finishing):
            call = ("finish", self.source, task.loaded.scan, task.fit, job.out, task.loaded.name in self._watched)
        else:
            call = ("fail", self.source, task.ref, task.k, task.cause, job.out)
        self.pool.submit(key, f"{STAGES}:{call[0]}", *call[1:], patience=patience)

    # What came of it

    def _hear(self, key: Any, event: Event) -> None:
        task = self.busy[key]
        if isinstance(event, Told):
            if isinstance(task, _Fitting):
                for sink in self.job.sinks:
                    sink.step(task.number, event.content)
            elif isinstance(task, _Loading):
                task.stage = event.content
            return
        del self.busy[key]
        if isinstance(event, Returned):
            self._returned(task, event.value)
        else:
            self._failed(task, event)

    def _returned(self, task: Any, value: Any) -> None:
        if isinstance(task, _Loading):
            for k, one in enumerate(value):
                if isinstance(one, Done):
                    self._finished(one)
                else:
                    self.queues.loaded.setdefault(task.ref.overrides, []).append(_Loaded(task.ref, k, one))
        elif isinstance(task, _Fitting):
            self.queues.finishing.extend(map(_Finishing, task.scans, value))
        elif isinstance(task, _Failing):
            self._finished(replace(value, trace=task.trace))
        else:
            self._finished(value)

    def _finished(self, done: Done) -> None:
        for sink in self.job.sinks:
            sink.scan(done)
        # what sinks want is with them: of pictures nothing is kept
        self.done.append(replace(done, pictures={}, mesh=None, trace=""))

    def _failed(self, task: Any, event: Raised | Lost) -> None:
        """What is to be done about a call that came to nothing."""
        innocent = isinstance(event, Lost) and event.killed and not getattr(task, "again", True)
        if isinstance(task, _Fitting):
            if len(task.scans) > 1:
                middle = len(task.scans) // 2
                halves = (task.scans[:middle], task.scans[middle:])
                self.queues.fits.extend(_Fitting(task.number, half) for half in halves)
            elif innocent:
                self.queues.fits.append(_Fitting(task.number, task.scans, True))
            else:
                alone = next(iter(task.scans))
                self._charge(alone.ref, alone.k, Doing.FITTING, event)
        elif isinstance(task, _Finishing):
            if innocent:
                self.queues.finishing.append(_Finishing(task.loaded, task.fit, True))
            else:
                self._charge(task.loaded.ref, task.loaded.k, Doing.WRITING, event)
        elif isinstance(task, _Loading):
            if innocent:
                self.queues.refs.append(_Loading(task.ref, True))
            else:
                for k in range(len(task.ref.names)):
                    self._charge(task.ref, k, task.stage, event)
        else:
            raise BrafitError(f"{task.ref.path}: its failure cannot be written down: {_why(self.job.out, event)}")

    def _charge(self, ref: ScanRef, k: int, during: Doing, event: Raised | Lost) -> None:
        trace = ""
        if isinstance(event, Lost):
            cause = f"{during.value} {_ending(event)}. {_REMEDIES[during]}."
        elif is_about_writing(event.error) and during is not Doing.READING:
            cause = f"its results cannot be written: {why_not(self.job.out, event.error)}."
        else:
            said = " ".join(str(event.error).split())[:200]
            cause = f"unexpected {type(event.error).__name__} in {during.value}: {said} (see errors.log)"
            trace = event.trace
        self.queues.finishing.append(_Failing(ref, k, cause, trace))

    def _show(self) -> None:
        kinds = [type(task) for task in self.busy.values()]
        fitting = sum(len(task.scans) for task in self.busy.values() if isinstance(task, _Fitting))
        writing = kinds.count(_Finishing) + len(self.queues.finishing)
        activity = Activity(loading=kinds.count(_Loading), fitting=fitting, writing=writing)
        for sink in self.job.sinks:
            sink.activity(activity)


def _why(out: Path, event: Raised | Lost) -> str:
    if isinstance(event, Lost):
        return _ending(event)
    if is_about_writing(event.error):
        return why_not(out, event.error)
    return " ".join(f"{type(event.error).__name__} {event.error}".split())


def _ending(event: Lost) -> str:
    return event.reason if event.late else f"failed: the process {event.reason}"
