"""The schedule of the solvers that work in stages: one after another, the last one again on a finer grid with what
weighs too little raised; after a stage only the best starts of each scan go on.

A solver brings its stages and how a stage is minimised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from brafit.fitting.closure import close
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.raising import RaisedWeights
from brafit.fitting.result import ResultCode
from brafit.fitting.solver import Callback, Solution, Step
from brafit.remarks import Remark

LOOKS = 3
"""How often the last stage is repeated at most."""
APART = 0.05
"""By which share of the best start's objective another one ends above it that is another optimum."""
STILL = 20
"""Steps without any change after which more of them bring nothing."""
MORE = 4
"""How many times as many steps are advised where a fit had too few."""

Tell = Callable[[int, dict[str, Tensor], Tensor], None]
"""Takes the steps done in a stage, the terms of `Step`, and to which scans they belong."""


class Stage(Protocol):
    """What the schedule asks of a stage.

    Attributes:
        name: what it is called in `Step.stage`, behind its number.
        steps: at most.
        penalty: penalty mu of the cup's constraints, where it has any.
        keep: starts per scan that go on after it; None: all.
        settled: whether an upper edge that is off its neckline after it would be off at the end, too.
        relieves: whether the multipliers of constraints take over what the penalty held in it.
    """

    @property
    def name(self) -> str: ...
    @property
    def steps(self) -> int: ...
    @property
    def penalty(self) -> float: ...
    @property
    def keep(self) -> int | None: ...
    @property
    def settled(self) -> bool: ...
    @property
    def relieves(self) -> bool: ...


S = TypeVar("S", bound=Stage)


@dataclass(frozen=True)
class Ending:
    """Where a stage's B minimisations ended.

    Attributes:
        place, value: the best places and the objective there.
        converged, diverged: neither: the steps were up.
        steps: done.
    """

    place: Float[Tensor, "batch size"]
    value: Float[Tensor, " batch"]
    converged: Bool[Tensor, " batch"]
    diverged: Bool[Tensor, " batch"]
    steps: Int[Tensor, " batch"]

    def codes(self) -> list[ResultCode]:
        """How each of them ended."""
        ends = zip(self.diverged.tolist(), self.converged.tolist(), strict=True)
        left = {True: ResultCode.CONVERGED, False: ResultCode.STEP_LIMIT}
        return [ResultCode.DIVERGED if diverged else left[converged] for diverged, converged in ends]

    def still(self) -> list[bool]:
        """Of which it is known that their last STILL steps brought nothing."""
        return [False] * len(self.value)


Minimise = Callable[[Objective, Tensor, Pressure, S, Tell], Ending]
"""Takes some problems, their places, how hard conditions press, the stage, and what hears of every step."""


@dataclass
class _Run:
    """Where all problems stand. `still`: whose last steps brought nothing; `warnings`: what is to be said of each."""

    place: Float[Tensor, "batch size"]
    value: Float[Tensor, " batch"]
    steps: Int[Tensor, " batch"]
    codes: list[ResultCode]
    still: list[bool]
    warnings: list[list[Remark]]
    raised: RaisedWeights

    @staticmethod
    def of(start: Float[Tensor, "batch size"]) -> _Run:
        value = torch.full_like(start[:, 0], torch.inf)
        codes = [ResultCode.DIVERGED] * len(start)
        steps = torch.zeros_like(value, dtype=torch.long)
        still = [False for _ in codes]
        return _Run(start.clone(), value, steps, codes, still, [[] for _ in codes], RaisedWeights.none(start))

    def take(self, rows: Int[Tensor, " some"], ending: Ending) -> None:
        """What became of some problems."""
        self.place[rows], self.value[rows] = ending.place, ending.value
        self.steps[rows] += ending.steps
        for row, code, still in zip(rows.tolist(), ending.codes(), ending.still(), strict=True):
            self.codes[row], self.still[row] = code, still


