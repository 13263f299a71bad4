"""Batched L-BFGS: every problem has its own step, line search, history and end.

The problems run asynchronously: with each evaluation every problem either takes its own next step or tries another
length of the present one (bracketing for the weak Wolfe conditions, Lewis and Overton 2013), so none waits for
another, and none can touch another: all arithmetic is elementwise in the batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Flat = Float[Tensor, "batch size"]
Function = Callable[[Flat, Int[Tensor, " active"]], tuple[Float[Tensor, " batch"], Flat]]
"""(places, which problems they belong to) -> (values, gradients)"""


@dataclass(frozen=True)
class Minimum:
    """Where B minimisations ended."""

    place: Flat
    value: Float[Tensor, " batch"]
    converged: Bool[Tensor, " batch"]
    diverged: Bool[Tensor, " batch"]
    evaluations: Int[Tensor, " batch"]


@dataclass
class _State:
    """Per problem: the accepted place, the trial, the bracket of the line search, the curvature pairs (newest last)."""

    index: Tensor
    place: Tensor
    value: Tensor
    gradient: Tensor
    direction: Tensor
    slope: Tensor
    step: Tensor
    low: Tensor
    high: Tensor
    moves: Tensor
    changes: Tensor
    curvature: Tensor
    quiet: Tensor

    @staticmethod
    def at(start: Tensor, value: Tensor, gradient: Tensor, history: int, reach: float) -> "_State":
        """All problems at their starts, about to go downhill."""
        index = torch.arange(len(start), device=start.device)
        pairs = start.new_zeros(len(start), history, start.shape[1])
        return _State(
            index=index,
            place=start,
            value=value,
            gradient=gradient,
            direction=-gradient,
            slope=-_inner(gradient, gradient),
            step=_first_step(gradient, reach),
            low=torch.zeros_like(value),
            high=torch.full_like(value, torch.inf),
            moves=pairs,
            changes=pairs.clone(),
            curvature=start.new_zeros(len(start), history),
            quiet=torch.zeros_like(index),
        )

    def select(self, keep: Tensor) -> "_State":
        return _State(*(v[keep] for v in vars(self).values()))

    def searched(self, value: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Narrow the brackets by what was found at the trials: which are accepted, the next steps of the others, and
        which of these can go no further.
        """
        slope = _inner(gradient, self.direction)
        too_high = ~(value <= self.value + 1e-4 * self.step * self.slope)
        too_steep = ~too_high & (slope < 0.9 * self.slope)
        accepted = ~too_high & ~too_steep
        # shrink between the bracket's ends, or double where there is no upper end
        self.high = torch.where(too_high, self.step, self.high)
        self.low = torch.where(too_steep, self.step, self.low)
        bracketed = self.high.isfinite()
        middle = 0.5 * (self.low + torch.where(bracketed, self.high, 0.0))
        next_step = torch.where(bracketed, middle, 2 * self.step)
        size = self.place.abs().amax(-1) + 1
        tiny = (self.step * self.direction.abs().amax(-1)) < torch.finfo(value.dtype).eps * size
        return accepted, next_step, ~accepted & (tiny | (next_step == self.step))

    def remember(self, trial: Tensor, gradient: Tensor, accepted: Tensor) -> None:
        """Add the accepted moves to the history, where their curvature is positive."""
        move, change = trial - self.place, gradient - self.gradient
        bend = _inner(move, change)
        useful = accepted & (bend > 1e-12 * move.norm(dim=-1) * change.norm(dim=-1))
        self.moves = _push(self.moves, move, useful)
        self.changes = _push(self.changes, change, useful)
        self.curvature = _push(self.curvature, 1 / torch.where(useful, bend, 1.0), useful)

    def take(self, trial: Tensor, value: Tensor, gradient: Tensor, accepted: Tensor, tolerance: float) -> None:
        """Go on from the accepted trials."""
        small = (self.value - value) <= tolerance * value.abs()
        self.quiet = torch.where(accepted, torch.where(small, self.quiet + 1, 0), self.quiet)
        self.place = torch.where(accepted[:, None], trial, self.place)
        self.gradient = torch.where(accepted[:, None], gradient, self.gradient)
        self.value = torch.where(accepted, value, self.value)

    def turn(self, accepted: Tensor, next_step: Tensor, reach: float) -> None:
        """A new direction where a trial was accepted, downhill in any case; else the next step along the old one."""
        direction = _direction(self)
        descent = _inner(direction, self.gradient)
        uphill = ~(descent < 0)
        direction = torch.where(uphill[:, None], -self.gradient, direction)
        descent = torch.where(uphill, -_inner(self.gradient, self.gradient), descent)
        self.direction = torch.where(accepted[:, None], direction, self.direction)
        self.slope = torch.where(accepted, descent, self.slope)
        fresh = torch.where(uphill, _first_step(self.gradient, reach), 1.0)
        self.step = torch.where(accepted, fresh, next_step)
        self.low = torch.where(accepted, 0.0, self.low)
        self.high = torch.where(accepted, torch.inf, self.high)


