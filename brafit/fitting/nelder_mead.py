"""The paper's own solver: Nelder-Mead inside a multiplier method, one problem after another, by SciPy.

Kept to compare with; the other solvers are hundreds of times faster.
"""

from __future__ import annotations

import time

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.result import ResultCode
from brafit.fitting.solver import Callback, Solution, Step


class NelderMead:
    """Multiplier method whose inner minimisations are simplex searches.

    Args:
        rounds: inner minimisations at most, with an update of the multipliers after each.
        evaluations: evaluations of the objective per round at most.
        penalty: first penalty mu.
        growth: factor of the penalty from round to round, up to `largest`.
        largest: largest penalty.
        tolerance: relative change of the objective between rounds, at one penalty, at which it stops.
        seconds: CPU time per problem after which it stops wherever it is; None: no limit.
    """

    def __init__(
        self,
        rounds: int = 20,
        evaluations: int = 3000,
        penalty: float = 1.0,
        growth: float = 4.0,
        largest: float = 1000.0,
        tolerance: float = 1e-3,
        seconds: float | None = None,
    ):
        self.rounds, self.evaluations = rounds, evaluations
        self.penalty, self.growth, self.largest = penalty, growth, largest
        self.tolerance, self.seconds = tolerance, seconds

    def solve(self, objective: Objective, start: Float[Tensor, "batch size"], callback: Callback | None) -> Solution:
        """Minimise every problem of the objective from its start."""
        batch = len(start)
        place, codes = start.clone(), []
        counts = torch.zeros(batch, dtype=torch.long, device=start.device)
        multipliers: dict[str, Tensor] = {}
        for row in range(batch):
            one = torch.tensor([row], device=start.device)
            ending = self._solve_one(objective.select(one), place[row], (row, batch), callback)
            place[row], counts[row] = ending[0], ending[2]
            codes.append(ending[3])
            for name, value in ending[1].items():
                multipliers.setdefault(name, value.new_zeros(batch, value.shape[1]))[row] = value[0]
        return Solution(place, codes, counts, Pressure(self.largest, multipliers))

    def _solve_one(
        self, objective: Objective, start: Tensor, position: tuple[int, int], callback: Callback | None
    ) -> tuple[Tensor, dict[str, Tensor], int, ResultCode]:
        begun, count, last = time.process_time(), 0, np.inf
        row, batch = position
        pressure = Pressure(self.penalty, final=self.largest)
        x = start.cpu().double().numpy()

        def tensor(a: np.ndarray) -> Tensor:
            return torch.as_tensor(a, dtype=start.dtype, device=start.device)[None]

        def function(a: np.ndarray) -> float:
            nonlocal count
            if self.seconds is not None and time.process_time() - begun > self.seconds:
                raise _OutOfTimeError
            value = objective.value(tensor(a), pressure)
            count += 1
            if callback is not None and count % 100 == 0:
                total = batch * self.rounds * self.evaluations
                done = row * self.rounds * self.evaluations + count
                terms = objective.terms(tensor(a), pressure)
                callback(Step(f"{row + 1} Nelder-Mead", done, total, terms, objective.groups))
            return value.item() if value.isfinite() else np.inf

        code = ResultCode.STEP_LIMIT
        for _ in range(self.rounds):
            best = _Best(function)
            try:
                minimize(
                    best, x, method="Nelder-Mead", options={"maxfev": self.evaluations, "adaptive": True, "fatol": 1e-9}
                )
            except _OutOfTimeError:
                x = x if best.place is None else best.place
                break
            if best.place is None:
                code = ResultCode.DIVERGED
                break
            x = best.place
            settled = pressure.penalty == self.largest
            if settled and abs(last - best.value) <= self.tolerance * abs(best.value):
                code = ResultCode.CONVERGED
                break
            last = best.value if settled else np.inf
            shape = objective.cup.shape_of(tensor(x))
            moved = {
                name: pressure.multipliers.get(name, 0.0) + pressure.penalty * value.detach()
                for name, value in objective.constraints(shape).items()
            }
            pressure = Pressure(min(pressure.penalty * self.growth, self.largest), moved, final=self.largest)
        return tensor(x)[0], pressure.multipliers, count, code


class _OutOfTimeError(Exception):
    """The time of a problem is up."""


class _Best:
    """Remembers the best place a function was called with."""

    def __init__(self, function):
        self._function, self.place, self.value = function, None, np.inf

    def __call__(self, a: np.ndarray) -> float:
        value = self._function(a)
        if value < self.value:
            self.place, self.value = a.copy(), value
        return value
