"""What weighs more, problem by problem, where a cup falls short of what is asked of it: regularity barrier, neckline,
and the pull of a ridge to the apex. And what the multipliers of constraints take over from their penalty.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from brafit.cup.edge_gaps import gaps_to_line, gaps_to_points
from brafit.cup.shape import CupShape
from brafit.fitting.objective import APEX, SEAM_LIMIT, Objective, Pressure
from brafit.geometry.grid import station_weights

_WORTH = 1.08
"""A neckline's weight that is to be raised by less is not worth fitting again."""
_BARRIER = 10.0
"""By how much a barrier is raised."""
_STRONGER = 1.3
"""The distance between apex and ridge falls about as the weight's inverse; it is raised by so much more."""
_RESPONSE = 1.5
"""Power of the distance between edge and neckline over its limit, by which the weight is raised. The distance falls
about as the root of the weight: so it comes to the limit in two or three goes, and not below it."""


@dataclass(frozen=True)
class RaisedWeights:
    """Factors of the weights of B problems, and multipliers of their constraints; they grow as a solver goes on.

    Attributes:
        barrier, neckline, seam: see `Pressure`.
        multipliers: likewise.
    """

    barrier: Float[Tensor, "batch 1"]
    neckline: Float[Tensor, "batch 1"]
    seam: Float[Tensor, "batch 1"]
    multipliers: dict[str, Float[Tensor, "batch m"]] = field(default_factory=dict)

    @staticmethod
    def none(start: Float[Tensor, "batch size"]) -> RaisedWeights:
        """Of problems with these starts, none raised yet."""
        barrier, neckline, seam = (torch.ones_like(start[:, :1]) for _ in range(3))
        return RaisedWeights(barrier, neckline, seam)

    def pressure(self, penalty: float, final: float | None = None) -> Pressure:
        """How hard all conditions press now.

        Args:
            penalty: of the constraints.
            final: see `Pressure`.
        """
        return Pressure(penalty, self.multipliers, self.barrier, self.neckline, self.seam, final)

    def raise_neckline(self, objective: Objective, shape: CupShape, rows: Int[Tensor, " some"]) -> Tensor:
        """Raise the neckline's weight where the upper edge is too far from it; returns by how much.

        Args:
            objective: of some of the problems.
            shape: their cups.
            rows: which they are.
        """
        factor = neckline_factor(objective, shape)
        self.neckline[rows] *= factor[:, None]
        return factor

    def raise_all(
        self, objective: Objective, shape: CupShape, rows: Int[Tensor, " some"], slack: float
    ) -> Bool[Tensor, " some"]:
        """Raise every weight that is too low; returns which problems are worth fitting again.

        Args:
            objective: of some of the problems.
            shape: their cups.
            rows: which they are.
            slack: how far the regularity margin may lie below `Conditions.margin`.
        """
        factor = self.raise_neckline(objective, shape, rows)
        low = shape.margin.amin((-2, -1)) < objective.conditions.margin - slack
        low &= objective.conditions.barrier > 0
        self.barrier[rows[low]] *= _BARRIER
        pull = seam_factor(objective, shape)
        self.seam[rows] *= pull[:, None]
        return low | (factor > _WORTH) | (pull > 1)

    def take_over(
        self, objective: Objective, place: Float[Tensor, "batch size"], penalty: float, rows: Int[Tensor, " some"]
    ) -> None:
        """Multipliers take over what the penalty held.

        Args:
            objective: of all problems.
            place: where they stand.
            penalty: of the constraints, with which they came there.
            rows: the problems that this is for.
        """
        if not objective.cup.constrained:
            return
        for name, residual in objective.constraints(objective.cup.sketch(place)).items():
            kept = self.multipliers.setdefault(name, torch.zeros_like(residual))
            kept[rows] += penalty * residual[rows].detach()


@torch.no_grad()
def neckline_factor(objective: Objective, shape: CupShape) -> Float[Tensor, " batch"]:
    """By how much to raise the neckline's weight: the mean distance between upper edge and neckline, both ways, over
    its limit, to a power. 1 where it is within the limit, where there is no neckline, and for cups with constraints.

    Args:
        objective: the problems.
        shape: their cups.
    """
    targets, limit = objective.targets, objective.conditions.neckline_limit
    if limit is None or objective.cup.constrained or objective.conditions.neckline == 0:
        return torch.ones_like(targets.scale)
    line = targets.neckline
    there = (gaps_to_line(shape, -1, line).vectors.norm(dim=-1) * station_weights(shape.stations)).sum(-1)
    back = gaps_to_points(shape, -1, line).vectors.norm(dim=-1).mean(-1)
    excess = 0.5 * (there + back) * targets.scale / limit
    # number by number: a vector's logarithms are rounded by where they stand in it
    raised = excess.new_tensor([max(value, 1.0) ** _RESPONSE for value in excess.tolist()])
    return torch.where(targets.has_neckline, raised, 1.0)


@torch.no_grad()
def seam_factor(objective: Objective, shape: CupShape) -> Float[Tensor, " batch"]:
    """By how much to raise the ridge's pull to the apex: the distance between them over its limit, and a little more.
    1 where it is within the limit, where nothing asks for it, and for cups with constraints.

    Args:
        objective: the problems.
        shape: their cups.
    """
    targets = objective.targets
    if objective.conditions.seam != APEX or objective.cup.constrained or objective.cup.panels < 2:
        return torch.ones_like(targets.scale)
    excess = objective.ridge_gap(shape).vectors.norm(dim=-1)[:, 0] * targets.scale / SEAM_LIMIT
    return torch.where(targets.has_apex & (excess > 1), _STRONGER * excess, 1.0)
