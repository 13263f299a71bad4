"""What a training loop of one's own needs beside the distances of points."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import Cup
from brafit.fitting.objective import Conditions, Objective, Pressure
from brafit.fitting.targets import Target, Targets


class ConditionLoss:
    """What conditions ask of cups beside the distances of points, as a loss: neckline, strap point, margin, fairness,
    and the model's own constraints where it has some.

    Args:
        cup: the cups, in their precision and place; the loss follows their parameters as they change.
        targets: one for each cup.
        conditions: weights and widths; those of the points are not used.

    Raises:
        ValueError: targets and cups differ in number.
    """

    def __init__(self, cup: Cup, targets: Sequence[Target], conditions: Conditions | None = None):
        if len(targets) != cup.batch:
            raise ValueError(f"{cup.batch} cups need as many targets, got {len(targets)}")
        conditions = Conditions() if conditions is None else conditions
        batch = Targets.stack(targets, cup.wire.scale, neckline_wave=conditions.neckline_wave)
        self._problem = Objective(cup, batch, conditions)

    def __call__(self, penalty: float = 100.0) -> Float[Tensor, " batch"]:
        """The loss of every cup as it stands, differentiable in its parameters: mm^2, to be added to a mean of squared
        distances in mm.

        Args:
            penalty: weight of the model's own constraints; without effect on `StripsCup`, which has none.
        """
        problem, cup = self._problem, self._problem.cup
        flat = cup.flatten()
        shape = cup.sketch(flat)
        blocks = problem.blocks(flat, shape, Pressure(penalty), shape.margin, cup.unfairness(flat))
        values = [block.value() for block in blocks]
        loss = torch.stack(values).sum(0) if values else torch.zeros_like(cup.wire.scale)
        return loss * cup.wire.scale.square()
