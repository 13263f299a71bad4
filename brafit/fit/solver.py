"""What solvers take and give: problem, solver and solution are separate things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.fit.objective import Objective, Pressure
from brafit.fit.result import ResultCode


@dataclass(frozen=True)
class Step:
    """What a solver tells while it runs.

    Attributes:
        stage: name of the stage.
        index, total: steps done and steps at most.
        terms: objective, losses and penalties of the problems still running.
        scans: of each of these problems, its scan's position in the batch.
    """

    stage: str
    index: int
    total: int
    terms: dict[str, Float[Tensor, " active"]]
    scans: Int[Tensor, " active"] = field(default_factory=lambda: torch.zeros(0, dtype=torch.long))


Callback = Callable[[Step], None]


@dataclass(frozen=True)
class Solution:
    """Where B problems ended. `warnings`: what a solver has to say about each, in plain words."""

    flat: Float[Tensor, "batch size"]
    codes: list[ResultCode]
    iterations: Int[Tensor, " batch"]
    pressure: Pressure
    warnings: Sequence[Sequence[str]] = ()


class Solver(Protocol):
    """Anything that can minimise a batch of objectives."""

    def solve(
        self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None
    ) -> Solution: ...
