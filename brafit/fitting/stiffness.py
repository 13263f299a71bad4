"""How stiffly an objective holds its optimum against changes as large as noise makes: the Gauss-Newton matrix and what
it lacks.

*Creases.* A point below a ridge is about as near to one panel as to the other. Where its nearest point leaps from one
to the other, the lesser of the two distances has a kink, which no derivative sees. On average over many points such
kinks bend the objective down: the deeper points lie below a ridge, the softer is the ridge. That is (78) of
docs/formulation.md.

*Bends.* What else the Gauss-Newton matrix leaves out is smooth: how the residuals, and the directions that they are
measured in, bend. It counts where residuals are large, or little else holds the cup. It is taken from differences of
the gradient, the nearest points followed, along the few directions in which the cup is least certain: (79).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from brafit.cup.base import Linearised
from brafit.fitting.normal import assembled, normal_equations, points_of
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.pulls import Pulls
from brafit.fitting.targets import PADDED
from brafit.geometry.nearest import project
from brafit.geometry.panels import Feet, Sums
from brafit.geometry.products import bmm

Matrix = Float[Tensor, "size size"]
Some = Float[Tensor, "size few"]
PATCHES = 400
"""Patches of each cloud whose pulls tell how the gradient bends."""
_STEP = 0.3
"""How far the differences of the gradient reach, in standard deviations."""
_STEEPEST = 6.0
"""A point farther from a ridge than so many times its depth in the cup is near no crease."""
_SOFTEST = 0.25
"""Least share of the Gauss-Newton matrix's stiffness that is believed. Where less is left, the cup moves farther than a
model of second order reaches."""


def creases(group: Sequence[Pulls]) -> list[Float[Tensor, "columns columns"]]:
    """What the leaps of nearest points from panel to panel add to the Hessians of some problems, columns as in
    `Linearised`.
    """
    matrices = [one.jacobian.new_zeros(one.jacobian.shape[1], one.jacobian.shape[1]) for one in group]
    panels = len(group[0].edges) - 1 if group else 0
    for own, other in [pair for ridge in range(1, panels) for pair in ((ridge - 1, ridge), (ridge, ridge - 1))]:
        near = [_below(one, own, other) for one in group]
        if not any(map(len, near)):
            continue
        for k, (feet, directions, distances) in enumerate(_second_feet(group, near, other)):
            if len(near[k]):
                matrices[k] += _crease(group[k], near[k], feet, directions, distances)
    return matrices


def _below(pulls: Pulls, own: int, other: int) -> Int[Tensor, " some"]:
    """Numbers of a panel's points that may have a second foot in the panel beside it."""
    first, end = (int((pulls.feet.panel < panel).sum()) for panel in (own, own + 1))
    feet = pulls.feet.at(slice(first, end))
    ruling = (pulls.edges[own + 1] - pulls.edges[own]).norm(dim=-1)
    away = (feet.u - float(other > own)).abs() * ruling[feet.interval]
    close = away < _STEEPEST * pulls.distances[first:end].abs()
    return first + (_inside(feet) & close).nonzero()[:, 0]


def _second_feet(
    group: Sequence[Pulls], near: Sequence[Tensor], other: int
) -> Iterator[tuple[Feet, Float[Tensor, "some 3"], Float[Tensor, " some"]]]:
    """Feet of some points of each problem in one panel, directions and distances."""
    points = pad_sequence([one.points[some] for one, some in zip(group, near, strict=True)], batch_first=True)
    # so that no rounding depends on the batch
    points = torch.nn.functional.pad(points, (0, 0, 0, -points.shape[1] % PADDED))
    both = slice(other, other + 2)
    edges, tangents = (torch.stack([getattr(one, name)[both] for one in group]) for name in ("edges", "tangents"))
    found = project(points, edges, tangents, group[0].stations)
    for k, some in enumerate(near):
        feet = found.feet.at((k, slice(0, len(some))))
        feet = Feet(feet.panel + other, feet.interval, feet.tau, feet.u)
        yield feet, found.directions[k, : len(some)], found.distances[k, : len(some)]


