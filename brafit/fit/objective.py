"""The objective (43) as named blocks of residuals, batched: value = sum over blocks of weight * sum rho(residual^2).

The objective knows cups and targets, but no solver. Constraints are blocks too: a solver sets their penalty and multipliers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import Cup
from brafit.cup.condition import line_offset, margin_shortfall, upper_edge_offsets
from brafit.cup.shape import CupShape
from brafit.fit.loss import Loss, fuzzy, point_loss, square
from brafit.fit.targets import Targets
from brafit.geometry.developable import dot
from brafit.geometry.nearest import (
    Feet,
    distance_jacobian,
    foot_directions,
    nearest_feet,
    sample_table,
    signed_distance,
    surface_points,
)

Flat = Float[Tensor, "batch size"]


@dataclass(frozen=True)
class Conditions:
    """What is asked of a cup, and how strongly. Weights multiply mean squares in units of (wire length / pi)^2.

    Attributes:
        points: loss of the point distances: l2, l1 (31) or robust.
        points_width: rounding of l1 and scale of robust, mm.
        neckline: weight of the mean squared distance between upper edge and neckline, each way.
        connection: k1 of the fuzzy condition (42) that draws the upper edge to the strap point.
        connection_width: 1 / sqrt(k2), mm: within it the condition is nearly free, beyond it steep.
        ridge_apex: k1 of the same condition that draws the ridge to the apex; 0 leaves the ridge free.
        ridge_apex_width: its width, mm.
        margin: the regularity margin that the barrier keeps.
        barrier: weight of the barrier.
        smoothness: weight of the roughness of the parameters.
    """

    points: str = "l2"
    points_width: float = 0.5
    neckline: float = 0.3
    connection: float = 0.01
    connection_width: float = 20.0
    ridge_apex: float = 0.0
    ridge_apex_width: float = 10.0
    margin: float = 0.3
    barrier: float = 1.0
    smoothness: float = 1e-7

    def __post_init__(self) -> None:
        point_loss(self.points, 1.0)
        for name in ("points_width", "connection_width", "ridge_apex_width"):
            if not getattr(self, name) > 0:
                raise ValueError(f"condition.{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True)
class Block:
    """Residuals of one kind: value = sum of weight * rho(residual^2)."""

    name: str
    residual: Float[Tensor, "batch m"]
    weight: Tensor | float
    loss: Loss = square

    def value(self) -> Float[Tensor, " batch"]:
        return (self.weight * self.loss(self.residual.square())[0]).sum(-1)


@dataclass(frozen=True)
class Pressure:
    """How hard the constraints press: penalty mu and multipliers lambda of lambda c + mu/2 c^2, per constraint.

    The multipliers make the constraints hold without an endless penalty (the multiplier method).
    """

    penalty: float
    multipliers: dict[str, Tensor] = field(default_factory=dict)

    def select(self, index: Tensor) -> "Pressure":
        return Pressure(self.penalty, {k: v[index] for k, v in self.multipliers.items()})


@dataclass(frozen=True)
class Evaluation:
    """Objective of B problems at one place."""

    value: Float[Tensor, " batch"]
    gradient: Flat
    terms: dict[str, Float[Tensor, " batch"]]


class Objective:
    """The objective of B cups against B targets.

    Args:
        cup: the cup model; its wire and buffers are used, its parameters come as flat matrices.
        targets: what to fit.
        conditions: weights and widths.
    """

    def __init__(self, cup: Cup, targets: Targets, conditions: Conditions):
        self.cup, self.targets, self.conditions = cup, targets, conditions

    def select(self, index: Tensor) -> "Objective":
        """The problems with these batch indices."""
        return Objective(self.cup.select(index), self.targets.select(index), self.conditions)

    def feet(self, shape: CupShape, iterations: int = 4) -> Feet:
        """Nearest points of the targets' clouds on the cups."""
        edges, tangents = shape.edges.detach(), shape.tangents.detach()
        return nearest_feet(self.targets.points, edges, tangents, shape.stations, iterations)

    def distances(self, shape: CupShape, feet: Feet) -> Float[Tensor, "batch points"]:
        return signed_distance(self.targets.points, shape.edges, shape.tangents, shape.stations, feet)

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        """The cup model's own constraints, scaled so that a sum of squares is a mean over stations; maybe none."""
        return self.cup.constraints(shape)

    def points_block(self, distances: Float[Tensor, "batch points"]) -> Block:
        """The error between cloud and cup, (31)."""
        c = self.conditions
        width = c.points_width / self.targets.scale[:, None]
        return Block("points", distances, self.targets.weights, point_loss(c.points, width))

    def blocks(self, flat: Flat, shape: CupShape, pressure: Pressure) -> list[Block]:
        """All residuals but the points', constraints last."""
        c, targets = self.conditions, self.targets
        unit = targets.scale[:, None]
        blocks = []
        if c.neckline > 0:
            edge, line = (x.flatten(1) for x in upper_edge_offsets(shape, targets.neckline))
            has = targets.has_neckline[:, None].to(edge)
            blocks.append(Block("edge to neckline", edge, c.neckline * has * 3 / edge.shape[1]))
            blocks.append(Block("neckline to edge", line, c.neckline * has * 3 / line.shape[1]))
        if c.connection > 0:
            gap = line_offset(targets.connection[:, None], shape.edges[:, -1])[:, 0]
            sharpness = (unit / c.connection_width) ** 2
            has = targets.has_connection[:, None].to(gap)
            blocks.append(Block("connection", gap, has, partial(fuzzy, strength=c.connection, sharpness=sharpness)))
        if c.ridge_apex > 0 and self.cup.panels > 1:
            gap = self._ridge_gap(shape)
            sharpness = (unit / c.ridge_apex_width) ** 2
            has = targets.has_apex[:, None].to(gap)
            blocks.append(Block("ridge at apex", gap, has, partial(fuzzy, strength=c.ridge_apex, sharpness=sharpness)))
        if c.barrier > 0:
            shortfall = margin_shortfall(shape, c.margin, width=0.05)
            blocks.append(Block("regularity", shortfall, c.barrier / shortfall.shape[1]))
        if c.smoothness > 0:
            blocks.append(Block("roughness", self.cup.roughness(flat), c.smoothness))
        for name, value in self.constraints(shape).items():
            shift = pressure.multipliers.get(name)
            residual = value if shift is None else value + shift / pressure.penalty
            blocks.append(Block(name, residual, 0.5 * pressure.penalty))
        return blocks

    def _ridge_gap(self, shape: CupShape) -> Float[Tensor, "batch 3"]:
        """From the nearest ridge to the apex."""
        apex = self.targets.apex[:, None]
        gaps = torch.stack([line_offset(apex, ridge)[:, 0] for ridge in shape.edges[:, 1:-1].unbind(1)], dim=1)
        nearest = gaps.detach().square().sum(-1).argmin(1)
        return gaps[torch.arange(len(gaps), device=gaps.device), nearest]

    def evaluate(self, flat: Flat, pressure: Pressure) -> Evaluation:
        """Value, gradient and the value of each block."""
        with torch.enable_grad():
            flat = flat.detach().requires_grad_()
            shape = self.cup.shape_of(flat)
            points = self.points_block(self.distances(shape, self.feet(shape)))
            blocks = [points, *self.blocks(flat, shape, pressure)]
            values = {block.name: block.value() for block in blocks}
            value = torch.stack(list(values.values())).sum(0)
            (gradient,) = torch.autograd.grad(value.sum(), flat)
        return Evaluation(value.detach(), gradient, {k: v.detach() for k, v in values.items()})

    @torch.no_grad()
    def curvature(self, flat: Flat, pressure: Pressure) -> Float[Tensor, "batch size size"]:
        """Gauss-Newton matrix of the objective: J^T W J over all blocks, with the feet held fixed."""
        shape = self.cup.shape_of(flat)
        feet = self.feet(shape)
        edges, tangents, stations = shape.edges, shape.tangents, shape.stations

        def others(at: Tensor) -> tuple[Tensor, Tensor]:
            own = self.cup.shape_of(at)
            residuals = [b.residual for b in self.blocks(at, own, pressure)]
            return torch.cat(residuals, dim=1), sample_table(own.edges, own.tangents)

        others_jacobian, table_jacobian = columns(others, flat)
        directions = foot_directions(self.targets.points, edges, tangents, stations, feet)
        points_jacobian = distance_jacobian(
            directions, feet, stations, edges.shape[1], table_jacobian.movedim(0, -1).contiguous()
        )
        points = self.points_block(dot(self.targets.points - surface_points(edges, tangents, stations, feet), directions))
        weights = torch.cat([_slopes(b) for b in self.blocks(flat, shape, pressure)], dim=1)
        return _gram(points_jacobian, _slopes(points)) + _gram(others_jacobian.movedim(0, -1), weights)


def columns(function: Callable[[Tensor], tuple[Tensor, ...]], at: Flat) -> tuple[Tensor, ...]:
    """Derivatives of a batched function by each of the parameters, forward mode: (size, *output) for each output."""
    directions = torch.eye(at.shape[1], dtype=at.dtype, device=at.device)[:, None].expand(-1, *at.shape)
    return torch.func.vmap(lambda d: torch.func.jvp(function, (at,), (d,))[1])(directions)


def _slopes(block: Block) -> Float[Tensor, "batch m"]:
    """Gauss-Newton weights of a block's residuals: the second derivative of its value by them, rho' alone."""
    return (2 * block.weight * block.loss(block.residual.square())[1]).expand_as(block.residual)


def _gram(jacobian: Float[Tensor, "batch m size"], weights: Float[Tensor, "batch m"]) -> Float[Tensor, "batch size size"]:
    """J^T W J, one problem at a time, so that rounding does not depend on the batch."""
    return torch.stack([j.mT @ (j * w[:, None]) for j, w in zip(jacobian, weights)])
