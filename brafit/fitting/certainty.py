"""How certain a fitted cup is: how far another scan of the same breast would move it.

Each point pulls at the parameters with f = 2 w r J: its weight, residual, and the residual's derivatives. At the
optimum the pulls and the conditions balance. Points of another scan pull a little differently, by noise and by where
they happen to lie, which moves the parameters by H^-1 times the change of the sum, so that their covariance is C =
H^-1 M H^-1: H how stiffly the objective holds the cup (`brafit.fitting.stiffness`), M the covariance of the sum of the
pulls (`brafit.fitting.pulls`). This is (73) of docs/formulation.md.

Residuals are not all noise. What is smooth over the surface is how far a cup of few panels is from a breast; the next
scan shows the same. So M counts only by how much each pull differs from what its neighbours' foretell, and takes these
differences to be independent. Errors that a scanner makes over whole regions are not seen.

The covariance is handed on as alternatives: a few cups, each a standard deviation away along one direction of the
covariance. For anything f that is measured on a cup, the variance is the sum over the alternatives of (f(alternative) -
f(fit))^2. Alternatives on the stations of the output are made when they are asked for; `outline_spread` needs only the
nodes of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import Wire
from brafit.fitting.normal import PointRows, Points, assembled, slices
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.pulls import Pulls
from brafit.fitting.result import EdgeDeviations
from brafit.fitting.stiffness import bends, creases, softened, spanned
from brafit.geometry.developable import dot
from brafit.geometry.development import FlatPanel
from brafit.geometry.grid import station_weights

ALTERNATIVES = 24
"""Directions of the covariance that are kept: those that move the edges most."""
BENT = 2
"""Directions in which the bends of the objective are looked at: the least certain ones."""
_NOTHING = 1e-6
"""Share of the longest direction's length below which a direction is but rounding."""
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
    def _made(self) -> tuple[Alternative, ...]:
        shape, flat = shapes_of([self])
        scale = self._wire.scale.item()
        shape = replace(shape, stations=shape.stations * scale, tangents=shape.tangents / scale)
        return tuple(
            Alternative(
                shape.map(lambda v, i=i: v[0, i]),
                [FlatPanel(*edges) for edges in zip(flat.lower[0, i], flat.upper[0, i], strict=True)],
            )
            for i in range(len(self))
        )


@torch.no_grad()
def shapes_of(several: Sequence[Alternatives]) -> tuple[CupShape, FlatPanel]:
    """The alternatives of several fits, made at once, which takes half the time: their shapes, mm, by stations in
    solver units, and their panels laid flat, with dimensions of fits and of alternatives before all others.

    Args:
        several: of fits with one cup model, as many stations and as many alternatives each.
    """
    first = several[0]
    cup = first._cup(Wire.stack([one._wire for one in several]))
    while len(cup.stations) < first._stations:
        cup = cup.refined()
    cups = cup.select(torch.arange(len(several)).repeat_interleave(len(first)))
    shape = cups.shape_of(torch.cat([one._flat + one._changes for one in several]))
    flat, scale = shape.flat(), cups.wire.scale
    panels = (edges * scale[:, None, None, None] for edges in (flat.lower, flat.upper))

    def by_fit(values: Tensor) -> Tensor:
        return values.unflatten(0, (len(several), len(first)))

    return shape.scaled(scale).map(by_fit), FlatPanel(*map(by_fit, panels))


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
    linear = objective.cup.linearise(flat)
    order = linear.columns.argsort()
    parts, scatter, lacking = [], [], []
    for problems in slices(objective):
        rows = PointRows.of(objective, linear, None, problems)
        parts.append(rows.reduced())
        pulls = list(Pulls.each(objective, linear, rows, problems))
        scatter += [one.scatter() for one in pulls]
        lacking += creases(pulls)
    unasked = objective.unasked(linear.columns)
    held = (unasked[:, None] | unasked[..., None])[:, order][..., order]
    scatter, lacking = (
        torch.stack(matrices).to(flat)[:, order][..., order].masked_fill_(held, 0.0) for matrices in (scatter, lacking)
    )
    hessian = assembled(objective, flat, pressure, linear, Points.cat(parts)).matrix
    positions = linear.table[:, : linear.shape.edges[0, ..., 0].numel()].flatten(1, 2)[..., order]
    spreads = [_Spread.of(*own) for own in zip(hessian, scatter, positions, strict=True)]
    few = torch.stack([spread.plain(BENT) for spread in spreads])
    bent = bends(objective, flat, pressure, linear, few)
    changes = flat.new_full((len(flat), count, flat.shape[1]), torch.nan)
    for k, spread in enumerate(spreads):
        directions = spread.directions(lacking[k], few[k], bent[k], count)
        if bool(directions.isfinite().all()):
            changes[k] = 0.0
            changes[k, : directions.shape[1]] = directions.mT
    return changes


