"""The annealing solver: Adam, then L-BFGS, while the penalties of the constraints rise and their multipliers settle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.fitting import adam, lbfgs
from brafit.fitting.closure import whitening
from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import Evaluation, Objective, Pressure
from brafit.fitting.schedule import Ending, Schedule, Tell
from brafit.fitting.solver import Callback, Solution

OPTIMISERS = ("adam", "lbfgs")


@dataclass(frozen=True)
class AnnealStage:
    """One stage of the schedule.

    Attributes:
        optimiser: `adam` or `lbfgs`.
        steps: evaluations per problem at most.
        penalty: penalty mu of the constraints in this stage.
        rate: rate of Adam, in solver units.
        damping: L-BFGS works in the variables in which the Gauss-Newton matrix at the stage's start, plus `damping`
            times its largest diagonal element, is the identity. Small values reach weakly determined directions, but
            only near a minimum; below 1e-8 they are lost in the rounding of that matrix.
        points: points of each cloud that the stage uses. None: all. 0: none; the edges are fitted to the start's curves
            (`brafit.fitting.start`) instead.
        keep: starts per scan that go on after the stage; None: all.

    Raises:
        ValueError: another optimiser, fewer than 0 steps, or a penalty or damping that is not positive.
    """

    optimiser: str
    steps: int
    penalty: float
    rate: float = 0.03
    damping: float = 1e-7
    points: int | None = None
    keep: int | None = None

    def __post_init__(self) -> None:
        if self.optimiser not in OPTIMISERS:
            raise ValueError(f"unknown optimiser {self.optimiser!r}: allowed are {', '.join(OPTIMISERS)}")
        if self.steps < 0 or not self.penalty > 0 or not self.damping > 0:
            got = f"{self.steps}, {self.penalty}, {self.damping}"
            raise ValueError(f"a stage needs steps >= 0, penalty > 0 and damping > 0, got {got}")

    @property
    def name(self) -> str:
        return self.optimiser

    @property
    def settled(self) -> bool:
        """Never: later stages may still bring an upper edge to its neckline."""
        return False

    @property
    def relieves(self) -> bool:
        """Whether multipliers take over what the penalty held: Adam ends too far from a minimum."""
        return self.optimiser == "lbfgs"


class Anneal:
    """Runs its stages in turn (`brafit.fitting.schedule`); after each L-BFGS stage the multipliers take over what the
    penalty held.

    Args:
        stages: the schedule (`AnnealStage`s or mappings with their fields).
        tolerance: relative change of the value at which a stage of L-BFGS has converged.

    Raises:
        ValueError: there is no stage.
    """

    def __init__(self, stages: Sequence[AnnealStage | dict], tolerance: float = 1e-6):
        self.stages = [s if isinstance(s, AnnealStage) else AnnealStage(**s) for s in stages]
        self.tolerance = tolerance
        self._schedule = Schedule(self.stages, self._minimise)

    def solve(self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None) -> Solution:
        """Minimise every problem of the objective from its start. A problem that diverges stays where it was last
        finite.
        """
        return self._schedule.solve(objective, start, callback)

    def _minimise(
        self, objective: Objective, place: Tensor, pressure: Pressure, stage: AnnealStage, tell: Tell
    ) -> Ending:
        """One stage."""
        watch = _Watch(objective.seen(stage.points), pressure, tell)
        if stage.optimiser == "lbfgs":
            return self._lbfgs(watch, place, stage)
        best, diverged = adam.descend(watch.evaluate, place, stage.steps, stage.rate, callback=watch.report)
        steps = torch.full_like(diverged, stage.steps, dtype=torch.long)
        value = watch.objective.value(best, pressure)
        return Ending(best, value, torch.zeros_like(diverged), diverged, steps)

    def _lbfgs(self, watch: _Watch, place: Tensor, stage: AnnealStage) -> Ending:
        transform = whitening(normal_equations(watch.objective, place, watch.pressure).matrix, stage.damping)

        def scaled(z: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
            own = transform[index]
            value, gradient = watch.evaluate(place[index] + (own * z[:, None, :]).sum(-1), index)
            return value, (own * gradient[:, :, None]).sum(-2)

        found = lbfgs.minimise(
            scaled, torch.zeros_like(place), stage.steps, tolerance=self.tolerance, reach=1.0, callback=watch.report
        )
        moved = place + (transform * found.place[:, None, :]).sum(-1)
        return Ending(moved, found.value, found.converged, found.diverged, found.evaluations)


class _Watch:
    """Evaluates the problems of a stage and tells what it saw."""

    def __init__(self, objective: Objective, pressure: Pressure, tell: Tell):
        self.objective, self.pressure, self._tell = objective, pressure, tell
        self._subset: tuple[Tensor, Objective, Pressure] | None = None
        self._seen: Evaluation | None = None
        self._scans = objective.groups

    def evaluate(self, place: Tensor, index: Tensor | None = None) -> tuple[Tensor, Tensor]:
        objective, pressure = self.objective, self.pressure
        if index is not None and len(index) < objective.cup.batch:
            if self._subset is None or not torch.equal(self._subset[0], index):
                self._subset = index, objective.select(index), pressure.select(index)
            _, objective, pressure = self._subset
        self._seen, self._scans = objective.evaluate(place, pressure), objective.groups
        return self._seen.value, self._seen.gradient

    def report(self, count: int) -> None:
        if self._seen is not None:
            self._tell(count, self._seen.terms, self._scans)