def _crease(
    pulls: Pulls,
    near: Int[Tensor, " some"],
    feet: Feet,
    directions: Float[Tensor, "some 3"],
    there: Float[Tensor, " some"],
) -> Float[Tensor, "columns columns"]:
    """The share of some points with a second foot in the panel beside their own.

    The density of points over the difference d of their squared distances is needed at d = 0. It is taken from all of
    them whose two feet both lie inside the panels: a strip, whose width is known.

    Args:
        pulls: of the problem.
        near: numbers of the points.
        feet: second feet.
        directions: unit vectors along which `there` is measured.
        there: distances from the second feet.
    """
    here, own = pulls.distances[near], pulls.directions[near]
    # of d in space, and the sine of half the angle between the panels
    steep = 2 * (there[:, None] * directions - here[:, None] * own).norm(dim=-1)
    sine = 0.5 * (own - directions).norm(dim=-1)
    strip = 0.5 * (here.abs() + there.abs()) * sine / (1 - sine.square()).clamp_min(0.1)
    off = (there.square() - here.square()) / steep.clamp_min(1e-30)
    used = _inside(feet) & (there * here > 0) & (off < strip) & (sine > 1e-6)
    density = torch.where(used, 0.5 / (strip * steep).clamp_min(1e-30), 0.0)
    sums = Sums.of(directions, feet, pulls.stations, len(pulls.edges))
    gradient = 2 * (there[:, None] * sums.jacobian(pulls.table) - here[:, None] * pulls.jacobian[near])
    gradient, weight = gradient.to(pulls.jacobian), (0.5 * pulls.slope[near] * density).to(pulls.jacobian)
    return -gradient.mT @ (gradient * weight[:, None])


def _inside(feet: Feet) -> Bool[Tensor, " some"]:
    return (feet.u > 0) & (feet.u < 1)


def bends(
    objective: Objective,
    flat: Float[Tensor, "batch size"],
    pressure: Pressure,
    linear: Linearised,
    directions: Float[Tensor, "batch size few"],
) -> Float[Tensor, "batch size few"]:
    """What the Gauss-Newton matrices lack of the smooth Hessians, times directions.

    Args:
        objective: the problems.
        flat: their parameters.
        pressure: weights of constraints, barrier and neckline.
        linear: the cups at `flat` and their derivatives.
        directions: changes of the parameters, each by a standard deviation.
    """
    thin = objective.thinned(PATCHES)
    here = assembled(thin, flat, pressure, linear, points_of(thin, linear))
    result = []
    for change in directions.unbind(-1):
        there = normal_equations(thin, flat + _STEP * change, pressure, near=here.feet)
        result.append((there.gradient - here.gradient) / _STEP - bmm(here.matrix, change[..., None])[..., 0])
    return torch.stack(result, dim=-1)


def spanned(matrix: Matrix, directions: Some, products: Some) -> Matrix:
    """The least symmetric matrix, as `matrix` measures it, that has these products with the directions."""
    own = matrix @ directions
    dual = own @ torch.linalg.inv(directions.mT @ own)
    inner = directions.mT @ products
    outer = products @ dual.mT
    return outer + outer.mT - dual @ (0.5 * (inner + inner.mT)) @ dual.mT


def softened(factor: Matrix, lacking: Matrix) -> Matrix:
    """The inverse of a matrix and what it lacks. No direction keeps less than _SOFTEST of the matrix's stiffness.

    Args:
        factor: of the matrix, by Cholesky.
        lacking: symmetric.
    """
    half = torch.linalg.solve_triangular(factor, lacking, upper=False)
    half = torch.linalg.solve_triangular(factor, half.mT, upper=False)
    values, vectors = torch.linalg.eigh(0.5 * (half + half.mT))
    root = torch.linalg.solve_triangular(factor.mT, vectors, upper=True)
    return root / (1 + values).clamp_min(_SOFTEST) @ root.mT
