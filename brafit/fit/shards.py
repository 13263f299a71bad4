"""A batch on several processor cores: its scans are independent, so each core fits some of them.

That pays more than several threads inside each operation, which wait for each other thousands of times.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

import torch

from brafit.fit.solver import Callback, Step

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_shards(
    work: Callable[[Sequence[Item], Callback | None], list[Result]],
    items: Sequence[Item],
    count: int,
    callback: Callback | None = None,
) -> list[Result]:
    """`work` on the items, in at most `count` shards of neighbouring ones at a time; results in the items' order.

    The callback hears of all shards together, as far as the slowest of them has come.
    """
    count = min(count, len(items))
    if count <= 1:
        return work(items, callback)
    bounds = [round(k * len(items) / count) for k in range(count + 1)]
    shards = [items[a:b] for a, b in itertools.pairwise(bounds)]
    together = None if callback is None else _Together(callback, count)
    before = torch.get_num_threads()

    def run(k: int) -> list[Result]:
        torch.set_num_threads(1)
        try:
            return work(shards[k], None if together is None else partial(together.tell, k))
        finally:
            if together is not None:
                together.end(k)

    try:
        with ThreadPoolExecutor(count) as pool:
            return [result for part in pool.map(run, range(count)) for result in part]
    finally:
        torch.set_num_threads(before)


class _Together:
    """Makes one report of the shards' own."""

    def __init__(self, callback: Callback, count: int):
        self._callback, self._lock = callback, threading.Lock()
        self._last: list[Step | None] = [None] * count
        self._running = [True] * count
        self._told = -1

    def tell(self, shard: int, step: Step) -> None:
        """Pass on what all shards last said, once the slowest has come further."""
        with self._lock:
            self._last[shard] = step
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
        same = [step for step in steps if step.stage == slowest.stage]
        terms = {k: torch.cat([step.terms[k] for step in same if k in step.terms]) for k in slowest.terms}
        self._callback(Step(slowest.stage, slowest.index, slowest.total, terms))
