"""How a fit ended, and what is measured of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from jaxtyping import Float
from numpy import ndarray

EdgeDeviations = tuple[Float[ndarray, " n"], Float[ndarray, " n"]]
"""Standard deviations (mm) of the places of a panel's lower and upper edge, at the stations."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What is measured of a cup and its alternatives (`brafit.report.dimensions`).

    Attributes:
        taped: lengths over the surface, mm, by their names; without those that the cup does not have.
        through_air: span, depth, and distances that no tape takes, likewise.
        deviation: standard deviations of dimensions by part and name, mm or cm2; none without alternatives.
        outlines: of each panel, see `brafit.fitting.certainty.outline_deviation`; none where nobody asked for them.
    """

    taped: Mapping[str, float]
    through_air: Mapping[str, float]
    deviation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    outlines: Sequence[EdgeDeviations] = ()


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
