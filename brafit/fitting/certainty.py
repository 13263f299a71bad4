"""How certain a fitted cup is: how far another scan of the same breast would move it.

Each point pulls at the parameters with f = 2 w r J: its weight, residual, and the residual's derivatives. At the
optimum the pulls and the conditions balance. Points of another scan pull a little differently, by noise and by where
they happen to lie, which moves the parameters by H^-1 times the change of the sum, so that their covariance is C =
H^-1 M H^-1: H the Gauss-Newton matrix of the whole objective, M the covariance of the sum of the pulls. This is (73) of
docs/formulation.md.

Residuals are not all noise. What is smooth over the surface is how far a cup of few panels is from a breast; the next
scan shows the same. So M counts only by how much each pull differs from the mean of its neighbours', and takes these
differences to be independent. Errors that a scanner makes over whole regions are not seen.

The covariance is handed on as alternatives: a few cups, each a standard deviation away along one direction of the
covariance. For anything f that is measured on a cup, the variance is the sum over the alternatives of (f(alternative) -
f(fit))^2. Alternatives on the stations of the output are made when they are asked for; `outline_spread` needs only the
nodes of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np
import torch
from jaxtyping import Bool, Complex, Float
from scipy.spatial import KDTree
from torch import Tensor

from brafit.cup.base import Cup
from brafit.cup.condition import station_weights
from brafit.cup.shape import CupShape
from brafit.cup.wire import Wire
from brafit.fitting.measure import in_millimetres
from brafit.fitting.normal import PointRows, Points, assembled, slices
from brafit.fitting.objective import Objective, Pressure
from brafit.geometry.developable import dot
from brafit.geometry.development import FlatPanel

ALTERNATIVES = 24
"""Directions of the covariance that are kept: those that move the edges most."""
_NEIGHBOURS = 6
"""Neighbours with the mean of whose pulls a point's pull is compared."""
_APART = 100.0
"""How far panels are moved apart for that, in solver units."""
_LEAF = 16
"""Points in a leaf of the tree that finds them."""
_TOGETHER = 400
"""Cups whose outlines are measured at once."""


@dataclass(frozen=True)
class Alternative:
    """A cup a standard deviation away from the fit along one direction; the attributes are those of `CupFit`."""

    shape: CupShape
    panels: list[FlatPanel]


class Alternatives(Sequence[Alternative]):
    """The alternatives of one fit, made when the first of them is asked for.

    Args:
        cup: makes the cup model from its wire.
        wire: of the fit, one wire.
        flat: the fit's parameters.
        changes: from `deviations`.
        stations: how many the fit's own shape has.
    """

    def __init__(
        self,
        cup: Callable[[Wire], Cup],
        wire: Wire,
        flat: Float[Tensor, " size"],
        changes: Float[Tensor, "count size"],
        stations: int,
    ):
        self._cup, self._wire, self._flat, self._changes, self._stations = cup, wire, flat, changes, stations

    def __len__(self) -> int:
        return len(self._changes)

    @overload
    def __getitem__(self, index: int) -> Alternative: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Alternative]: ...

    def __getitem__(self, index: int | slice) -> Alternative | Sequence[Alternative]:
        return self._made[index]

    @cached_property
    @torch.no_grad()
    def _made(self) -> tuple[Alternative, ...]:
        cup = self._cup(self._wire)
        while len(cup.stations) < self._stations:
            cup = cup.refined()
        cups = cup.select(torch.zeros(len(self), dtype=torch.long))
        shape = in_millimetres(cups.shape_of(self._flat + self._changes), self._wire.scale.item())
        flat = shape.flat()
        return tuple(
            Alternative(
                shape.map(lambda v, i=i: v[i]),
                [FlatPanel(*edges) for edges in zip(flat.lower[i], flat.upper[i], strict=True)],
            )
            for i in range(len(self))
        )


