"""The k cups of a population that serve all of it best (k-medoids), for k = 1, 2, ...

From a start a size is swapped for another cup until no swap helps (PAM; all swaps with one candidate are judged
together, as in FastPAM of Schubert and Rousseeuw 2021, and a block's best swap is made at once). A round over all n
candidates takes O(n^2) operations, whatever k. For each k there are two starts, and the better end counts: the best
k - 1 cups with the one that helps most beside them, so that the served error cannot rise with k; and the best of
STARTS drawn at random (far ones rather than near ones, k-means++) once they are improved by swaps within a SAMPLE
(CLARA). What is drawn is the same every time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

Distances = Float[ndarray, "n n"]
BLOCK = 256
"""Candidates that are judged together: bounds the memory."""
STARTS = 8
SAMPLE = 800
"""Starts drawn at random, and the items among which they are improved."""
ROUNDS = 100
"""Over all candidates, for each k, at most."""
_GAIN = 1e-9
"""Of the mean error, relative: what is less counts as none."""


def nested_medoids(
    distances: Distances, most: int, tell: Callable[[int], object] | None = None
) -> list[Int[ndarray, " _"]]:
    """For each k up to `most` the indices of the k medoids: items whose sum of distances to all items, each taken from
    the nearest medoid, no swap of a medoid for another item makes less.

    Args:
        distances: symmetric.
        most: largest k; not above the number of items.
        tell: called with each k that is done.

    Raises:
        ValueError: `most` is below 1 or above the number of items.
    """
    if not 1 <= most <= len(distances):
        raise ValueError(f"{most} medoids of {len(distances)} items")
    random = np.random.default_rng(0)
    sample = np.sort(random.choice(len(distances), min(SAMPLE, len(distances)), replace=False))
    some = distances[np.ix_(sample, sample)]
    total = partial(_total, distances)
    nearest = np.full(len(distances), np.inf)
    found: list[Int[ndarray, " _"]] = []
    for k in range(1, most + 1):
        before = found[-1] if found else np.zeros(0, int)
        starts = [np.append(before, _helps_most(distances, nearest, before))]
        if 1 < k <= len(sample):
            drawn = [sample[_swapped(some, _drawn(some, k, random))] for _ in range(STARTS)]
            starts.append(min(drawn, key=total))
        found.append(min((_swapped(distances, start) for start in starts), key=total))
        nearest = distances[found[-1]].min(0).astype(np.float64)
        if tell is not None:
            tell(k)
    return found


def medoid(distances: Distances, members: Int[ndarray, " m"]) -> int:
    """The member with the least sum of distances to the others."""
    sums = [
        distances[members[k : k + BLOCK]][:, members].sum(1, dtype=np.float64) for k in range(0, len(members), BLOCK)
    ]
    return int(members[np.concatenate(sums).argmin()])


def _total(distances: Distances, medoids: Int[ndarray, " k"]) -> float:
    return float(distances[medoids].min(0).sum(dtype=np.float64))


def _drawn(distances: Distances, count: int, random: np.random.Generator) -> Int[ndarray, " k"]:
    """Different items at random, each likelier the farther it is from those before it."""
    chosen = [int(random.integers(len(distances)))]
    while len(chosen) < count:
        chance = distances[chosen].min(0).astype(np.float64) ** 2
        chance[chosen] = 0.0
        if chance.sum() == 0:  # all others lie on those that are chosen
            chance = np.where(np.isin(np.arange(len(chance)), chosen), 0.0, 1.0)
        chosen.append(int(random.choice(len(chance), p=chance / chance.sum())))
    return np.array(chosen)


def _helps_most(distances: Distances, nearest: Float[ndarray, " n"], chosen: Int[ndarray, " k"]) -> int:
    """The item that makes the sum of the distances to the nearest least."""
    n = len(distances)
    sums = np.concatenate(
        [np.minimum(distances[k : k + BLOCK], nearest).sum(1, dtype=np.float64) for k in range(0, n, BLOCK)]
    )
    sums[chosen] = np.inf
    return int(sums.argmin())


def _swapped(distances: Distances, chosen: Int[ndarray, " k"]) -> Int[ndarray, " k"]:
    """The medoids after all swaps that help."""
    n, current = len(distances), chosen.copy()
    least = _GAIN * _total(distances, current) + 1e-12
    for _ in range(ROUNDS):
        improved = False
        for k in range(0, n, BLOCK):
            candidates = np.arange(k, min(k + BLOCK, n))
            change = _changes(distances, current, candidates)
            change[np.isin(candidates, current)] = np.inf
            candidate, place = np.unravel_index(change.argmin(), change.shape)
            if change[candidate, place] < -least:
                current[place] = candidates[candidate]
                improved = True
        if not improved:
            break
    return current


def _changes(
    distances: Distances, current: Int[ndarray, " k"], candidates: Int[ndarray, " c"]
) -> Float[ndarray, "c k"]:
    """By how much the sum of the distances changes if a candidate takes the place of a medoid."""
    own = distances[current]
    order = np.argsort(own, axis=0, kind="stable")
    first = np.take_along_axis(own, order[:1], axis=0)[0]
    second = np.take_along_axis(own, order[1:2], axis=0)[0] if len(current) > 1 else np.full_like(first, np.inf)
    belongs = (order[0][:, None] == np.arange(len(current))).astype(np.float64)  # (n, k)
    to = distances[candidates]
    gain = np.minimum(to - first, 0.0).sum(1, dtype=np.float64)
    if len(current) == 1:  # nobody stays with a medoid that is gone
        return (to - first).sum(1, dtype=np.float64)[:, None]
    # what each item loses beyond that if its own medoid goes: it takes the candidate or its second nearest
    loss = np.minimum(to, second) - np.minimum(to, first)
    return gain[:, None] + loss @ belongs
