"""Value, gradient and Gauss-Newton matrix of an objective in one pass, from one search for nearest points.

Rows of the Jacobian come from the cup's linearisation: the envelope theorem holds the feet fixed, so each row is a
sum of a few rows of the samples' derivatives. Automatic differentiation never runs through a search.

Precision is mixed. Value and gradient, which say where the optimum is, have the problems' own precision; the matrix,
which only says how to get there, is computed from rows in single precision, several times faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from brafit.cup.base import Linearised
from brafit.fitting.objective import Objective, Pressure
from brafit.geometry.nearest import project
from brafit.geometry.panels import Feet, Sums
from brafit.geometry.products import aligned, total, weighted_rows

POINTS = 1 << 14
"""Points whose feet are held at a time, over all problems: what the processor's caches hold."""
ROWS = 1 << 18
"""Numbers of their Jacobian held at a time, likewise."""
DEVICE = 1 << 10
"""Factor on both for devices other than the processor, whose time depends on the number of calls."""
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
        terms: what is told of the problems (`Objective.told`).
        feet: the points' feet.
    """

    value: Float[Tensor, " batch"]
    gradient: Float[Tensor, "batch columns"]
    matrix: Float[Tensor, "batch columns columns"]
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
        value, gradient, matrix = (
            function(getattr(self, k), getattr(other, k)) for k in ("value", "gradient", "matrix")
        )
        return Normal(value, gradient, matrix, terms, feet)


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

    Args:
        objective: the problems.
        flat: their parameters.
        pressure: weights of constraints, barrier and neckline.
        terms: free terms of the series; None: all.
        near: feet at a place nearby, to be followed instead of a search; None: they are searched.
    """
    linear = objective.cup.linearise(flat, terms)
    return assembled(objective, flat, pressure, linear, points_of(objective, linear, near))


@torch.no_grad()
def points_of(objective: Objective, linear: Linearised, near: Feet | None = None) -> "Points":
    """What the points of all problems add at cups and their derivatives; `near` as in `normal_equations`."""
    return Points.cat([PointRows.of(objective, linear, near, problems).reduced() for problems in slices(objective)])


@dataclass(frozen=True)
class Points:
    """What the points add to the quadratic model of B objectives, their mean squared distance, and their feet. Columns
    come as in `Linearised`.
    """

    value: Float[Tensor, " batch"]
    gradient: Float[Tensor, "batch columns"]
    matrix: Float[Tensor, "batch columns columns"]
    square: Float[Tensor, " batch"]
    feet: Feet

    @staticmethod
    def cat(parts: Sequence["Points"]) -> "Points":
        """Those of all problems from those of some."""

        def all_of(items: Sequence, name: str) -> Tensor:
            return torch.cat([getattr(item, name) for item in items])

        feet = Feet(*(all_of([part.feet for part in parts], f.name) for f in fields(Feet)))
        value, gradient, matrix, square = (all_of(parts, k) for k in ("value", "gradient", "matrix", "square"))
        return Points(value, gradient, matrix, square, feet)


