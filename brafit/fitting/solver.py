"""What solvers take and give: problem, solver and solution are separate things."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.result import ResultCode
from brafit.remarks import Remark


@dataclass(frozen=True)
class Step:
    """What a solver tells while it runs.

    Attributes:
        stage: name of the stage.
        index, total: steps done and steps at most.
        terms: of the problems still running, see below.
        scans: to which target of the batch each of these problems belongs, int64, on the terms' device. Empty in
            steps that no solver tells of.

    Terms are named after losses and penalties, as they count in the end: what a stage makes weigh more or less, or
    bounds more softly, is told with the final weight, and penalties of constraints without multipliers and with the
    last stage's factor. `objective` is their sum, so that it can be followed across stages; nan in stages that look at
    no points. `rms_mm` is the root mean square distance (mm) of the points that the step looked at; missing where
    there are none. Early stages look at means of small patches, whose distances are less by what points of a patch
    differ.
    """

    stage: str
    index: int
    total: int
    terms: dict[str, Float[Tensor, " active"]]
    scans: Int[Tensor, " active"] = field(default_factory=lambda: torch.zeros(0, dtype=torch.long))


Callback = Callable[[Step], None]


@dataclass(frozen=True)
class Solution:
    """Where B problems ended. `warnings`: what a solver has to say about each."""

    flat: Float[Tensor, "batch size"]
    codes: list[ResultCode]
    iterations: Int[Tensor, " batch"]
    pressure: Pressure
    warnings: Sequence[Sequence[Remark]] = ()


@runtime_checkable
class Solver(Protocol):
    """Anything that can minimise a batch of objectives."""

    def solve(
        self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None
    ) -> Solution: ...
