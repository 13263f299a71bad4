"""Recipes that go wrong on purpose. A module of its own, as workers import it by name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from brafit.cup import FramesCup
from brafit.fitting import Anneal, AnnealStage, Conditions, CupFit, ResultCode, Target
from brafit.pattern import PatternOptions
from brafit.run.recipe import Recipe

LEAN = PatternOptions(formats=("svg",), meshes=(), report=False)


def plain(pattern: PatternOptions = LEAN, kind: type[Recipe] = Recipe, **more: Any) -> Recipe:
    """A fit that ends in a second; how good it is does not matter here."""
    return kind(
        cup=partial(FramesCup, panels=2, terms=2, stations=21),
        solver=Anneal([AnnealStage("adam", 3, 1.0), AnnealStage("lbfgs", 5, 10.0)]),
        condition=Conditions(),
        pattern=pattern,
        scan={"points": 60},
        **more,
    )


@dataclass(frozen=True)
class Faulty(Recipe):
    """Does something to every batch that has a scan of this name."""

    victim: str = ""
    fault: str = ""

    def fit(self, targets: Sequence[Target], callback: Callable | None = None, threads: int = 1) -> list[CupFit]:
        if any(target.name == self.victim for target in targets):
            FAULTS[self.fault]()
        return super().fit(targets, callback, threads)


@dataclass(frozen=True)
class Spoilt(Recipe):
    """Makes fits that cannot be used: the first diverges, the second cannot be measured."""

    def fit(self, targets: Sequence[Target], callback: Callable | None = None, threads: int = 1) -> list[CupFit]:
        return [_spoilt(fit) for fit in super().fit(targets, callback, threads)]


def _spoilt(fit: CupFit) -> CupFit:
    if fit.name == "anny_01":
        return replace(fit, code=ResultCode.DIVERGED, reason=ResultCode.DIVERGED.value)
    if fit.name == "anny_04":
        return replace(fit, figures=fit.figures | {"twist_deg_max": float("nan")})
    return replace(fit, code=ResultCode.STEP_LIMIT)


def breaks() -> None:
    raise RuntimeError("something\nnobody thought of")


def crashes() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hangs() -> None:
    time.sleep(1000)


def eats_memory() -> None:
    os.kill(os.getpid(), signal.SIGKILL)  # as the kernel does


FAULTS: dict[str, Callable[[], None]] = {
    "breaks": breaks, "crashes": crashes, "hangs": hangs, "eats_memory": eats_memory,
}  # fmt: skip


def faulty(victim: str, fault: str) -> Recipe:
    return plain(kind=Faulty, victim=victim, fault=fault)


def spoilt() -> Recipe:
    return plain(kind=Spoilt)
