"""Conditions of other kinds than those of `Conditions`, added by whoever needs them: one class each.

A condition says what it asks of cups as residuals in millimetres. It becomes a block of the objective like any other:
every solver, the certainty and the derivatives through the fit see it. See docs/extending.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import Cup, Linearised
from brafit.cup.shape import CupShape
from brafit.fitting.block import Block
from brafit.fitting.loss import Loss, checked_loss, in_unit, square
from brafit.fitting.targets import Targets
from brafit.geometry.products import bmm

SampleSlopes = tuple[Float[Tensor, "batch m edges n 3"], Float[Tensor, "batch m edges n 3"]]
"""Derivatives of residuals by the positions of the edges' samples, and by their tangents."""


class Condition(ABC):
    """What is asked of cups beside what `Conditions` asks.

    Attributes:
        weight: multiplies rho of the squared residuals, summed, in units of (wire length / pi)^2, like the weights of
            `Conditions`: 1 counts as much as the mean squared distance of the points.
        name: what it is called in fit.json, in TensorBoard and among the weights; empty: as its class. No two may be
            called alike.
        loss: rho of squared residuals, mm^2.
    """

    weight: float
    name: str = ""
    loss: Loss = staticmethod(square)

    @property
    def called(self) -> str:
        return self.name or type(self).__name__

    @abstractmethod
    def residuals(self, shape: CupShape, targets: Targets) -> Float[Tensor, "batch m"]:
        """What is to be zero, in millimetres, as a function of B cups, twice differentiable by `torch.autograd`.

        Row k must depend on cup k and target k alone. Where a scan lacks what the condition needs
        (`targets.has_apex`), the row must be zero, and finite.

        Args:
            shape: the cups in their cup frames, mm, on stations that are not evenly spaced.
            targets: the scans, mm (`scale` is 1).
        """

    def derivatives(self, shape: CupShape, targets: Targets) -> SampleSlopes | None:
        """Derivatives of the residuals by the edges' samples, `shape.edges` and `shape.tangents`, if they depend on
        nothing else of the shape. None: `torch.autograd` finds them, in a time that grows with the number of residuals.
        """
        return None

    def measured(self, shape: CupShape, targets: Targets) -> dict[str, Float[Tensor, " batch"]]:
        """What fit.json tells of fitted cups, by name: by default the root of the sum of squares of the residuals."""
        return {"residual_mm": self.residuals(shape, targets).square().sum(-1).sqrt()}


def checked_conditions(given: Iterable[object], taken: Sequence[str]) -> tuple[Condition, ...]:
    """What was given as conditions, if all are.

    Args:
        given: what `Conditions.extra` was given.
        taken: names that they may not have.

    Raises:
        ValueError: one is none, has a name that another has, or no sound weight; names the setting.
    """
    conditions: list[Condition] = []
    for k, one in enumerate(given):
        setting = f"condition.extra.{k}"
        if not isinstance(one, Condition):
            what = f"the class {one.__name__} itself" if isinstance(one, type) else f"a {type(one).__name__}"
            remedy = "give {_target_: MODULE.CLASS, ...}, the class derived from that"
            raise ValueError(f"{setting}: {what} is no brafit.fitting.Condition: {remedy}")
        weight = getattr(one, "weight", None)
        if not isinstance(weight, int | float) or not 0 <= weight < float("inf"):
            raise ValueError(f"{setting}: {one.called} must have a weight, a number that is not negative, got {weight}")
        if one.called in (*taken, *(other.called for other in conditions)):
            raise ValueError(f"{setting}: there is another condition {one.called}; give it a name of its own")
        checked_loss(one.loss, setting)
        conditions.append(one)
    return tuple(conditions)


@torch.no_grad()
def measured_conditions(
    conditions: Sequence[Condition], cup: Cup, targets: Targets
) -> list[dict[str, dict[str, float]]]:
    """What fit.json tells of each of B fitted cups: for each condition its measures by name.

    Args:
        conditions: each with a name of its own.
        cup: the fitted cups.
        targets: one for each cup, in solver units.
    """
    told: list[dict[str, dict[str, float]]] = [{} for _ in range(cup.batch)]
    if not conditions:
        return told
    shape, given = cup.shape(), targets.in_millimetres()
    for condition in conditions:
        values = condition.measured(shape, given)
        for k, own in enumerate(told):
            own[condition.called] = {name: value[k].item() for name, value in values.items()}
    return told


@dataclass(frozen=True)
class Asked:
    """B cups and targets as conditions see them, for one place of the parameters.

    Attributes:
        cup: the cup model.
        flat: the parameters.
        targets: in mm.
        scale: millimetres per solver unit.
    """

    cup: Cup
    flat: Float[Tensor, "batch size"]
    targets: Targets
    scale: Float[Tensor, " batch"]

    @staticmethod
    def of(cup: Cup, flat: Float[Tensor, "batch size"], targets: Targets) -> "Asked":
        """With targets in solver units."""
        return Asked(cup, flat, targets.in_millimetres(), targets.scale)

    def block(self, condition: Condition, shape: CupShape) -> Block:
        """The block of a condition. `shape`: of these cups, solver units."""
        unit = self.scale[:, None]
        return Block(
            name=f"extra {condition.called}",
            residual=self._residuals(condition, shape),
            weight=condition.weight,
            condition=condition.called,
            loss=square if condition.loss is square else partial(in_unit, loss=condition.loss, unit=unit),
            rows=partial(self._rows, condition=condition),
        )

    def _residuals(self, condition: Condition, shape: CupShape) -> Float[Tensor, "batch m"]:
        values = condition.residuals(shape.scaled(self.scale), self.targets)
        if not isinstance(values, Tensor) or values.ndim != 2 or len(values) != self.cup.batch:
            got = f"{(*values.shape,)}" if isinstance(values, Tensor) else type(values).__name__
            wanted = f"a tensor ({self.cup.batch}, m), a row a cup"
            raise ValueError(f"{condition.called}.residuals must give {wanted}, got {got}")
        return values / self.scale[:, None]

    def _rows(self, linear: Linearised, condition: Condition) -> Float[Tensor, "batch m columns"]:
        """Derivatives of the residuals: the condition's own, or automatic ones, a backward pass a residual."""
        slopes = condition.derivatives(linear.shape.scaled(self.scale), self.targets)
        if slopes is not None:  # millimetres by millimetres: the same in solver units
            return bmm(torch.cat([slope.flatten(2) for slope in slopes], dim=-1), linear.table.flatten(1, 2))
        with torch.enable_grad():
            at = self.flat.detach().requires_grad_()
            residual = self._residuals(condition, self.cup.sketch(at))
            each = torch.eye(residual.shape[1], dtype=residual.dtype, device=residual.device)
            each = each[:, None].expand(-1, *residual.shape)
            (rows,) = torch.autograd.grad(residual, at, each, is_grads_batched=True, materialize_grads=True)
        return rows.movedim(0, 1)[..., linear.columns]
