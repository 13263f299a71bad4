"""Fitting cups to scans: objective, solvers, results. Reads neither settings nor files, writes no logs; errors and
warnings name the setting that helps.
"""

from brafit.fitting.anneal import Anneal, AnnealStage
from brafit.fitting.condition import Condition
from brafit.fitting.differentiable import DifferentiableFit, FittedCups, TensorTarget
from brafit.fitting.lm import LM, LMStage
from brafit.fitting.loop import CupFit, fit_targets
from brafit.fitting.nelder_mead import NelderMead
from brafit.fitting.objective import Conditions
from brafit.fitting.result import ResultCode
from brafit.fitting.solver import Solution, Solver, Step
from brafit.fitting.start import start_cups
from brafit.fitting.targets import Target
from brafit.fitting.training import ConditionLoss

__all__ = [
    "LM",
    "Anneal",
    "AnnealStage",
    "Condition",
    "ConditionLoss",
    "Conditions",
    "CupFit",
    "DifferentiableFit",
    "FittedCups",
    "LMStage",
    "NelderMead",
    "ResultCode",
    "Solution",
    "Solver",
    "Step",
    "Target",
    "TensorTarget",
    "fit_targets",
    "start_cups",
]
