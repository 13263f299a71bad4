"""Processes that work for this one: what comes back of good calls and of bad ones."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any

import pytest

from brafit.processes import Event, Lost, Pool, Raised, Returned, Told


@pytest.fixture
def pool() -> Iterator[Pool]:
    with Pool(2) as pool:
        yield pool


def outcome(pool: Pool, *keys: Any) -> dict[Any, list[Event]]:
    found: dict[Any, list[Event]] = {key: [] for key in keys}
    while pool.free < pool.count:
        for key, event in pool.events():
            found[key].append(event)
    return found


# What the processes do; they find these functions by the name of this module.


def doubled(value: int, tell: Any) -> int:
    tell(f"doubling {value}")
    return 2 * value


def dies(signal: int, tell: Any) -> None:
    os.kill(os.getpid(), signal)


def leaves(status: int, tell: Any) -> None:
    os._exit(status)


def sleeps(seconds: float, tell: Any) -> str:
    for _ in range(5):
        time.sleep(seconds / 5)
        tell("still here")
    return "rested"


class OddError(Exception):
    """An error that cannot be made again from its text."""

    def __init__(self, one: int, two: int):
        super().__init__(f"{one} and {two}")


def raises(kind: str, tell: Any) -> None:
    raise OddError(1, 2) if kind == "odd" else ValueError("no such value")


def test_calls_run_side_by_side_and_tell(pool: Pool) -> None:
    pool.submit("a", f"{__name__}:doubled", 3)
    pool.submit("b", f"{__name__}:doubled", 4)
    assert pool.free == 0
    with pytest.raises(RuntimeError, match="no process is free"):
        pool.submit("c", f"{__name__}:doubled", 5)
    found = outcome(pool, "a", "b")
    assert found["a"] == [Told("doubling 3"), Returned(6)]
    assert found["b"] == [Told("doubling 4"), Returned(8)]


@pytest.mark.parametrize(
    ("function", "argument", "reason", "killed"),
    [
        ("dies", 11, "crashed (SIGSEGV)", False),
        ("dies", 9, "was killed (SIGKILL), most likely for want of memory", True),
        ("leaves", 3, "ended with exit status 3", False),
    ],
)
def test_a_death_costs_its_own_call(pool: Pool, function: str, argument: int, reason: str, killed: bool) -> None:
    pool.submit("bad", f"{__name__}:{function}", argument)
    pool.submit("good", f"{__name__}:doubled", 1)
    found = outcome(pool, "bad", "good")
    assert found["bad"] == [Lost(reason, killed)]
    assert found["good"][-1] == Returned(2)
    pool.submit("next", f"{__name__}:doubled", 2)
    assert outcome(pool, "next")["next"][-1] == Returned(4)


def test_silence_is_limited_not_length(pool: Pool) -> None:
    pool.submit("talks", f"{__name__}:sleeps", 3.0, patience=2.0)
    pool.submit("silent", f"{__name__}:sleeps", 60.0, patience=2.0)
    found = outcome(pool, "talks", "silent")
    assert found["talks"][-1] == Returned("rested")
    assert found["silent"] == [Lost("took longer than 2 s", late=True)]


@pytest.mark.parametrize(
    ("kind", "error"), [("value", ValueError("no such value")), ("odd", RuntimeError("OddError: 1 and 2"))]
)
def test_errors_come_back_with_their_place(pool: Pool, kind: str, error: Exception) -> None:
    pool.submit("bad", f"{__name__}:raises", kind)
    (event,) = outcome(pool, "bad")["bad"]
    assert isinstance(event, Raised)
    assert repr(event.error) == repr(error)
    assert "in raises" in event.trace