def _scatter(
    points: Float[Tensor, "n d"], values: Float[Tensor, "n k"], used: Bool[Tensor, " n"]
) -> Float[Tensor, "k k"]:
    """Covariance of a sum of values, from how each differs from the mean of its neighbours'; 0 for too few points."""
    if not bool(used.all()):
        points, values = points[used], values[used]
    if len(points) <= _NEIGHBOURS:
        return values.new_zeros(values.shape[1], values.shape[1])
    places = points.cpu().numpy()
    near = np.asarray(KDTree(places, leafsize=_LEAF).query(places, k=_NEIGHBOURS + 1)[1])
    factor = values.new_full((1, _NEIGHBOURS + 1), -1 / _NEIGHBOURS)
    factor[0, 0] = 1
    rest = torch.nn.functional.embedding_bag(
        torch.as_tensor(near, device=values.device),
        values,
        mode="sum",
        per_sample_weights=factor.expand(len(values), -1).contiguous(),
    )
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
        count: directions at most.

    Returns:
        the changes that move the edges most; not finite for a problem whose matrix is singular.
    """
    linear, targets = objective.cup.linearise(flat), objective.targets
    unasked, parts, noise = objective.unasked(linear.columns), [], []
    for problems in slices(objective):
        rows = PointRows.of(objective, linear, None, problems)
        parts.append(rows.reduced())
        for k, (order, used) in enumerate(zip(rows.order, targets.weights[problems] > 0, strict=True)):
            one = slice(k, k + 1)
            jacobian = rows.sums.part((one, slice(None))).jacobian(rows.table[one].float())[0]
            pulls = jacobian.mul_((rows.slope[k] * rows.distances[k]).to(jacobian)[:, None])
            pulls = pulls.masked_fill_(unasked[problems][k], 0.0)
            # neighbours on the same panel: from one to the next the derivatives leap
            apart = _APART * rows.feet.panel[k, :, None].to(targets.points)
            places = torch.cat((targets.points[problems][k], apart), dim=-1)[order]
            noise.append(_scatter(places, pulls, used[order]).to(flat))
    hessian = assembled(objective, flat, pressure, linear, Points.cat(parts)).matrix
    order = linear.columns.argsort()
    positions = linear.table[:, : linear.shape.edges[0, ..., 0].numel()].flatten(1, 2)[..., order]
    changes = flat.new_full((len(flat), count, flat.shape[1]), torch.nan)
    for k, (h, pulls) in enumerate(zip(hessian, noise, strict=True)):
        factor, failed = torch.linalg.cholesky_ex(h.clone())
        values, vectors = torch.linalg.eigh(pulls[order][:, order])
        root = torch.cholesky_solve(vectors * values.clamp_min(0).sqrt(), factor)
        if int(failed) or not bool(root.isfinite().all()):
            continue
        moved = positions[k].clone() @ root  # a product's rounding depends on where in memory its factors lie
        turn = torch.linalg.eigh(moved.mT @ moved).eigenvectors.flip(-1)[:, :count]
        directions = root @ turn
        changes[k] = 0.0
        changes[k, : directions.shape[1], linear.columns[order]] = directions.mT
    return changes


@torch.no_grad()
def outline_spread(
    cup: Cup, flat: Float[Tensor, "batch size"], changes: Float[Tensor, "batch count size"]
) -> Float[Tensor, " batch"]:
    """Standard deviation of the pieces' outlines where it is largest, solver units, at the nodes of the fit; not finite
    where a change makes no cup, or where there are none.

    Args:
        cup: as many cups as there are rows.
        flat: their parameters.
        changes: from `deviations`.
    """
    batch, count, size = changes.shape
    if count == 0:
        return flat.new_full((batch,), torch.nan)
    result = []
    each = max(1, _TOGETHER // max(1, count))
    for some in torch.arange(batch).split(each):
        # groups of one size: the last numbers of a tensor are rounded in another way than the others
        rows = torch.cat((some, some[-1:].expand(each - len(some))))
        shape = cup.select(rows).sketch(flat[rows])
        changed = cup.select(rows.repeat_interleave(count)).sketch((flat[rows, None] + changes[rows]).view(-1, size))
        own, others = _complex(shape.flat()), _complex(changed.flat()).unflatten(0, (len(rows), count))
        spread = _across(own, others, _flat_tangents(shape, own), station_weights(shape.stations))
        result.append(spread.flatten(1).amax(1)[: len(some)])
    return torch.cat(result)


def _flat_tangents(shape: CupShape, flat: Complex[Tensor, "*batch panels 2 n"]) -> Complex[Tensor, "*batch panels 2 n"]:
    """Tangents of the edges of panels laid flat: they make the same angle with the rulings as in space. (Differences
    between nodes are too coarse for the strap's corner.)
    """
    inner = (flat[..., 1, :] - flat[..., 0, :])[..., 1:-1]
    # at the ends rulings have no length; the next nodes are very near
    ruling = torch.cat((inner[..., :1], inner, inner[..., -1:]), dim=-1)
    ruling = ruling / ruling.abs().clamp_min(1e-9)

    def turned(tangents: Tensor) -> Tensor:
        along = dot(tangents, shape.directions)
        across = (dot(tangents, tangents) - along * along).clamp_min(0).sqrt()
        return torch.complex(along, -across) * ruling

    return torch.stack([turned(shape.tangents[..., k : k + shape.panels, :, :]) for k in (0, 1)], dim=-2)


def _across(
    own: Complex[Tensor, "*batch panels 2 n"],
    others: Complex[Tensor, "*batch count panels 2 n"],
    tangent: Complex[Tensor, "*batch panels 2 n"],
    weights: Float[Tensor, " n"],
) -> Float[Tensor, "*batch panels 2 n"]:
    """Root of the sum of squares, over other pieces, of how far their edges are off a piece's own, across them. Each is
    laid on it as a rigid motion fits best, in weighted mean.
    """

    def centred(edges: Tensor) -> Tensor:
        return edges - (edges * weights).sum((-2, -1), keepdim=True) / 2

    across = 1j * tangent / tangent.abs().clamp_min(1e-300)
    own, others = centred(own)[..., None, :, :, :], centred(others)
    turn = (weights * own * others.conj()).sum((-2, -1), keepdim=True)
    moved = others * (turn / turn.abs().clamp_min(1e-300)) - own
    return (moved * across.conj()[..., None, :, :, :]).real.square().sum(-4).sqrt()


def outline_deviation(
    panels: Sequence[FlatPanel], alternatives: Sequence[Alternative]
) -> list[tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]:
    """Standard deviation (mm) of the place of every piece's edges, across them, at the stations: for each panel of the
    lower and of the upper edge. Alternatives are laid on the fit's piece as a rigid motion fits best.

    Args:
        panels: of the fit, laid flat, mm.
        alternatives: of the same fit; none: zeros are returned.
    """
    if not alternatives:
        none = np.zeros(len(panels[0].lower))
        return [(none, none)] * len(panels)
    own, *others = (
        _complex(FlatPanel(*(torch.stack([getattr(panel, name) for panel in pieces]) for name in ("lower", "upper"))))
        for pieces in (panels, *(alternative.panels for alternative in alternatives))
    )
    even = own.real.new_full(own.shape[-1:], 1 / own.shape[-1])
    (tangent,) = torch.gradient(own, dim=-1)
    return [(lower, upper) for lower, upper in _across(own, torch.stack(others), tangent, even).numpy()]


def _complex(flat: FlatPanel) -> Complex[Tensor, "*batch panels 2 n"]:
    """Both edges of panels as complex numbers."""
    return torch.view_as_complex(torch.stack((flat.lower, flat.upper), dim=-3).contiguous())
