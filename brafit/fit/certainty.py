"""How certain a fitted cup is: how far another scan of the same breast would move it.

Each point pulls at the parameters with f = 2 w r J: its weight, residual, and the residual's derivatives. At the
optimum the pulls and the conditions balance. Points of another scan pull a little differently, by noise and by where
they happen to lie, which moves the parameters by H^-1 times the change of the sum, so that their covariance is C =
H^-1 M H^-1: H the Gauss-Newton matrix of the whole objective, M the covariance of the sum of the pulls.

Residuals are not all noise. What is smooth over the surface is how far a cup of few panels is from a breast; the next
scan shows the same. So M counts only by how much each pull differs from the mean of its neighbours', and takes these
differences to be independent. Errors that a scanner makes over whole regions are not seen.

The covariance is handed on as alternatives: a few cups, each a standard deviation away along one direction of the
covariance. For anything f that is measured on a cup, the variance is the sum over the alternatives of (f(alternative) -
f(fit))^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from brafit.cup.shape import CupShape
from brafit.fit.normal import normal_equations
from brafit.fit.objective import Objective, Pressure
from brafit.geometry.development import FlatPanel
from brafit.geometry.nearest import distance_jacobian, project

ALTERNATIVES = 24
"""Directions of the covariance that are kept: those that move the edges most."""
_NEIGHBOURS = 6
"""A point's pull is compared with the mean of so many around."""
_APART = 100.0
"""How far panels are moved apart for that, in solver units."""


@dataclass(frozen=True)
class Alternative:
    """A cup a standard deviation away from the fit along one direction; the attributes are those of `CupFit`."""

    shape: CupShape
    panels: list[FlatPanel]


def _scatter(
    points: Float[Tensor, "n d"], values: Float[Tensor, "n k"], used: Bool[Tensor, " n"]
) -> Float[Tensor, "k k"]:
    """Covariance of a sum of values, from how each differs from the mean of its neighbours'; 0 for too few points."""
    points, values = points[used], values[used]
    if len(points) <= _NEIGHBOURS:
        return values.new_zeros(values.shape[1], values.shape[1])
    near = np.asarray(KDTree(points.cpu().numpy()).query(points.cpu().numpy(), k=_NEIGHBOURS + 1)[1])[:, 1:]
    around = torch.zeros_like(values)
    for column in torch.as_tensor(near, device=values.device).unbind(-1):  # all at once, they would fill the memory
        around += values[column]
    rest = values - around / _NEIGHBOURS
    return rest.mT @ rest / (1 + 1 / _NEIGHBOURS)


@torch.no_grad()
def deviations(
    objective: Objective, flat: Float[Tensor, "batch size"], pressure: Pressure, count: int = ALTERNATIVES
) -> Float[Tensor, "batch count size"]:
    """Changes of the parameters, each a standard deviation along one direction of the covariance.

    Args:
        objective: the problems with all their points.
        flat: where they ended.
        pressure: with the weights they ended with.

    Returns:
        the changes that move the edges most; not finite for a problem whose matrix is singular.
    """
    linear, targets = objective.cup.linearise(flat), objective.targets
    shape = linear.shape
    found = project(targets.points, shape.edges, shape.tangents, shape.stations)
    jacobian = distance_jacobian(found.directions, found.feet, shape.stations, shape.edges.shape[1], linear.table)
    slope = objective.points_block(found.distances).model()[1].expand_as(found.distances)
    force = (slope * found.distances)[..., None] * jacobian
    force = force.masked_fill(objective.unasked(linear.columns)[:, None], 0.0)
    # neighbours on the same panel: from one to the next the derivatives leap
    apart = torch.cat((targets.points, _APART * found.feet.panel[..., None].to(targets.points)), dim=-1)
    noise = torch.stack([_scatter(p, f, w > 0) for p, f, w in zip(apart, force, targets.weights, strict=True)])
    order = linear.columns.argsort()
    noise = noise[:, order][:, :, order]
    positions = linear.table[:, : shape.edges[0, ..., 0].numel()].flatten(1, 2)[..., order]
    hessian = normal_equations(objective, flat, pressure).matrix
    changes = flat.new_full((len(flat), count, flat.shape[1]), torch.nan)
    columns = linear.columns[order]
    for k, (h, m, x) in enumerate(zip(hessian, noise, positions, strict=True)):
        factor, failed = torch.linalg.cholesky_ex(h)
        values, vectors = torch.linalg.eigh(m)
        root = torch.cholesky_solve(vectors * values.clamp_min(0).sqrt(), factor)
        if int(failed) or not bool(root.isfinite().all()):
            continue
        turn = torch.linalg.eigh((x @ root).mT @ (x @ root)).eigenvectors.flip(-1)[:, :count]
        own = root @ turn
        changes[k] = 0.0
        changes[k, : own.shape[1], columns] = own.mT
    return changes


def outline_deviation(
    panels: Sequence[FlatPanel], alternatives: Sequence[Alternative]
) -> list[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
    """Standard deviation (mm) of the place of every piece's edges, across them, at the stations: for each panel of the
    lower and of the upper edge. Alternatives are laid on the fit's piece as a rigid motion fits best.
    """
    result = []
    for i, panel in enumerate(panels):
        own = _complex(panel)
        tangent = np.gradient(own, axis=1)
        across = 1j * tangent / np.maximum(np.abs(tangent), 1e-300)
        square = np.zeros(own.shape)
        middle = own.mean()
        for alternative in alternatives:
            other = _complex(alternative.panels[i])
            other = other - other.mean()
            turn = np.sum((own - middle) * other.conj())
            moved = other * (turn / abs(turn)) + middle - own
            square += (moved * across.conj()).real ** 2
        lower, upper = np.sqrt(square)
        result.append((lower, upper))
    return result


def _complex(panel: FlatPanel) -> np.ndarray:
    """Both edges (2, n) as complex numbers."""
    edges = torch.stack((panel.lower, panel.upper)).numpy()
    return edges[..., 0] + 1j * edges[..., 1]
