"""Who is served how well by k sizes, and the same where the wire alone chooses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.geometry.rigid import motion_onto
from brafit.sizing.medoids import medoid, nested_medoids

Distances = Float[ndarray, "n n"]
NEAR = 3.0
"""mm: who is nearer than this to her size counts as served closely."""


@dataclass(frozen=True)
class Served:
    """How well a population is served.

    Attributes:
        count: of sizes.
        mean, p95, largest: of the members' errors, mm.
        near: share of the members whose error is at most NEAR.
    """

    count: int
    mean: float
    p95: float
    largest: float
    near: float

    @staticmethod
    def of(errors: Float[ndarray, " n"], count: int) -> Served:
        """Of each member's error, mm, with so many sizes."""
        errors = np.asarray(errors, np.float64)
        p95 = float(np.percentile(errors, 95))
        return Served(count, float(errors.mean()), p95, float(errors.max()), float((errors <= NEAR).mean()))


@dataclass(frozen=True)
class Choice:
    """Which member's cup each member wears, and how well that serves."""

    cup: Int[ndarray, " n"]
    served: Served


@dataclass(frozen=True)
class Step:
    """The same number of sizes chosen in three ways.

    Attributes:
        sizes: the cups that serve best, each member wears the one that is best for her.
        by_wire: the same cups, each member wears the one whose wire is nearest in length to hers.
        wire_groups: members in groups of like wire length, equally many in each, served by the best cup of the group.
    """

    sizes: Choice
    by_wire: Choice
    wire_groups: Choice


@dataclass(frozen=True)
class Sizes:
    """Sizes for a population of n.

    Attributes:
        medoids: of each size the member whose cup it is, the shortest wire first.
        size: of each member the place of her size in `medoids`.
        error: of each member the distance from her size, mm.
        second, second_error: the same of the size that is next best for her; -1 and nan where there is one size only.
        steps: for k = 1, 2, ... sizes.
        catalogue: groups of the same nearest wire that is sold, each served by the best cup of its group.
    """

    medoids: Int[ndarray, " k"]
    size: Int[ndarray, " n"]
    error: Float[ndarray, " n"]
    second: Int[ndarray, " n"]
    second_error: Float[ndarray, " n"]
    steps: tuple[Step, ...]
    catalogue: Choice

    def members(self, size: int) -> Int[ndarray, " m"]:
        """Who wears a size."""
        return np.flatnonzero(self.size == size)


def sizes_for(
    distances: Distances,
    lengths: Float[ndarray, " n"],
    wires: Sequence[str],
    count: int,
    most: int,
    tell: Callable[[int], object] | None = None,
) -> Sizes:
    """The best sizes of a population, and how well they serve it.

    Args:
        distances: of all pairs of cups, mm.
        lengths: of the wires, mm.
        wires: name of the nearest wire sold of each.
        count: of sizes.
        most: how far the numbers of sizes are compared; not below `count`, nor above n.
        tell: called with each number of sizes that is done.

    Raises:
        ValueError: fewer members than sizes.
    """
    if not 1 <= count <= most:
        raise ValueError(f"{count} sizes, compared up to {most}")
    found = nested_medoids(distances, most, tell)
    order = np.argsort(lengths, kind="stable")
    medoids = found[count - 1][np.argsort(lengths[found[count - 1]], kind="stable")]
    own = distances[medoids]
    first = own.copy()
    first[np.arange(count), medoids] = -1.0  # whose cup a size is wears it, even if another size's is the same cup
    ranked = np.argsort(first, axis=0, kind="stable")
    errors = np.take_along_axis(own, ranked, axis=0).astype(np.float64)
    none = np.full(len(lengths), -1)
    return Sizes(
        medoids=medoids,
        size=ranked[0],
        error=errors[0],
        second=ranked[1] if count > 1 else none,
        second_error=errors[1] if count > 1 else np.full(len(lengths), np.nan),
        steps=tuple(_step(distances, lengths, order, chosen) for chosen in found),
        catalogue=_in_groups(distances, _by_name(wires)),
    )


def _step(
    distances: Distances, lengths: Float[ndarray, " n"], order: Int[ndarray, " n"], medoids: Int[ndarray, " k"]
) -> Step:
    best = distances[medoids].argmin(0)
    by_wire = np.abs(lengths[medoids][:, None] - lengths).argmin(0)
    return Step(
        sizes=_worn(distances, medoids[best], len(medoids)),
        by_wire=_worn(distances, medoids[by_wire], len(medoids)),
        wire_groups=_in_groups(distances, np.array_split(order, len(medoids))),
    )


def _by_name(names: Sequence[str]) -> list[Int[ndarray, " m"]]:
    _, group = np.unique(np.array(names), return_inverse=True)
    return [np.flatnonzero(group == k) for k in range(int(group.max()) + 1)]


def _in_groups(distances: Distances, groups: Sequence[Int[ndarray, " m"]]) -> Choice:
    cup = np.zeros(len(distances), int)
    for group in groups:
        cup[group] = medoid(distances, group)
    return _worn(distances, cup, len(groups))


def _worn(distances: Distances, cup: Int[ndarray, " n"], count: int) -> Choice:
    return Choice(cup, Served.of(distances[cup, np.arange(len(cup))], count))


@dataclass(frozen=True)
class Worn:
    """How a member's surface lies to the cup of her size once that is laid on: mm, and the share within NEAR."""

    rms: float
    p95: float
    near: float


def worn(
    shape: CupShape,
    aims: Float[ndarray, "places 3"],
    members: Float[ndarray, "m places 3"],
    weights: Float[ndarray, " places"],
) -> list[Worn]:
    """Distances of members' surfaces from the nearest points of one size's cup.

    Args:
        shape: the size's cup, cup frame, mm.
        aims: its points at corresponding places.
        members: those of the members' cups; each is laid on the size by the motion that brings corresponding points
            together best.
        weights: share of the surface of each place.
    """
    laid = []
    for points in members:
        turn, shift = motion_onto(points, aims, weights)
        laid.append(points @ turn + shift)
    with torch.no_grad():
        found = shape.distances(torch.from_numpy(np.concatenate(laid))).abs().numpy().reshape(len(members), -1)
    order = np.argsort(found, axis=1)
    ranked, run = np.take_along_axis(found, order, 1), np.cumsum(weights[order], axis=1)
    p95 = [float(np.interp(0.95, own, values)) for own, values in zip(run, ranked, strict=True)]
    rms, near = np.sqrt((weights * found**2).sum(1)), (weights * (found <= NEAR)).sum(1)
    return [Worn(*(float(v) for v in values)) for values in zip(rms, p95, near, strict=True)]