@dataclass(frozen=True)
class _Spread:
    """What the covariance of one problem's parameters is made of.

    Attributes:
        matrix, factor: the Gauss-Newton matrix, and its Cholesky factor; not finite if it is singular.
        root: of the covariance of the sum of the pulls.
        positions: derivatives of the edges' positions.
    """

    matrix: Float[Tensor, "size size"]
    factor: Float[Tensor, "size size"]
    root: Float[Tensor, "size size"]
    positions: Float[Tensor, "places size"]

    @staticmethod
    def of(matrix: Tensor, scatter: Tensor, positions: Tensor) -> _Spread:
        matrix, positions = matrix.clone(), positions.clone()  # a product's rounding depends on where its factors lie
        factor, failed = torch.linalg.cholesky_ex(matrix)
        values, vectors = torch.linalg.eigh(scatter.clone())
        root = vectors * values.clamp_min(0).sqrt()
        return _Spread(matrix, factor.masked_fill(failed != 0, torch.nan), root, positions)

    def plain(self, count: int) -> Float[Tensor, "size count"]:
        """The directions that move the edges most, if the Gauss-Newton matrix were all; 0 where it is singular."""
        found = self._turned(torch.cholesky_solve(self.root, self.factor), count)
        # of either sign the same one, so that differences along it do not depend on rounding
        sign = found.gather(0, found.abs().argmax(0, keepdim=True)).sign()
        return torch.nn.functional.pad(found * sign, (0, count - found.shape[1])).nan_to_num(0.0, 0.0, 0.0)

    def directions(
        self,
        lacking: Float[Tensor, "size size"],
        few: Float[Tensor, "size few"],
        bent: Float[Tensor, "size few"],
        count: int,
    ) -> Float[Tensor, "size count"]:
        """The directions that move the edges most, at most so many; not finite where there are none.

        Args:
            lacking: what the Gauss-Newton matrix lacks.
            few: directions.
            bent: their products with what it lacks beside that.
            count: directions at most.
        """
        used = few.norm(dim=0) > _NOTHING * few.norm(dim=0).amax()
        if bool(used.any()):
            lacking = lacking + spanned(self.matrix, few[:, used], bent[:, used])
        if not bool(lacking.isfinite().all() & self.factor.isfinite().all()):
            return torch.full_like(self.matrix, torch.nan)[:, :count]
        return self._turned(softened(self.factor, lacking) @ self.root, count)

    def _turned(self, root: Float[Tensor, "size size"], count: int) -> Float[Tensor, "size count"]:
        """A root of the covariance, its columns in the order in which they move the edges."""
        if not bool(root.isfinite().all()):
            return root[:, :count]
        moved = self.positions @ root
        return root @ torch.linalg.eigh(moved.mT @ moved).eigenvectors.flip(-1)[:, :count]


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


def outline_deviation(panels: Sequence[FlatPanel], alternatives: Sequence[Alternative]) -> list[EdgeDeviations]:
    """Standard deviation (mm) of the place of every piece's edges, across them, at the stations: for each panel of the
    lower and of the upper edge. Alternatives are laid on the fit's piece as a rigid motion fits best.

    Args:
        panels: of the fit, laid flat, mm.
        alternatives: of the same fit; none: zeros are returned.
    """
    if not alternatives:
        none = np.zeros(len(panels[0].lower))
        return [(none, none)] * len(panels)
    flat = [
        torch.stack([torch.stack((panel.lower, panel.upper)) for panel in pieces])
        for pieces in (panels, *(alternative.panels for alternative in alternatives))
    ]
    return outline_deviations(torch.stack(flat)[None])[0]


def outline_deviations(flat: Float[Tensor, "fits each panels 2 n 2"]) -> list[list[EdgeDeviations]]:
    """`outline_deviation` of several fits, for each panel of each.

    Args:
        flat: the edges of the panels of each fit's own cup, then of its alternatives, mm.
    """
    every = torch.view_as_complex(flat.contiguous())
    even = every.real.new_full(every.shape[-1:], 1 / every.shape[-1])
    (tangent,) = torch.gradient(every[:, 0], dim=-1)
    found = _across(every[:, 0], every[:, 1:], tangent, even).numpy()
    return [[(lower, upper) for lower, upper in own] for own in found]


def _complex(flat: FlatPanel) -> Complex[Tensor, "*batch panels 2 n"]:
    """Both edges of panels as complex numbers."""
    return torch.view_as_complex(torch.stack((flat.lower, flat.upper), dim=-3).contiguous())
