"""Batched Levenberg-Marquardt: every problem has its own damping, acceptance and end.

Each stage frees more terms of the cup's series. Early stages see a thinned cloud and all starts; after a stage only
the best starts of each scan go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from brafit.fitting.fairness import Shares
from brafit.fitting.missing_hessian import MissingHessian
from brafit.fitting.normal import Normal, normal_equations
from brafit.fitting.objective import APEX, Objective, Pressure
from brafit.fitting.schedule import APART, STILL, Ending, Schedule, Tell
from brafit.fitting.solver import Callback, Solution
from brafit.geometry.products import dots, solved_each

_SHORTEST = 1e-2
"""A step is not shortened further than this."""
_SEARCHING = 4
"""Nearest points are searched anew in the first _SEARCHING steps and then in every _SEARCHING-th one; in between they
are followed."""


@dataclass(frozen=True)
class LMStage:
    """One stage of the schedule.

    Attributes:
        terms: terms of the cup's series that are free; None: all. The upper edge's corner stays where
            `Cup.place_corner` puts it: free, it wanders and makes a kink.
        points: points of each cloud that the stage uses. None: all. 0: none; the edges are fitted to the start's curves
            (`brafit.fitting.start`) instead.
        steps: steps at most.
        keep: starts per scan that go on after the stage.
        penalty: penalty mu of the cup's constraints, where it has any.
        tolerance: relative decrease of the objective, expected and found, at which a problem has converged.
        fairness, plainness: multiply these weights while the stage runs (cups without constraints). There is one
            best among very plain cups, which the next stages follow; fairness alone has many, and comes last.
        waves: share of what small waves count in fairness (`brafit.fitting.fairness.wavy`). In full from the first, it
            leads into one of several optima, by chance.
        margin_width: the least width of the regularity barrier while the stage runs: a soft barrier leads past poor
            optima.
        seam: share of the ridge's pull to the apex (`Conditions.seam`) while the stage runs. At its full weight from
            the first, it leads into one of several optima, by chance.
        leading: the stage runs only where a ridge is to run through the apex, which takes more stages.

    Raises:
        ValueError: no step, or a penalty that is not positive.
    """

    steps: int
    terms: int | None = None
    points: int | None = None
    keep: int | None = None
    penalty: float = 1.0
    tolerance: float = 1e-6
    fairness: float = 1.0
    plainness: float = 1.0
    waves: float = 1.0
    margin_width: float = 0.0
    seam: float = 1.0
    leading: bool = False

    def __post_init__(self) -> None:
        if self.steps < 1 or not self.penalty > 0:
            raise ValueError(f"a stage needs steps >= 1 and penalty > 0, got {self.steps} and {self.penalty}")

    @property
    def name(self) -> str:
        return "lm"

    @property
    def settled(self) -> bool:
        """Whether an upper edge that is off its neckline after the stage would be off at the end, too: all terms are
        free and no other weights hold it back.
        """
        return self.terms is None and self.fairness == self.plainness == 1

    @property
    def relieves(self) -> bool:
        """Whether multipliers take over what the penalty held: always."""
        return True


@dataclass(frozen=True)
class Minimum(Ending):
    """Where B minimisations ended, and how they came there.

    Attributes:
        history: value after every step; the last one repeats once a problem has ended.
    """

    history: Float[Tensor, "steps batch"]

    def still(self) -> list[bool]:
        """Of which it is known that their last STILL steps brought nothing."""
        if len(self.history) <= STILL:
            return super().still()
        return (self.history[-1] >= self.history[-1 - STILL]).tolist()


class LM:
    """Runs its stages in turn (`brafit.fitting.schedule`).

    Args:
        stages: the schedule (`LMStage`s or mappings with their fields).
        margin: how far the regularity margin of a finished cup may lie below `Conditions.margin`.
        apart: by which share of the best start's objective another start must end above it to count as another optimum.

    Raises:
        ValueError: there is no stage that is not `leading`.
    """

    def __init__(self, stages: Sequence[LMStage | dict], margin: float = 0.0, apart: float = APART):
        self.stages = [s if isinstance(s, LMStage) else LMStage(**s) for s in stages]
        self.margin, self.apart = margin, apart
        if all(stage.leading for stage in self.stages):
            raise ValueError("solver.stages needs at least one stage that is not leading")

    def solve(self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None) -> Solution:
        """Minimise every problem of the objective from its start."""
        leading = objective.conditions.seam == APEX
        stages = [stage for stage in self.stages if leading or not stage.leading]
        last = max(k for k, stage in enumerate(self.stages) if leading or not stage.leading)
        return Schedule(stages, _minimised, self.margin, self.apart, last).solve(objective, start, callback)


def _minimised(objective: Objective, place: Tensor, pressure: Pressure, stage: LMStage, tell: Tell) -> Ending:
    """One stage."""
    part, begun = staged(objective, place, stage)
    return minimise(part, begun, pressure, stage, tell)


def staged(
    objective: Objective, place: Float[Tensor, "batch size"], stage: LMStage
) -> tuple[Objective, Float[Tensor, "batch size"]]:
    """The objective as a stage sees it, and the places that the stage begins at."""
    shares = Shares(stage.fairness, stage.plainness, stage.waves, stage.seam)
    shares = Shares(seam=stage.seam) if objective.cup.constrained else shares
    objective = objective.seen(stage.points).eased(shares, stage.margin_width)
    targets = objective.targets
    return objective, objective.cup.place_corner(place, targets.connection, targets.has_connection)


@torch.no_grad()
def minimise(
    objective: Objective, start: Float[Tensor, "batch size"], pressure: Pressure, stage: LMStage, tell: Tell
) -> Minimum:
    """Minimise every problem by the terms that are free in the stage.

    The damping follows Nielsen (1999): it falls smoothly with the ratio of found to expected decrease, and grows ever
    faster while steps are refused. Where it is too small to matter, more of it would bring the same step again: there
    a refused step is shortened instead, to the minimum of the parabola through what was found.
    """
    terms = objective.cup.terms if stage.terms is None else stage.terms
    columns = objective.cup.columns(terms)
    batch = len(start)
    index = torch.arange(batch, device=start.device)
    place, result = start, start.clone()
    here = normal_equations(objective, place, pressure, terms)
    value = here.value.clone()
    converged = torch.zeros(batch, dtype=torch.bool, device=start.device)
    diverged = ~(here.value.isfinite() & here.matrix.isfinite().all(-1).all(-1))
    steps = torch.zeros(batch, dtype=torch.long, device=start.device)
    damping = torch.full_like(here.value, 1e-3)
    growth, reach = torch.full_like(damping, 2.0), torch.ones_like(damping)
    ended = diverged.clone()
    missing = MissingHessian.none(here)
    history = []
    for count in range(stage.steps):
        running = ~ended[index]
        if not running.any():
            break
        if not running.all():
            keep = running.nonzero()[:, 0]
            index, place, here = index[keep], place[keep], here.select(keep)
            damping, growth, reach = damping[keep], growth[keep], reach[keep]
            objective, pressure = objective.select(keep), pressure.select(keep)
            missing = missing.select(keep)
            running = running[keep]
        move, fall, bend = _step(here, damping, missing.to_add)
        expected = fall - 0.5 * bend
        trial = place.clone()
        trial[:, columns] += reach[:, None] * move
        near = here.feet if count >= _SEARCHING and count % _SEARCHING else None
        there = normal_equations(objective, trial, pressure, terms, near)
        gain = here.value - there.value
        finite = there.value.isfinite() & there.matrix.isfinite().all(-1).all(-1)
        accepted = running & finite & (gain > 0)
        small = stage.tolerance * here.value
        finished = running & (expected < small) & (gain.abs() < small) & finite
        finished |= running & (damping > 1e10)
        missing = missing.learnt(here, there, reach[:, None] * move, accepted)
        place = torch.where(accepted[:, None], trial, place)
        here = there.choose(accepted, here)
        damping, growth, reach = _adapted(damping, growth, reach, fall, bend, gain, accepted, finite)
        steps[index] += running
        ended[index] |= finished
        converged[index] |= finished
        value[index], result[index] = here.value, place
        history.append(value.clone())
        tell(count, here.terms, objective.groups)
    return Minimum(result, value, converged, diverged, steps, torch.stack(history) if history else value[None])


def _step(
    here: Normal, damping: Tensor, missing: Tensor
) -> tuple[Float[Tensor, "batch columns"], Float[Tensor, " batch"], Float[Tensor, " batch"]]:
    """The damped step m, the value's fall -g.m along it and its bend m.H.m: the quadratic model decreases by
    fall - bend / 2. H is the Gauss-Newton matrix and what it lacks of the Hessian; without the latter where their sum
    is not positive.
    """
    diagonal = here.matrix.diagonal(dim1=-2, dim2=-1)
    scale = torch.maximum(diagonal, 1e-6 * diagonal.amax(-1, keepdim=True)).clamp_min(1e-30)
    extra = damping[:, None] * scale
    damped = here.matrix + torch.diag_embed(extra)
    solved, usable = solved_each(damped + missing, here.gradient)
    if not usable.all():
        left = (~usable).nonzero()[:, 0]
        solved[left], usable[left] = solved_each(damped[left], here.gradient[left])
    move = torch.where(usable[:, None], -solved, torch.zeros_like(solved))
    fall = torch.where(usable, -dots(here.gradient, move), torch.inf)
    return move, fall, fall - dots(extra * move, move)  # since H m = -g - extra m


def _adapted(
    damping: Tensor,
    growth: Tensor,
    reach: Tensor,
    fall: Tensor,
    bend: Tensor,
    gain: Tensor,
    accepted: Bool[Tensor, " batch"],
    finite: Bool[Tensor, " batch"],
) -> tuple[Tensor, Tensor, Tensor]:
    """Damping, its next growth and the share of the step that is tried, after a step that gained so much."""
    ratio = gain / (reach * fall - 0.5 * reach**2 * bend)
    eased = damping * (1 - (2 * ratio - 1) ** 3).clamp(1 / 5, 2)
    shortened = ~accepted & finite & (bend > 0.5 * fall) & (reach > _SHORTEST)
    lowest = 0.5 * reach**2 * fall / (reach * fall - gain)
    damping = torch.where(accepted, eased, torch.where(shortened, damping, damping * growth)).clamp_min(1e-12)
    growth = torch.where(accepted, 2.0, torch.where(shortened, growth, growth * 2))
    reach = torch.where(shortened, torch.minimum(lowest, 0.5 * reach).maximum(0.1 * reach), 1.0)
    return damping, growth, reach