@dataclass(frozen=True)
class Schedule(Generic[S]):
    """Stages, and how they are minimised.

    Attributes:
        stages: one after another.
        minimise: minimises a stage.
        slack: how far the regularity margin of a finished cup may lie below `Conditions.margin`. A cup below that gets
            a stronger barrier, one whose upper edge ends farther from the neckline than `Conditions.neckline_limit` a
            stronger pull to it, one whose ridge misses the apex where it is to run through it likewise; and the last
            stage is repeated on a finer grid. The neckline is looked at after earlier stages that are `settled`, too.
        apart: by which share of the best start's objective another start must end above it to count as another optimum.
        last: number of the last stage among the solver's, of which some may be left out; None: all are here.

    Raises:
        ValueError: there is no stage.
    """

    stages: Sequence[S]
    minimise: Minimise[S]
    slack: float = 0.0
    apart: float = APART
    last: int | None = None

    def __post_init__(self) -> None:
        if not self.stages:
            raise ValueError("solver.stages needs at least one stage")

    def solve(self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None) -> Solution:
        """Minimise every problem of the objective from its start."""
        run, live = _Run.of(start), torch.arange(len(start), device=start.device)
        done, total, penalty = 0, sum(stage.steps for stage in self.stages), self.stages[-1].penalty
        last_drop = min((stage.keep for stage in self.stages if stage.keep is not None), default=None)
        for number, stage in enumerate(self.stages):
            tell = partial(_tell, callback, f"{number + 1} {stage.name}", done, total)
            if number == len(self.stages) - 1:
                self._finish(run, objective, stage, live, tell)
            else:
                self._run(run, objective, stage, live, tell)
                if stage.settled:
                    part = objective.select(live)
                    run.raised.raise_neckline(part, part.cup.sketch(run.place[live]), live)
            if stage.relieves:
                run.raised.take_over(objective, run.place, stage.penalty, live)
            done += stage.steps
            run.value[run.value.isnan()] = torch.inf
            if stage.keep is not None:
                live = self._drop(run, objective.rivals, live, stage.keep, noted=stage.keep == last_drop)
        self._note_limits(run)
        pressure = run.raised.pressure(penalty)
        return Solution(_closed(run, objective, pressure), run.codes, run.steps, pressure, run.warnings)

    def _run(self, run: _Run, objective: Objective, stage: S, rows: Int[Tensor, " some"], tell: Tell) -> None:
        """One stage of some problems."""
        pressure = run.raised.pressure(stage.penalty, self.stages[-1].penalty).select(rows)
        run.take(rows, self.minimise(objective.select(rows), run.place[rows], pressure, stage, tell))

    def _finish(self, run: _Run, objective: Objective, stage: S, rows: Int[Tensor, " some"], tell: Tell) -> None:
        """The last stage, again where something weighs too little."""
        for _ in range(LOOKS + 1):
            self._run(run, objective, stage, rows, tell)
            part = objective.select(rows)
            rows = rows[run.raised.raise_all(part, part.cup.shape_of(run.place[rows]), rows, self.slack)]
            if len(rows) == 0:
                break
            objective = objective.finer()

    def _note_limits(self, run: _Run) -> None:
        """Say of what ended at its step limit whether more steps would help."""
        last = len(self.stages) - 1 if self.last is None else self.last
        remedy = f"allow its last stage more steps: solver.stages.{last}.steps={MORE * self.stages[-1].steps}"
        short = Remark("step_limit", "the fit stopped at its step limit, perhaps short of the best cup", remedy=remedy)
        words = f"the fit stopped at its step limit, but its last {STILL} steps brought nothing: more would not help"
        for row, code in enumerate(run.codes):
            if code is ResultCode.STEP_LIMIT:
                run.warnings[row].append(Remark("step_limit", words) if run.still[row] else short)

    def _drop(
        self, run: _Run, rivals: Int[Tensor, " batch"], live: Int[Tensor, " some"], keep: int, noted: bool
    ) -> Int[Tensor, " left"]:
        """The best `keep` of the live problems among rivals; the others are marked, and noted where they had converged
        elsewhere.
        """
        ends, owners = run.value.tolist(), rivals.tolist()  # once: there may be thousands, and the values on a device
        rows: dict[int, list[int]] = {}
        for row in live.tolist():
            rows.setdefault(owners[row], []).append(row)
        chosen = []
        for own in rows.values():
            order = sorted(own, key=lambda row: ends[row])
            best, dropped = ends[order[0]], order[keep:]
            chosen += order[:keep]
            converged = [row for row in dropped if run.codes[row] is ResultCode.CONVERGED]
            apart = [row for row in converged if ends[row] > (1 + self.apart) * best]
            for row in dropped:
                run.codes[row] = ResultCode.DROPPED
            if apart and noted:
                worst = max(ends[row] for row in apart) / best - 1
                words = f"{len(apart)} of the last {len(own)} starts ended in another optimum, up to {worst:.0%} worse"
                for row in order[:keep]:
                    run.warnings[row].append(Remark("starts_apart", words))
        return torch.tensor(sorted(chosen), device=live.device)


def _closed(run: _Run, objective: Objective, pressure: Pressure) -> Float[Tensor, "batch size"]:
    """The places, closed; those that diverged as they were."""
    rows = torch.tensor([row for row, code in enumerate(run.codes) if code is not ResultCode.DIVERGED])
    rows = rows.to(run.place.device, torch.long)
    if len(rows):
        run.place[rows] = close(objective.select(rows), run.place[rows], pressure.select(rows))
    return run.place


def _tell(
    callback: Callback | None,
    stage: str,
    done: int,
    total: int,
    index: int,
    terms: dict[str, Tensor],
    scans: Tensor,
) -> None:
    if callback is not None:
        callback(Step(stage, done + index, total, terms, scans))
