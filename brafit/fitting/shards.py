"""A batch on several processor cores: its scans are independent, so each core fits some of them.

Each shard goes to a process of its own; they are kept for the next batch. Threads would not do: the thousands of small
operations of a fit hold the interpreter's lock in turn, and two threads are slower than one.
"""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import torch

from brafit.fitting.solver import Callback, Step
from brafit.processes import Lost, Pool, Raised, Returned, Told

LEAST = 4
"""Items that are worth a process of their own."""
PATIENCE = 3600.0
"""Seconds that a shard may be silent."""
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
    if count > 1:
        bounds = [round(k * len(items) / count) for k in range(count + 1)]
        shards = [items[a:b] for a, b in itertools.pairwise(bounds)]
        try:
            jobs = [pickle.dumps((work, shard)) for shard in shards]
        except (pickle.PicklingError, AttributeError, TypeError):
            jobs = []
        if jobs:
            return _shared(work, shards, jobs, callback)
    # More threads inside an operation wait for each other thousands of times, ever longer on a busy machine.
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return work(items, callback)
    finally:
        torch.set_num_threads(before)


def do(job: bytes, tell: Callback) -> list:
    """A shard's work, in its process."""
    work, items = pickle.loads(job)
    return work(items, tell)


def _shared(
    work: Callable[[Sequence[Item], Callback | None], list[Result]],
    shards: Sequence[Sequence[Item]],
    jobs: Sequence[bytes],
    callback: Callback | None,
) -> list[Result]:
    """Each shard done by a process."""
    together = None if callback is None else _Together(callback, [len(shard) for shard in shards])
    pool = _pool(len(shards))
    results: list[list[Result] | None] = [None] * len(shards)
    try:
        for k, job in enumerate(jobs):
            pool.submit(k, "brafit.fitting.shards:do", job, patience=PATIENCE)
        while pool.free < pool.count:
            for k, event in pool.events():
                assert isinstance(k, int)
                if isinstance(event, Raised):
                    raise event.error
                if isinstance(event, Told) and together is not None:
                    together.tell(k, event.content)
                if isinstance(event, Returned):
                    results[k] = event.value
                if isinstance(event, Returned | Lost) and together is not None:
                    together.end(k)
    except BaseException:
        pool.close()  # nobody waits for the others any more
        raise
    return [
        result
        for shard, done in zip(shards, results, strict=True)
        for result in (work(shard, None) if done is None else done)
    ]


_POOL: Pool | None = None


def _pool(count: int) -> Pool:
    """This process's pool, with `count` processes."""
    global _POOL
    if _POOL is None or _POOL.count != count or _POOL.closed:
        if _POOL is not None:
            _POOL.close()
        _POOL = Pool(count, ["brafit.fitting"])
    return _POOL


class _Together:
    """Makes one report of the shards' own."""

    def __init__(self, callback: Callback, sizes: Sequence[int]):
        self._callback = callback
        self._first = [0, *itertools.accumulate(sizes)]
        self._last: list[Step | None] = [None] * len(sizes)
        self._running = [True] * len(sizes)
        self._told = -1

    def tell(self, shard: int, step: Step) -> None:
        """Pass on what all shards last said, once the slowest has come further."""
        self._last[shard] = replace(step, scans=step.scans + self._first[shard])
        self._report()

    def end(self, shard: int) -> None:
        """The shard has no more to say."""
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
        terms = {k: torch.cat([step.terms[k] for step in steps if k in step.terms]) for k in slowest.terms}
        scans = torch.cat([step.scans for step in steps])
        self._callback(Step(slowest.stage, slowest.index, slowest.total, terms, scans))
