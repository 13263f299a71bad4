"""How a fit ended."""

from __future__ import annotations

from enum import Enum


class ResultCode(Enum):
    """Outcome of one problem of a batch; the value is its reason in words."""

    CONVERGED = "converged"
    STEP_LIMIT = "stopped at the step limit before it converged"
    DIVERGED = "diverged: the objective is not a finite number"
    UNRESOLVED = "not a cup of developable panels"
    UNLIKE = "no likeness of the points"
    DROPPED = "given up for a better start of the same scan"

    @property
    def is_cup(self) -> bool:
        """Whether what came out can be cut and sewn."""
        return self in (ResultCode.CONVERGED, ResultCode.STEP_LIMIT)