def _first_step(gradient: Tensor, reach: float) -> Tensor:
    """Along a gradient, no longer than `reach` and no more than the gradient itself."""
    return (reach / gradient.norm(dim=-1).clamp_min(1e-300)).clamp_max(1.0)


def _inner(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _push(stack: Tensor, new: Tensor, where: Tensor) -> Tensor:
    """A history with `new` as its last entry and the first one dropped, for the problems in `where`."""
    shifted = torch.cat((stack[:, 1:], new[:, None]), dim=1)
    return torch.where(where.view(-1, *[1] * (stack.dim() - 1)), shifted, stack)


def _direction(state: _State) -> Tensor:
    """-H g by the two-loop recursion over the pairs whose curvature is positive (others are skipped)."""
    q = state.gradient
    history = state.moves.shape[1]
    factors = []
    for k in reversed(range(history)):
        s, y, rho = state.moves[:, k], state.changes[:, k], state.curvature[:, k]
        a = rho * _inner(s, q)
        factors.append(a)
        q = q - a[:, None] * y
    newest_s, newest_y = state.moves[:, -1], state.changes[:, -1]
    yy = _inner(newest_y, newest_y)
    known = state.curvature[:, -1] > 0
    gamma = torch.where(known, _inner(newest_s, newest_y) / torch.where(known, yy, 1.0), 1.0)
    q = q * gamma[:, None]
    for k in range(history):
        s, y, rho = state.moves[:, k], state.changes[:, k], state.curvature[:, k]
        b = rho * _inner(y, q)
        q = q + (factors[history - 1 - k] - b)[:, None] * s
    return -q


def minimise(
    function: Function,
    start: Flat,
    steps: int,
    *,
    tolerance: float = 1e-9,
    history: int = 12,
    reach: float = 1.0,
    callback: Callable[[int], None] | None = None,
) -> Minimum:
    """Minimise B functions from B starts.

    A problem has converged when two steps running lower its value by less than `tolerance` of it, or when its line
    search can find no lower value at the precision of its arithmetic. Converged and diverged problems are no longer
    evaluated.

    Args:
        function: values and gradients for a subset of the problems.
        start: starting places.
        steps: evaluations per problem at most.
        tolerance: relative decrease of the value that counts as none.
        history: pairs of moves and changes of the gradient that are kept.
        reach: longest first step, in units of the variables.
        callback: called with the number of steps done so far, before each.
    """
    everything = torch.arange(len(start), device=start.device)
    value, gradient = function(start, everything)
    place_out, value_out = start.clone(), value.clone()
    converged = torch.zeros(len(start), dtype=torch.bool, device=start.device)
    diverged = ~(value.isfinite() & gradient.isfinite().all(-1))
    evaluations = torch.ones(len(start), dtype=torch.long, device=start.device)
    state = _State.at(start, value, gradient, history, reach).select(~diverged)
    for count in range(steps):
        if len(state.index) == 0:
            break
        if callback is not None:
            callback(count)
        trial = state.place + state.step[:, None] * state.direction
        value, gradient = function(trial, state.index)
        evaluations[state.index] += 1
        finite = value.isfinite() & gradient.isfinite().all(-1)
        value = torch.where(finite, value, torch.inf)
        gradient = torch.where(finite[:, None], gradient, 0.0)
        accepted, next_step, stuck = state.searched(value, gradient)
        state.remember(trial, gradient, accepted)
        state.take(trial, value, gradient, accepted, tolerance)
        state.turn(accepted, next_step, reach)
        place_out[state.index], value_out[state.index] = state.place, state.value
        done = stuck | (state.quiet >= 2) | (state.slope == 0)
        converged[state.index] = done & ~(stuck & ~finite)
        if done.any():
            state = state.select(~done)
    return Minimum(place_out, value_out, converged, diverged, evaluations)
