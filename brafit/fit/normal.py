"""Value, gradient and Gauss-Newton matrix of an objective in one pass, from one search for nearest points.

Rows of the Jacobian come from the cup's linearisation: the envelope theorem holds the feet fixed, so each row is a
sum of a few rows of the samples' derivatives. Automatic differentiation never runs through a search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from brafit.cup.base import Linearised
from brafit.fit.objective import Block, Objective, Pressure
from brafit.geometry.nearest import Feet, distance_jacobian, project

ROWS = 1 << 22
"""Numbers of the points' Jacobian held at a time, over the whole batch."""
_ITERATIONS = 3
"""Newton steps of the feet beside the nearest sampled ruling: the next step of the solver finds them anew."""

_FOLLOWING = 1
"""Newton steps, after the first, of feet that are followed."""


@dataclass(frozen=True)
class Normal:
    """The objective of B problems and its quadratic model in some of the parameters.

    Attributes:
        value: the objective.
        gradient, matrix: its gradient and Gauss-Newton matrix by these parameters.
        margin: smallest regularity margin.
        terms: value of every block.
        feet: the points' feet.
    """

    value: Float[Tensor, " batch"]
    gradient: Float[Tensor, "batch columns"]
    matrix: Float[Tensor, "batch columns columns"]
    margin: Float[Tensor, " batch"]
    terms: dict[str, Float[Tensor, " batch"]]
    feet: Feet

    def select(self, index: Int[Tensor, " some"]) -> "Normal":
        """The problems with these batch indices."""
        return self._map(lambda v, _: v[index], self)

    def choose(self, which: Bool[Tensor, " batch"], other: "Normal") -> "Normal":
        """Problem by problem this one, or the other where `which` is false."""
        return self._map(lambda a, b: torch.where(which.view(-1, *[1] * (a.dim() - 1)), a, b), other)

    def _map(self, function: Callable[[Tensor, Tensor], Tensor], other: "Normal") -> "Normal":
        terms = {k: function(v, other.terms[k]) for k, v in self.terms.items()}
        feet = Feet(*(function(getattr(self.feet, f.name), getattr(other.feet, f.name)) for f in fields(Feet)))
        value, gradient, matrix, margin = (
            function(getattr(self, k), getattr(other, k)) for k in ("value", "gradient", "matrix", "margin")
        )
        return Normal(value, gradient, matrix, margin, terms, feet)


@torch.no_grad()
def normal_equations(
    objective: Objective,
    flat: Float[Tensor, "batch size"],
    pressure: Pressure,
    terms: int | None = None,
    near: Feet | None = None,
) -> Normal:
    """The objective at a place, by the parameters that are free with this many terms: `Cup.columns` (all by
    default).

    `near`: feet at a place nearby, to be followed instead of a search.
    """
    linear = objective.cup.linearise(flat, terms)
    values, feet, gradient, matrix = _points(objective, linear, near)
    blocks = objective.blocks(flat, linear.shape, pressure, linear.margin, linear.unfairness)
    rows = []
    for block in blocks:
        values[block.name], slope = block.model()
        if block.name == "plainness" and (plain := objective.cup.plain) is not None:  # a residual a parameter
            own, factor = slope[:, linear.columns], plain[1][linear.columns]
            gradient += own * factor * block.residual[:, linear.columns]
            matrix.diagonal(dim1=-2, dim2=-1).add_(own * factor**2)
        else:
            rows.append((_jacobian(block, linear, objective), slope, block.residual))
    if rows:
        jacobian, slope, residual = (torch.cat(parts, dim=1) for parts in zip(*rows, strict=True))
        gradient += _weighted(jacobian, slope * residual)
        matrix += gram(jacobian, slope)
    value = torch.stack(list(values.values())).sum(0)
    order = linear.columns.argsort()
    gradient, matrix = gradient[:, order], matrix[:, order][:, :, order]
    unasked = objective.unasked(linear.columns[order])
    gradient = gradient.masked_fill(unasked, 0.0)
    matrix = matrix.masked_fill(unasked[:, None] | unasked[..., None], 0.0) + torch.diag_embed(unasked.to(matrix))
    return Normal(value, gradient, matrix, linear.margin.amin((-2, -1)), values, feet)


