"""A batch on several processor cores: its scans are independent, so each core fits some of them.

The first shard stays in this process, each other one goes to a process of its own, which is kept for the next batch.
Threads would not do: the thousands of small operations of a fit hold the interpreter's lock in turn, and two threads
are slower than one.
"""

from __future__ import annotations

import atexit
import contextlib
import itertools
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TypeVar

import torch

from brafit.fit.solver import Callback, Step

LEAST = 4
"""Items that are worth a process of their own."""
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_shards(
    work: Callable[[Sequence[Item], Callback | None], list[Result]],
    items: Sequence[Item],
    count: int,
    callback: Callback | None = None,
) -> list[Result]:
    """`work` on the items, in at most `count` shards of neighbouring ones at a time; results in the items' order.

    The callback hears of all shards together, as far as the slowest of them has come. What cannot be sent to another
    process (a local function) is done here, as is the share of a process that dies.
    """
    count = min(count, len(items) // LEAST)
    jobs: list[bytes] = []
    bounds = [round(k * len(items) / max(1, count)) for k in range(max(1, count) + 1)]
    shards = [items[a:b] for a, b in itertools.pairwise(bounds)]
    if count > 1:
        try:
            jobs = [pickle.dumps((work, shard)) for shard in shards[1:]]
        except (pickle.PicklingError, AttributeError, TypeError):
            jobs = []
    # More threads inside an operation wait for each other thousands of times, ever longer on a busy machine.
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return _shared(work, shards, jobs, callback) if jobs else work(items, callback)
    finally:
        torch.set_num_threads(before)


def _shared(
    work: Callable[[Sequence[Item], Callback | None], list[Result]],
    shards: Sequence[Sequence[Item]],
    jobs: Sequence[bytes],
    callback: Callback | None,
) -> list[Result]:
    """The first shard done here, each other one by the process that gets its job."""
    count = len(shards)
    together = None if callback is None else _Together(callback, [sum(map(len, shards[:k])) for k in range(count)])
    tell = [None if together is None else partial(together.tell, k) for k in range(count)]
    helpers = _POOL.take(len(jobs))

    def elsewhere(k: int) -> list[Result]:
        try:
            results = helpers[k - 1].run(jobs[k - 1], tell[k])
            return work(shards[k], tell[k]) if results is None else results
        finally:
            if together is not None:
                together.end(k)

    try:
        with ThreadPoolExecutor(len(jobs)) as pool:
            others = [pool.submit(elsewhere, k) for k in range(1, count)]
            results = work(shards[0], tell[0])
            if together is not None:
                together.end(0)
            return results + [result for other in others for result in other.result()]
    finally:
        _POOL.give_back(helpers)


def prepare(items: int, count: int) -> None:
    """Start the processes that so many items in so many shards will need, so that they are ready when the fit is."""
    _POOL.give_back(_POOL.take(max(0, min(count, items // LEAST) - 1)))


class _Helper:
    """A process that does jobs."""

    def __init__(self):
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-P", "-m", "brafit.fit.worker"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._jobs, self._answers = self._process.stdin, self._process.stdout
        self.idle = True

    def run(self, job: bytes, tell: Callback | None) -> list | None:
        """The results of a job; None if the process is gone.

        Raises:
            Exception: whatever the job raised.
        """
        self.idle = False
        try:
            self._jobs.write(job)
            self._jobs.flush()
            while True:
                kind, content = pickle.load(self._answers)
                if kind == "step":
                    if tell is not None:
                        tell(content)
                    continue
                self.idle = True
                if kind == "error":
                    raise content
                return content
        except (EOFError, BrokenPipeError, pickle.UnpicklingError):
            return None

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._jobs, self._answers):
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


class _Pool:
    """The helpers of this process that have nothing to do."""

    def __init__(self):
        self._idle: list[_Helper] = []
        self._lock = threading.Lock()

    def take(self, count: int) -> list[_Helper]:
        with self._lock:
            taken, self._idle = self._idle[:count], self._idle[count:]
        return taken + [_Helper() for _ in range(count - len(taken))]

    def give_back(self, helpers: Sequence[_Helper]) -> None:
        """Those that are in the middle of something, because this process gave up waiting, are ended."""
        for helper in helpers:
            if not helper.idle:
                helper.close()
        with self._lock:
            self._idle += [helper for helper in helpers if helper.idle]

    def close(self) -> None:
        with self._lock:
            idle, self._idle = self._idle, []
        for helper in idle:
            helper.close()


_POOL = _Pool()
atexit.register(_POOL.close)


class _Together:
    """Makes one report of the shards' own."""

    def __init__(self, callback: Callback, firsts: Sequence[int]):
        """`firsts`: places of the shards' first items."""
        count = len(firsts)
        self._callback, self._firsts, self._lock = callback, firsts, threading.Lock()
        self._last: list[Step | None] = [None] * count
        self._running = [True] * count
        self._told = -1

    def tell(self, shard: int, step: Step) -> None:
        """Pass on what all shards last said, once the slowest has come further."""
        with self._lock:
            self._last[shard] = replace(step, scans=step.scans + self._firsts[shard])
            self._report()

    def end(self, shard: int) -> None:
        """The shard has no more to say."""
        with self._lock:
            self._running[shard] = False
            self._report()

    def _report(self) -> None:
        steps = [step for step in self._last if step is not None]
        waiting = [step for step, running in zip(self._last, self._running, strict=True) if running]
        if not steps or any(step is None for step in waiting):
            return
        running = [step for step in waiting if step is not None]
        slowest = min(running, key=lambda s: s.index) if running else max(steps, key=lambda s: s.index)
        if slowest.index <= self._told:
            return
        self._told = slowest.index
        scans = torch.cat([step.scans for step in steps])
        unknown = torch.full(scans.shape, torch.nan).split([len(step.scans) for step in steps])
        terms = {
            k: torch.cat([step.terms.get(k, nan) for step, nan in zip(steps, unknown, strict=True)])
            for k in slowest.terms
        }
        self._callback(Step(slowest.stage, slowest.index, slowest.total, terms, scans))
