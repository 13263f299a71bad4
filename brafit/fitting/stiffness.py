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

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.pulls import Pulls, at
from brafit.geometry.nearest import project
from brafit.geometry.panels import Feet, Sums, surface_points
from brafit.geometry.products import bmm

Matrix = Float[Tensor, "size size"]
Some = Float[Tensor, "size few"]
PATCHES = 400
"""Patches of each cloud whose pulls tell how the gradient bends."""
_STEP = 0.3
"""How far the differences of the gradient reach, in standard deviations."""
_STEEPEST = 2.0
"""A point farther from a ridge than so many times its depth in the cup is near no crease."""
_SOFTEST = 0.25
"""Least share of the Gauss-Newton matrix's stiffness that is believed. Where less is left, the cup moves farther than a
model of second order reaches."""


def creases(pulls: Pulls) -> Float[Tensor, "columns columns"]:
    """What the leaps of nearest points from panel to panel add to a problem's Hessian, columns as in `Linearised`."""
    panels = pulls.edges.shape[0] - 1
    matrix = pulls.jacobian.new_zeros(pulls.jacobian.shape[1], pulls.jacobian.shape[1])
    for own in range(panels):
        for other in (own - 1, own + 1):
            if 0 <= other < panels:
                matrix += _crease(pulls, own, other)
    return matrix


def _crease(pulls: Pulls, own: int, other: int) -> Float[Tensor, "columns columns"]:
    """The share of the points that have their nearest point in one panel, and another foot in another.

    The density of points over the difference d of their squared distances is needed at d = 0. It is taken from all of
    them whose two feet both lie inside the panels: a strip, whose width is known.
    """
    near = _below(pulls, own, other)
    both = slice(other, other + 2)
    found = project(pulls.points[near], pulls.edges[both], pulls.tangents[both], pulls.stations)
    held = _inside(found.feet) & (found.distances * pulls.distances[near] > 0)
    near, directions, there = near[held], found.directions[held], found.distances[held]
    feet = at(found.feet, held)
    feet = Feet(feet.panel + other, feet.interval, feet.tau, feet.u)
    here = pulls.distances[near]
    # of d in space, and the sine of half the angle between the panels
    steep = 2 * (there[:, None] * directions - here[:, None] * pulls.directions[near]).norm(dim=-1)
    sine = 0.5 * (pulls.directions[near] - directions).norm(dim=-1)
    strip = 0.5 * (here.abs() + there.abs()) * sine / (1 - sine.square()).clamp_min(0.1)
    off = (there.square() - here.square()) / steep.clamp_min(1e-30)
    used = (off < strip) & (sine > 1e-6)
    density = torch.where(used, 0.5 / (strip * steep).clamp_min(1e-30), 0.0)
    sums = Sums.of(directions, feet, pulls.stations, len(pulls.edges))
    gradient = 2 * (there[:, None] * sums.jacobian(pulls.table) - here[:, None] * pulls.jacobian[near])
    weight = (0.5 * pulls.slope[near] * density).to(pulls.jacobian)
    gradient = gradient.to(pulls.jacobian)
    return -gradient.mT @ (gradient * weight[:, None])


def _below(pulls: Pulls, own: int, other: int) -> Tensor:
    """Numbers of a panel's points that may have a second foot in another panel."""
    feet = pulls.feet
    ridge = Feet(feet.panel, feet.interval, feet.tau, torch.full_like(feet.u, float(other > own)))
    foot, end = (surface_points(pulls.edges, pulls.tangents, pulls.stations, at) for at in (feet, ridge))
    close = (foot - end).norm(dim=-1) < _STEEPEST * pulls.distances.abs()
    return ((feet.panel == own) & _inside(feet) & close).nonzero()[:, 0]


def _inside(feet: Feet) -> Tensor:
    return (feet.u > 0) & (feet.u < 1)


def bends(
    objective: Objective,
    flat: Float[Tensor, "batch size"],
    pressure: Pressure,
    directions: Float[Tensor, "batch size few"],
) -> Float[Tensor, "batch size few"]:
    """What the Gauss-Newton matrices lack of the smooth Hessians, times directions.

    Args:
        objective: the problems.
        flat: their parameters.
        pressure: weights of constraints, barrier and neckline.
        directions: changes of the parameters, each by a standard deviation.
    """
    thin = objective.thinned(PATCHES)
    here = normal_equations(thin, flat, pressure)
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