def slices(objective: Objective) -> list[slice]:
    """The problems in groups, small enough for the processor's caches to hold what is computed of their points."""
    batch, count = objective.targets.points.shape[:2]
    each = max(1, _held(objective.targets.points, POINTS) // max(1, count))
    return [slice(first, min(first + each, batch)) for first in range(0, batch, each)]


def _held(like: Tensor, on_processor: int) -> int:
    return on_processor if like.device.type == "cpu" else on_processor * DEVICE


@dataclass(frozen=True)
class PointRows:
    """The points of some problems, panel by panel: points on the lower panels do not depend on what shapes the upper
    ones.

    Attributes:
        value: the points' part of the objectives.
        square: their mean squared distance.
        feet: in the points' own order.
        order: of the points, by panels.
        counts: how many are on each panel.
        slope, distances, directions, sums: in that order: Gauss-Newton weights, signed distances, the unit vectors that
            they are measured along, and what they are sums of.
        table: derivatives of the samples that they are sums of.
        reach: as in `Linearised`.
    """

    value: Float[Tensor, " some"]
    square: Float[Tensor, " some"]
    feet: Feet
    order: Int[Tensor, "some points"]
    counts: Int[Tensor, "some panels"]
    slope: Float[Tensor, "some points"]
    distances: Float[Tensor, "some points"]
    directions: Float[Tensor, "some points 3"]
    sums: Sums
    table: Float[Tensor, "some rows 3 columns"]
    reach: tuple[int, ...]

    @staticmethod
    def of(objective: Objective, linear: Linearised, near: Feet | None, problems: slice) -> "PointRows":
        """At cups and their derivatives; `near` as in `normal_equations`."""
        shape, points = linear.shape, objective.targets.points[problems]
        edges, tangents = shape.edges[problems], shape.tangents[problems]
        near = None if near is None else near.at(problems)
        iterations = _ITERATIONS if near is None else _FOLLOWING
        projection = project(points, edges, tangents, shape.stations, iterations, near)
        feet, distances = projection.feet, projection.distances
        value, slope = objective.points_block(distances, problems).model()
        square = objective.mean_square(distances, problems)
        # Points that only fill the batch come last, and count in no product: how many there are depends on the batch.
        panel = feet.panel.masked_fill(objective.targets.weights[problems] == 0, len(linear.reach))
        order = panel.argsort(dim=1, stable=True)
        own = Feet(*(getattr(feet, f.name).gather(1, order) for f in fields(Feet)))
        directions = projection.directions.gather(1, order[..., None].expand_as(projection.directions))
        slope, distances = (v.gather(1, order) for v in (slope.expand_as(distances), distances))
        counts = torch.stack([(panel == i).sum(1) for i in range(len(linear.reach))], dim=1)
        sums = Sums.of(directions, own, shape.stations, edges.shape[1])
        table, reach = linear.table[problems], linear.reach
        return PointRows(value, square, feet, order, counts, slope, distances, directions, sums, table, reach)

    def reduced(self) -> Points:
        """Their part of the quadratic model."""
        return Points(self.value, self.gradient(), self.matrix(), self.square, self.feet)

    def gradient(self) -> Float[Tensor, "some columns"]:
        """Of the points' value."""
        return self.sums.gradient(self.slope * self.distances, self.table)

    def matrix(self) -> Float[Tensor, "some columns columns"]:
        """Gauss-Newton matrix of the points' value, some problems, or some points of one, at a time."""
        (batch, count), size = self.slope.shape, self.table.shape[-1]
        held = _held(self.table, ROWS)
        table, slope = self.table.float(), self.slope.float()
        matrix = table.new_zeros(batch, size, size)
        some, each = max(1, held // max(1, count * size)), max(1, held // size)
        counts = self.counts.tolist() if matrix.device.type == "cpu" else None
        for first in range(0, batch, some):
            problems = slice(first, first + some)
            for start in range(0, count, each):
                part = problems, slice(start, start + each)
                jacobian = self.sums.part(part).jacobian(table[problems])
                if counts is None:
                    matrix[problems] += gram(jacobian, slope[part])
                else:
                    _add_nested_grams(matrix[problems], jacobian, slope[part], counts[problems], start, self.reach)
        return matrix.to(self.table)


@torch.no_grad()
def assembled(
    objective: Objective,
    flat: Float[Tensor, "batch size"],
    pressure: Pressure,
    linear: Linearised,
    points: Points,
) -> Normal:
    """The objective's quadratic model from the cups' linearisation and the points' part.

    Args:
        objective: the problems.
        flat: their parameters.
        pressure: weights of constraints, barrier and neckline.
        linear: the cups at `flat` and their derivatives.
        points: the points' part, of all problems.
    """
    values = [points.value]
    gradient, matrix = points.gradient, points.matrix
    blocks = objective.blocks(flat, linear.shape, pressure, linear.margin, linear.unfairness)
    rows = []
    for block in blocks:
        own_value, slope = block.model()
        values.append(own_value)
        if block.diagonal is not None:
            own, factor = slope[:, linear.columns], block.diagonal[linear.columns]
            gradient += own * factor * block.residual[:, linear.columns]
            matrix.diagonal(dim1=-2, dim2=-1).add_(own * factor**2)
        else:
            jacobian = block.jacobian(linear, objective.cup.size)
            gradient += weighted_rows(slope * block.residual, jacobian)
            rows.append((jacobian.float(), slope.float()))
    if rows:
        matrix += gram(*(torch.cat(parts, dim=1) for parts in zip(*rows, strict=True)))
    value = total(values)
    order = linear.columns.argsort()
    gradient, matrix = gradient[:, order], matrix[:, order][:, :, order]
    unasked = objective.unasked(linear.columns[order])
    terms = objective.told(blocks, points.value, points.square)
    gradient = gradient.masked_fill(unasked, 0.0)
    matrix = matrix.masked_fill(unasked[:, None] | unasked[..., None], 0.0) + torch.diag_embed(unasked.to(matrix))
    return Normal(value, gradient, matrix, terms, points.feet)


def gram(
    jacobian: Float[Tensor, "batch m size"], weights: Float[Tensor, "batch m"]
) -> Float[Tensor, "batch size size"]:
    """J^T W J; on the CPU one problem at a time, so that rounding does not depend on the batch."""
    if jacobian.device.type != "cpu":
        return torch.bmm(jacobian.mT, jacobian * weights[..., None])
    return torch.stack([aligned(j).mT @ (j * w[:, None]) for j, w in zip(jacobian, weights, strict=True)])


def _add_nested_grams(
    matrix: Float[Tensor, "batch size size"],
    jacobian: Float[Tensor, "batch m size"],
    weights: Float[Tensor, "batch m"],
    counts: Sequence[Sequence[int]],
    start: int,
    reach: Sequence[int],
) -> None:
    """Add `gram` of rows that are sorted by panels and zero beyond their panel's reach. `counts`: rows of each panel;
    `start`: how many of them come before these.
    """
    end = start + jacobian.shape[1]
    for item, own_rows, slope, numbers in zip(matrix, jacobian, weights, counts, strict=True):
        own, rows, first = aligned(item), aligned(own_rows), 0
        for count, width in zip(numbers, reach, strict=True):
            low, high = max(first, start), min(first + count, end)
            first += count
            if low < high:
                part = rows[low - start : high - start, :width]
                own[:width, :width].addmm_(part.mT, part * slope[low - start : high - start, None])
        if own is not item:
            item.copy_(own)
