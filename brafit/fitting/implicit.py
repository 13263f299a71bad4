"""Derivatives through a fit, by the implicit function theorem: (76), (77) of docs/formulation.md.

At the optimum a of the objective F(a, d) for the data d, F_a = 0 whatever the data: a'(d) = -F_aa^-1 F_ad. A loss L
of the parameters then has dL/dd = -u . F_ad with F_aa u = dL/da: one equation for each problem of a batch, and one
more derivative of the gradient, whatever the number of data.

F here is the least value over all nearest points, which move as cup and data do (`brafit.geometry.moving`): with the
nearest points held, F_a is right, F_aa and F_ad are not. The weights that a solver raised while it ran (`Pressure`)
are constants. F_aa is the full Hessian, or the Gauss-Newton matrix in its place, which leaves out the residuals' own
bends: for a cup off its points by more than noise the derivatives are then off by parts of a tenth and more.

A solver stops where the objective hardly falls. The theorem wants F_a = 0, so Newton's method goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from brafit.cup.wire import Wire
from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import Objective, Pressure, weight_names
from brafit.geometry.developable import dot
from brafit.geometry.moving import moving_gaps
from brafit.geometry.nearest import nearest_feet
from brafit.geometry.products import dots, solved_each

Flat = Float[Tensor, "batch size"]
Matrix = Float[Tensor, "batch size size"]
Kind = Literal["full", "gauss-newton"]
_FEET = 8
"""Newton steps of the points' feet."""
_HELD = 1 << 15
"""Points, over all problems, whose second derivatives are held at a time, for so many parameters."""
_STEPS = 30
"""Newton steps of the parameters at most."""
_HALVINGS = 12
"""How often a step that does not lower the objective is halved."""
_SETTLED = 1e-20
"""The fall of the objective that is expected, in parts of it, at which a problem has settled: rounding of its
gradient."""
_DEFINITE = 1e-12
"""Least eigenvalue of a Hessian, in parts of the largest, for its optimum to be one."""


@dataclass(frozen=True)
class Data:
    """What the optimum of B problems depends on, in solver units.

    Attributes:
        points, weights, neckline, connection, apex, scale, sheet, sheet_normals, spacing: as in
            `brafit.fitting.targets.Targets`.
        wire: coefficients of the wires.
        shares: what multiplies the conditions' weights, in the order of `weight_names`; 1: they are as given.
    """

    points: Float[Tensor, "batch points 3"]
    weights: Float[Tensor, "batch points"]
    neckline: Float[Tensor, "batch m 3"]
    connection: Float[Tensor, "batch 3"]
    apex: Float[Tensor, "batch 3"]
    scale: Float[Tensor, " batch"]
    sheet: Float[Tensor, "batch sheet 3"]
    sheet_normals: Float[Tensor, "batch sheet 3"]
    spacing: Float[Tensor, " batch"]
    wire: Float[Tensor, "batch terms 3"]
    shares: Float[Tensor, "batch weights"]

    @staticmethod
    def of(objective: Objective) -> "Data":
        """Those of an objective."""
        targets = objective.targets
        own = {name: getattr(targets, name) for name in _TARGETS}
        ones = targets.scale.new_ones(len(targets.scale), len(weight_names(objective.conditions)))
        return Data(**own, wire=objective.cup.wire.coefficients, shares=ones)

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        return tuple(getattr(self, f.name) for f in fields(self))


_TARGETS = tuple(f.name for f in fields(Data))[:9]


