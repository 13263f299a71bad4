"""How a dataset is parted into batches: small ones cost more a scan, few ones leave workers without a fit."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from brafit.processes import Pool, Returned
from brafit.run.conductor import LEAST, _Conductor, batch_size, last_size
from brafit.run.dataset import ScanRef
from brafit.run.job import Done, Job

LOAD, FINISH = 0.1, 0.12
"""Seconds of a scan, as on the machine of docs/figures.md; a fit's by the size of its batch: `fit_seconds`."""


def fit_seconds(count: int) -> float:
    a_scan = np.interp(np.log(count), np.log([1, 4, 7, 14, 28, 56]), [1.2, 0.5, 0.38, 0.285, 0.2, 0.154])
    return count * float(a_scan)


class Clock:
    """Stands for a pool of processes whose calls take the time that they are said to, and no time of ours."""

    def __init__(self, count: int, scans: int):
        self.count, self.scans, self.now = count, scans, 0.0
        self.batches: list[int] = []
        self._running: list[tuple[float, int, Any]] = []

    @property
    def free(self) -> int:
        return self.count - len(self._running)

    def submit(self, key: int, function: str, *arguments: Any, patience: float = 0.0) -> None:
        stage = function.partition(":")[2]
        if stage == "begin":
            refs = [ScanRef(Path(f"{k}.ply"), (f"{k}",), (None,), (k,)) for k in range(self.scans)]
            took, value = 0.0, (refs, [], {})
        elif stage == "load":
            took, value = LOAD, [b"scan"]
        elif stage == "fit":
            self.batches.append(len(arguments[1]))
            took, value = fit_seconds(self.batches[-1]), [b"fit"] * self.batches[-1]
        else:
            took, value = FINISH, Done(0, "scan", {"status": "ok"})
        heapq.heappush(self._running, (self.now + took, key, value))

    def events(self, timeout: float | None = None) -> Iterator[tuple[int, Returned]]:
        self.now, key, value = heapq.heappop(self._running)
        yield key, Returned(value)


@pytest.mark.parametrize(
    ("workers", "scans", "batches", "idle"),
    [
        (2, 14, [7, 7], 0.05),
        (2, 20, [10, 10], 0.05),
        (2, 56, [28, 28], 0.05),
        (2, 112, [56, 56], 0.05),
        (2, 224, [56, 56, 56, 56], 0.05),
        (4, 56, [14, 14, 14, 14], 0.1),
        (4, 112, [28, 28, 28, 28], 0.1),
        (1, 14, [14], 0.01),
    ],
)
def test_batches_are_large_and_all_workers_busy(
    workers: int, scans: int, batches: list[int], idle: float, tmp_path: Path
) -> None:
    clock = Clock(workers, scans)
    conductor = _Conductor(Job(tmp_path / "out", cast(Any, None), workers=workers), cast(Pool, clock))
    conductor.begin()
    conductor.go_on()
    assert len(conductor.done) == scans
    assert clock.batches == batches
    work = scans * (LOAD + FINISH) + sum(map(fit_seconds, batches))
    assert clock.now < (1 + idle) * work / workers


def parted(left: int, share: int, idle: list[int]) -> list[int]:
    """Sizes of the last batches, if so many workers fit nothing when each is taken."""
    sizes = []
    for count in idle:
        if left:
            sizes.append(min(left, last_size(left, share, count)))
            left -= sizes[-1]
    assert left == 0
    return sizes


def test_what_is_left_is_parted_among_the_idle_and_no_further() -> None:
    assert parted(56, 28, [1, 2, 1]) == [28, 14, 14]
    assert parted(56, 28, [1, 1]) == [28, 28]
    assert parted(28, 28, [3, 2, 1]) == [10, 9, 9]


def test_one_worker_takes_all_while_the_other_fits_and_then_writes() -> None:
    assert batch_size(56, 56, 1) == 56
    assert batch_size(100, 56, 1) == 50


def test_batches_of_few_scans_are_not_made() -> None:
    assert parted(2 * LEAST - 1, 56, [2]) == [2 * LEAST - 1]
    assert parted(2 * LEAST, 56, [2, 1]) == [LEAST, LEAST]
    assert batch_size(14, 56, 8) == 5
    assert batch_size(LEAST - 1, 56, 8) == LEAST - 1
