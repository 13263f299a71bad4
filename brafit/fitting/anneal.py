"""The annealing solver: Adam, then L-BFGS, while the penalties of the constraints rise and their multipliers settle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import derivatives
from brafit.fitting import adam, lbfgs
from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import Evaluation, Objective, Pressure
from brafit.fitting.result import ResultCode
from brafit.fitting.solver import Callback, Solution, Step

OPTIMISERS = ("adam", "lbfgs")
LOOKS = 3
"""How often the weights of barrier and neckline may be raised."""


@dataclass(frozen=True)
class Stage:
    """One stage of the schedule.

    Attributes:
        optimiser: `adam` or `lbfgs`.
        steps: evaluations per problem at most.
        penalty: penalty mu of the constraints in this stage.
        rate: rate of Adam, in solver units.
        damping: L-BFGS works in the variables in which the Gauss-Newton matrix at the stage's start, plus `damping`
            times its largest diagonal element, is the identity. Small values reach weakly determined directions, but
            only near a minimum.
        points: points of each cloud that the stage uses. None: all. 0: none; the edges are fitted to the start's curves
            (`brafit.fitting.start`) instead.

    Raises:
        ValueError: another optimiser, fewer than 0 steps, or a penalty or damping that is not positive.
    """

    optimiser: str
    steps: int
    penalty: float
    rate: float = 0.03
    damping: float = 1e-7
    points: int | None = None

    def __post_init__(self) -> None:
        if self.optimiser not in OPTIMISERS:
            raise ValueError(f"unknown optimiser {self.optimiser!r}: allowed are {', '.join(OPTIMISERS)}")
        if self.steps < 0 or not self.penalty > 0 or not self.damping > 0:
            got = f"{self.steps}, {self.penalty}, {self.damping}"
            raise ValueError(f"a stage needs steps >= 0, penalty > 0 and damping > 0, got {got}")


class Anneal:
    """Runs its stages in turn; after each L-BFGS stage the multipliers take over what the penalty held.

    Args:
        stages: the schedule (`Stage`s or mappings with their fields).
        tolerance: relative change of the value at which a stage of L-BFGS has converged.
    """

    def __init__(self, stages: Sequence[Stage | dict], tolerance: float = 1e-6):
        self.stages = [s if isinstance(s, Stage) else Stage(**s) for s in stages]
        self.tolerance = tolerance

    def solve(self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None) -> Solution:
        """Minimise every problem of the objective from its start. Problems that diverge are frozen where they were
        last finite.
        """
        run = _Run.of(start, sum(s.steps for s in self.stages), self.stages[-1].penalty)
        for number, stage in enumerate(self.stages):
            self._stage(
                run, objective, f"{number + 1} {stage.optimiser}", stage, (~run.diverged).nonzero()[:, 0], callback
            )
            run.done += stage.steps
        grid = objective
        for _ in range(0 if objective.cup.constrained else LOOKS):
            left = (~run.diverged).nonzero()[:, 0]
            part, place = objective.select(left), run.place[left]
            shape = part.cup.shape_of(place)
            low, factor = shape.margin.amin((-2, -1)) < objective.conditions.margin, part.neckline_factor(shape)
            pull = part.seam_factor(shape)
            wanting = low | (factor > 1) | (pull > 1)
            if not wanting.any():
                break
            run.barrier[left[low]] *= 10
            run.neckline[left] *= factor[:, None]
            run.seam[left] *= pull[:, None]
            grid = grid.finer()
            self._stage(run, grid, "raised", self.stages[-1], left[wanting], callback)
        live = (~run.diverged).nonzero()[:, 0]
        penalty = self.stages[-1].penalty
        if len(live):
            run.place[live] = close(objective.select(live), run.place[live], run.pressure(penalty, live))
        codes = [
            ResultCode.DIVERGED if d else ResultCode.CONVERGED if c else ResultCode.STEP_LIMIT
            for d, c in zip(run.diverged.tolist(), run.converged.tolist(), strict=True)
        ]
        return Solution(run.place, codes, run.evaluations, run.pressure(penalty))

    def _stage(
        self, run: "_Run", objective: Objective, name: str, stage: Stage, live: Tensor, callback: Callback | None
    ) -> None:
        """One stage of the live problems."""
        if len(live) == 0:
            return
        part, pressure = objective.select(live).seen(stage.points), run.pressure(stage.penalty, live)
        watch = _Watch(part, pressure, callback, name, run.done, run.total)
        if stage.optimiser == "adam":
            run.place[live], bad = adam.descend(
                watch.evaluate, run.place[live], stage.steps, stage.rate, callback=watch.report
            )
            run.evaluations[live] += stage.steps
        else:
            ending = self._lbfgs(watch, run.place[live], stage)
            run.place[live], bad = ending.place, ending.diverged
            run.converged[live] = ending.converged
            run.evaluations[live] += ending.evaluations
            shape = part.cup.shape_of(run.place[live])
            for constraint, value in part.constraints(shape).items():
                kept = run.multipliers.setdefault(constraint, value.new_zeros(len(run.place), value.shape[1]))
                kept[live] += stage.penalty * value.detach()
        run.diverged[live] |= bad

    def _lbfgs(self, watch: "_Watch", place: Tensor, stage: Stage) -> lbfgs.Minimum:
        transform = whitening(normal_equations(watch.objective, place, watch.pressure).matrix, stage.damping)

        def scaled(z: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
            own = transform[index]
            value, gradient = watch.evaluate(place[index] + (own * z[:, None, :]).sum(-1), index)
            return value, (own * gradient[:, :, None]).sum(-2)

        ending = lbfgs.minimise(
            scaled, torch.zeros_like(place), stage.steps, tolerance=self.tolerance, reach=1.0, callback=watch.report
        )
        moved = place + (transform * ending.place[:, None, :]).sum(-1)
        return lbfgs.Minimum(moved, ending.value, ending.converged, ending.diverged, ending.evaluations)


@dataclass
class _Run:
    """Where all problems of a run stand."""

    place: Tensor
    diverged: Tensor
    converged: Tensor
    evaluations: Tensor
    barrier: Tensor
    neckline: Tensor
    seam: Tensor
    multipliers: dict[str, Tensor]
    total: int
    final: float
    done: int = 0

    @staticmethod
    def of(start: Tensor, total: int, final: float) -> "_Run":
        no = torch.zeros(len(start), dtype=torch.bool, device=start.device)
        barrier, neckline, seam = (torch.ones_like(start[:, :1]) for _ in range(3))
        return _Run(start.clone(), no, no.clone(), no.long(), barrier, neckline, seam, {}, total, final)

    def pressure(self, penalty: float, live: Tensor | None = None) -> Pressure:
        whole = Pressure(penalty, self.multipliers, self.barrier, self.neckline, self.seam, self.final)
        return whole if live is None else whole.select(live)


def close(objective: Objective, place: Float[Tensor, "batch size"], pressure: Pressure) -> Float[Tensor, "batch size"]:
    """Fulfil the cup's closure equations to round-off by the least change, measured by the objective's Gauss-Newton
    matrix.

    Args:
        objective: the problems.
        place: their parameters.
        pressure: weights of constraints, barrier and neckline.
    """
    cup = objective.cup
    if not cup.constrained:  # closed by construction
        return place

    def closure(flat: Tensor) -> Tensor:
        value = cup.closure(cup.shape_of(flat))
        return flat.new_zeros(len(flat), 0) if value is None else value

    if closure(place).shape[1] == 0:
        return place
    # damped, so that the least change is no long step in a direction that the objective hardly sees
    transform = whitening(normal_equations(objective, place, pressure).matrix, damping=1e-4)
    for _ in range(8):
        gap = closure(place)
        jacobian = derivatives(lambda flat: (closure(flat),), place)[0].movedim(0, -1)
        change = []
        for j, w, g in zip(jacobian, transform, gap, strict=True):
            change.append(-w @ torch.linalg.lstsq(j @ w, g[:, None], driver="gelsd").solution[:, 0])
        place = place + torch.stack(change)
    return place


def whitening(matrix: Float[Tensor, "batch size size"], damping: float = 1e-7) -> Float[Tensor, "batch size size"]:
    """W with W^T A W = 1 for A = matrix + damping max(diag) 1; the identity where A is not positive definite or not
    finite.
    """
    size = matrix.shape[-1]
    identity = torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    result = []
    for a in matrix:  # one at a time, so that rounding does not depend on the batch
        factor, failed = torch.linalg.cholesky_ex(a + damping * a.diagonal().max() * identity)
        usable = failed == 0 and bool(factor.isfinite().all())
        result.append(torch.linalg.solve_triangular(factor, identity, upper=False).mT if usable else identity)
    return torch.stack(result)


class _Watch:
    """Evaluates the live problems of a stage and tells the callback what it saw."""

    def __init__(
        self, objective: Objective, pressure: Pressure, callback: Callback | None, stage: str, done: int, total: int
    ):
        self.objective, self.pressure = objective, pressure
        self._callback, self._stage, self._done, self._total = callback, stage, done, total
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
        if self._callback is not None and self._seen is not None:
            self._callback(Step(self._stage, self._done + count, self._total, self._seen.terms, self._scans))
