"""Residuals of one kind, with their weight and their derivatives: what an objective is the sum of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import Linearised
from brafit.cup.edge_gaps import Gaps
from brafit.cup.shape import CupShape
from brafit.fitting.loss import Loss, square
from brafit.geometry.developable import dot
from brafit.geometry.grid import station_weights

Rows = Callable[[Linearised], Tensor]
"""Derivatives of residuals (batch, m, columns) from the cups' linearisation."""


@dataclass(frozen=True)
class Block:
    """Residuals of one kind: value = sum of weight * rho(residual^2).

    Attributes:
        name: what `Step` tells of it.
        residual: the residuals, solver units.
        weight: their weights.
        condition: the condition whose weight this is (`brafit.fitting.objective.WEIGHTS`); empty: none, it is a
            constraint.
        loss: rho.
        rows: derivatives of the residuals. Not needed with `gaps` or `diagonal`, nor of the points, which have a way of
            their own (`brafit.fitting.normal.PointRows`).
        gaps: where the residuals are the components of gaps between the cup and fixed points. There rho takes the
            squared length of each gap: a sum of rho over the components would depend on the axes, and its gradient on
            how the foot points slide.
        diagonal: where residual k depends on parameter k alone: its derivative.
        final: the block as it counts in the end, if a stage has it otherwise.
    """

    name: str
    residual: Float[Tensor, "batch m"]
    weight: Tensor | float
    condition: str = ""
    loss: Loss = square
    rows: Rows | None = None
    gaps: Gaps | None = None
    diagonal: Float[Tensor, " m"] | None = None
    final: Block | None = None

    def value(self) -> Float[Tensor, " batch"]:
        return (self.weight * self.loss(self.squared())[0]).sum(-1)

    def model(self) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch m"]]:
        """The value, and the residuals' Gauss-Newton weights 2 weight rho'. A weight times its residual is the value's
        derivative by it.
        """
        squared = self.squared()
        rho, slope = self.loss(squared)
        slope = 2 * self.weight * slope
        return (self.weight * rho).sum(-1), slope if self.gaps is None else slope.repeat_interleave(3, dim=-1)

    def told(self) -> Float[Tensor, " batch"]:
        """The value as it counts in the end."""
        return (self.final or self).value()

    def squared(self) -> Float[Tensor, "batch k"]:
        """What rho takes: squared residuals, or squared lengths of gaps."""
        return self.residual.square() if self.gaps is None else dot(self.gaps.vectors, self.gaps.vectors)

    def jacobian(self, linear: Linearised, size: int) -> Float[Tensor, "batch m columns"]:
        """Derivatives of the residuals by the linearisation's columns. `size`: number of the cup's parameters."""
        if self.gaps is not None:
            own = self.gaps.own
            last = None if own is None else int((linear.columns >= size - own.shape[-1]).sum())
            return self.gaps.columns(linear.table, last).flatten(1, 2)
        assert self.rows is not None, self.name
        return self.rows(linear)


def pull(name: str, condition: str, gaps: Gaps, weight: Tensor, loss: Loss = square) -> Block:
    """Gaps to be closed."""
    return Block(name, gaps.vectors.flatten(1), weight, condition, loss, gaps=gaps)


def pulls(
    edge_name: str, line_name: str, condition: str, shape: CupShape, there: Gaps, back: Gaps, weight: Tensor | float
) -> list[Block]:
    """An edge drawn to a line both ways: `weight` times the mean squared distance, each way."""
    batch, points = back.vectors.shape[:2]
    mean = station_weights(shape.stations).expand(batch, -1)
    return [
        pull(f"{edge_name} to {line_name}", condition, there, weight * mean),
        pull(f"{line_name} to {edge_name}", condition, back, weight / points * torch.ones_like(mean[:, :1])),
    ]