def _points(
    objective: Objective, linear: Linearised, near: Feet | None
) -> tuple[dict[str, Tensor], Feet, Tensor, Tensor]:
    """The points' value by its name, their feet, the gradient and the matrix, some points at a time."""
    shape, points = linear.shape, objective.targets.points
    stations, edges = shape.stations, shape.edges
    batch, count = points.shape[:2]
    projection = project(points, edges, shape.tangents, stations, _ITERATIONS if near is None else _FOLLOWING, near)
    feet, directions, distances = projection.feet, projection.directions, projection.distances
    block = objective.points_block(distances)
    value, slope = block.model()
    size = len(linear.columns)
    # Panel by panel: points on the lower ones do not depend on what shapes the upper ones.
    order = feet.panel.argsort(dim=1, stable=True)
    sorted_feet = Feet(*(getattr(feet, f.name).gather(1, order) for f in fields(Feet)))
    directions = directions.gather(1, order[..., None].expand_as(directions))
    slope, distances = (v.gather(1, order) for v in (slope.expand_as(distances), distances))
    gradient, matrix = points.new_zeros(batch, size), points.new_zeros(batch, size, size)
    chunk = max(1, ROWS // max(1, batch * size))
    for first in range(0, count, chunk):
        part = slice(first, first + chunk)
        own = Feet(*(getattr(sorted_feet, f.name)[:, part] for f in fields(Feet)))
        jacobian = distance_jacobian(directions[:, part], own, stations, edges.shape[1], linear.table)
        gradient += _weighted(jacobian, (slope * distances)[:, part])
        matrix += _nested_gram(jacobian, slope[:, part], own.panel, linear.reach)
    return {block.name: value}, feet, gradient, matrix


def _jacobian(block: Block, linear: Linearised, objective: Objective) -> Float[Tensor, "batch m columns"]:
    """Derivatives of a block's residuals."""
    if block.gaps is not None:
        own = block.gaps.own
        last = None if own is None else int((linear.columns >= objective.cup.size - own.shape[-1]).sum())
        return block.gaps.columns(linear.table, last).flatten(1, 2)
    if block.name == "regularity":
        c = objective.conditions
        fading = torch.sigmoid((c.margin - linear.margin) / c.margin_width)
        return (-fading[..., None] * linear.margin_columns).flatten(1, 2)
    return linear.unfairness_columns if block.name == "fairness" else linear.constraints[block.name]


def gram(
    jacobian: Float[Tensor, "batch m size"], weights: Float[Tensor, "batch m"]
) -> Float[Tensor, "batch size size"]:
    """J^T W J; on the CPU one problem at a time, so that rounding does not depend on the batch."""
    if jacobian.device.type != "cpu":
        return torch.bmm(jacobian.mT, jacobian * weights[..., None])
    return torch.stack([j.mT @ (j * w[:, None]) for j, w in zip(jacobian, weights, strict=True)])


def _nested_gram(
    jacobian: Float[Tensor, "batch m size"],
    weights: Float[Tensor, "batch m"],
    panel: Int[Tensor, "batch m"],
    reach: Sequence[int],
) -> Float[Tensor, "batch size size"]:
    """`gram` of rows that come panel by panel and are zero beyond their panel's reach."""
    if jacobian.device.type != "cpu":
        return gram(jacobian, weights)
    counts = torch.stack([(panel == i).sum(1) for i in range(len(reach))], dim=1).tolist()
    matrix = jacobian.new_zeros(*jacobian.shape[::2], jacobian.shape[2])
    for own, rows, slope, numbers in zip(matrix, jacobian, weights, counts, strict=True):
        first = 0
        for count, width in zip(numbers, reach, strict=True):
            part = rows[first : first + count, :width]
            own[:width, :width].addmm_(part.mT, part * slope[first : first + count, None])
            first += count
    return matrix


def _weighted(jacobian: Tensor, weights: Tensor) -> Float[Tensor, "batch size"]:
    return torch.bmm(weights[:, None], jacobian)[:, 0]