@dataclass(frozen=True)
class Problem:
    """The objective of B problems as a function of parameters and data, with the weights that a fit ended with."""

    objective: Objective
    pressure: Pressure
    data: Data

    @staticmethod
    def of(objective: Objective, pressure: Pressure, data: Data) -> "Problem":
        """The problems of an objective with other data: tensors that may carry derivatives."""
        changed = replace(objective.targets, **{name: getattr(data, name) for name in _TARGETS})
        cup = objective.cup
        if data.wire is not cup.wire.coefficients:
            cup = cup.on(Wire(data.wire, data.scale, cup.wire.smoothing))
        return Problem(objective.on(cup, changed).twice_differentiable(), pressure, data)

    def held(self) -> "Problem":
        """Without derivatives by the data."""
        return Problem.of(self.objective, self.pressure, Data(*(d.detach() for d in self.data.tensors)))

    def value(self, flat: Flat) -> Float[Tensor, " batch"]:
        """The objective, twice differentiable in parameters and data."""
        objective = self.objective
        targets, cup = objective.targets, objective.cup
        shape = cup.sketch(flat)
        edges, tangents = shape.edges, shape.tangents
        feet = nearest_feet(targets.points.detach(), edges.detach(), tangents.detach(), shape.stations, _FEET)
        away = moving_gaps(targets.points, edges, tangents, shape.stations, feet)
        points = objective.points_block(away[..., 0])
        values = [(points.condition, (targets.weights * points.loss(dot(away, away))[0]).sum(-1))]
        for block in objective.blocks(flat, shape, self.pressure, shape.margin, cup.unfairness(flat)):
            values.append((block.condition, block.value()))
        shares = dict(zip(weight_names(objective.conditions), self.data.shares.unbind(1), strict=True))
        return torch.stack([shares[name] * value for name, value in values]).sum(0)

    def gradient(self, flat: Flat, create_graph: bool = True) -> tuple[Float[Tensor, " batch"], Flat]:
        """The objective and its gradient by `flat`, which has to require it; 0 by what nothing asks for."""
        with torch.enable_grad():
            value = self.value(flat)
            (gradient,) = torch.autograd.grad(value.sum(), flat, create_graph=create_graph)
            return value, gradient.masked_fill(self.unasked(flat), 0.0)

    def unasked(self, flat: Flat) -> Bool[Tensor, "batch size"]:
        return self.objective.unasked(torch.arange(flat.shape[1], device=flat.device))

    def hessian(self, flat: Flat) -> tuple[Float[Tensor, " batch"], Flat, Matrix]:
        """The objective, its gradient and its full Hessian; the identity for what nothing asks for."""
        flat = flat.detach().requires_grad_()
        value, gradient = self.gradient(flat)
        ones = torch.eye(flat.shape[1], dtype=flat.dtype, device=flat.device)[:, None].expand(-1, *flat.shape)
        each = max(1, _HELD // self.data.weights.numel())
        rows = [
            torch.autograd.grad(gradient, flat, some, retain_graph=True, is_grads_batched=True)[0]
            for some in ones.split(each)
        ]
        matrix, unasked = torch.cat(rows).movedim(0, 1), self.unasked(flat)
        matrix = 0.5 * (matrix + matrix.mT)
        matrix = matrix.masked_fill(unasked[:, None] | unasked[..., None], 0.0) + torch.diag_embed(unasked.to(matrix))
        return value.detach(), gradient.detach(), matrix

    def matrix(self, flat: Flat, kind: Kind) -> Matrix:
        """The full Hessian, or the Gauss-Newton matrix, which is what solvers use."""
        if kind == "full":
            return self.hessian(flat)[2]
        return normal_equations(self.objective, flat, self.pressure).matrix


@dataclass(frozen=True)
class Optimum:
    """Where the objectives of B problems are least, near where a fit ended.

    Attributes:
        flat: the parameters.
        hessian: the full Hessian there.
        settled: whether the gradient vanishes but for rounding, and the Hessian is positive.
        steps: Newton steps that it took.
    """

    flat: Flat
    hessian: Matrix
    settled: Bool[Tensor, " batch"]
    steps: int


@torch.no_grad()
def polished(problem: Problem, flat: Flat, steps: int = _STEPS) -> Optimum:
    """The optimum near parameters, by Newton's method with the full Hessian.

    A direction along which the objective bends down is followed downhill. Steps that do not lower the objective are
    halved.
    """
    place, count = flat.detach().clone(), 0
    value, gradient, matrix = problem.hessian(place)
    while True:
        bends, turn = torch.linalg.eigh(matrix)
        bends, least = bends.abs(), bends[:, 0] / bends[:, -1]
        bends = torch.maximum(bends, _DEFINITE * bends.amax(-1, keepdim=True))
        along = (turn.mT @ gradient[..., None])[..., 0] / bends
        move = -(turn @ along[..., None])[..., 0]
        fall = -dots(gradient, move)
        ended = fall <= _SETTLED * value.abs()
        if count == steps or bool(ended.all()):
            return Optimum(place, matrix, ended & (least > _DEFINITE), count)
        place = _lowered(problem, place, value, torch.where(ended[:, None], 0.0, move))
        value, gradient, matrix = problem.hessian(place)
        count += 1


def _lowered(problem: Problem, place: Flat, value: Float[Tensor, " batch"], move: Flat) -> Flat:
    """The places after these moves, each halved as often as needed not to raise the objective beyond rounding."""
    reach = torch.ones_like(value)
    for _ in range(_HALVINGS):
        there = problem.value(place + reach[:, None] * move)
        worse = ~(there <= value * (1 + 1e-13))
        if not bool(worse.any()):
            break
        reach = torch.where(worse, 0.5 * reach, reach)
    return place + reach[:, None] * move


class _AtOptimum(torch.autograd.Function):
    """The parameters at the optimum, as a function of the data."""

    @staticmethod
    def forward(ctx: Any, problem: Problem, flat: Tensor, matrix: Tensor, *data: Tensor) -> Tensor:
        ctx.problem = problem
        ctx.save_for_backward(flat, matrix, *data)
        return flat.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        flat, matrix, *data = ctx.saved_tensors
        needed = ctx.needs_input_grad[3:]
        unasked = ctx.problem.unasked(flat)
        solved, usable = solved_each(matrix, upstream[0].masked_fill(unasked, 0.0))
        solved = torch.where(usable[:, None], solved, 0.0)
        leaves = [d.detach().requires_grad_(need) for d, need in zip(data, needed, strict=True)]
        with torch.enable_grad():
            problem = Problem.of(ctx.problem.objective, ctx.problem.pressure, Data(*leaves))
            gradient = problem.gradient(flat.detach().requires_grad_())[1]
            pull = -(gradient * solved).sum()
        wanted = [leaf for leaf, need in zip(leaves, needed, strict=True) if need]
        found = torch.autograd.grad(pull, wanted, materialize_grads=True) if wanted else ()
        # no number of one problem may spoil another's
        told = iter([g.masked_fill(~usable.view(-1, *[1] * (g.dim() - 1)), torch.nan) for g in found])
        return None, None, None, *(next(told) if need else None for need in needed)


def at_optimum(problem: Problem, optimum: Optimum, kind: Kind = "full") -> Flat:
    """The parameters of an optimum as `torch.autograd` sees them: a function of the problem's data.

    Derivatives are nan for a problem whose matrix is not positive. They cannot be differentiated again.
    """
    held = problem.held()
    matrix = optimum.hessian if kind == "full" else held.matrix(optimum.flat, kind)
    return _AtOptimum.apply(held, optimum.flat, matrix, *problem.data.tensors)
