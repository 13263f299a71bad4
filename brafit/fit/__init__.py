"""Fitting cups to scans: objective, solvers, results. Knows neither configuration files nor logs."""

import sys
from types import ModuleType
from typing import Any

from brafit.fit.anneal import Anneal, Stage
from brafit.fit.lm import LM, LMStage
from brafit.fit.loop import CupFit, fit_targets
from brafit.fit.nelder_mead import NelderMead
from brafit.fit.objective import Conditions
from brafit.fit.result import ResultCode
from brafit.fit.solver import Solution, Solver, Step
from brafit.fit.targets import Target

__all__ = [
    "LM",
    "Anneal",
    "Conditions",
    "CupFit",
    "LMStage",
    "NelderMead",
    "ResultCode",
    "Solution",
    "Solver",
    "Stage",
    "Step",
    "Target",
    "fit_targets",
]


class _Callable(ModuleType):
    """`brafit.fit(points, wire=...)` is the Python face, under the name of this package: `help(brafit.face.fit)`."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        from brafit.face import fit  # stands above this package, and needs all of it

        return fit(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable
