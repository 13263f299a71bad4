"""The best k of a population: known groups, all choices tried, and what must hold for every k."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from brafit.sizing.medoids import medoid, nested_medoids
from brafit.sizing.service import NEAR, sizes_for


def apart(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=-1)


def cost(distances: np.ndarray, medoids: np.ndarray) -> float:
    return float(distances[medoids].min(0).mean())


def test_groups_are_found():
    random = np.random.default_rng(0)
    middles = random.uniform(-100, 100, (5, 4))
    group = np.repeat(np.arange(5), [3, 30, 12, 40, 15])
    points = middles[group] + random.normal(size=(100, 4))
    found = nested_medoids(apart(points), 5)[-1]
    assert sorted(group[found]) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("seed", range(6))
def test_small_populations_get_the_best_there_is(seed):
    points = np.random.default_rng(seed).normal(size=(14, 2))
    distances = apart(points)
    for k, found in enumerate(nested_medoids(distances, 4), start=1):
        best = min(cost(distances, np.array(chosen)) for chosen in combinations(range(14), k))
        assert len(set(found.tolist())) == k
        assert cost(distances, found) <= best * (1 + 1e-12)


def test_no_swap_helps_and_more_serve_better():
    points = np.random.default_rng(1).normal(size=(300, 3))
    distances = apart(points).astype(np.float32)
    costs = []
    for found in nested_medoids(distances, 8):
        costs.append(cost(distances, found))
        for place in range(len(found)):
            rest = np.delete(found, place)
            others = np.minimum(distances, distances[rest].min(0) if len(rest) else np.inf).mean(1)
            assert others.min() >= costs[-1] * (1 - 1e-5)
    assert (np.diff(costs) <= 0).all()
    again = nested_medoids(distances, 8)
    assert all((a == b).all() for a, b in zip(again, nested_medoids(distances, 8), strict=True))


def test_as_many_medoids_as_items_leave_no_error():
    distances = apart(np.random.default_rng(2).normal(size=(6, 2)))
    assert cost(distances, nested_medoids(distances, 6)[-1]) == 0
    with pytest.raises(ValueError, match="7 medoids of 6"):
        nested_medoids(distances, 7)


def test_the_medoid_of_a_group_is_one_of_it():
    points = np.array([[0.0], [1.0], [2.0], [2.1], [50.0]])
    assert medoid(apart(points), np.array([0, 1, 2, 4])) in (1, 2)
    assert medoid(apart(points), np.array([4])) == 4


def test_who_is_served_how_well():
    """Two wires, two depths: four sizes serve all, the wire alone tells but two apart."""
    wire = np.repeat([200.0, 200.1, 240.0, 240.1], 5)
    depth = np.tile([0.0, 30.0], 10)
    jitter = np.linspace(0, 1, 20)
    points = np.stack((wire, depth, jitter), axis=1)
    found = sizes_for(apart(points), wire + jitter / 100, ["36"] * 10 + ["40"] * 10, 4, 6)
    assert (np.diff(wire[found.medoids]) >= 0).all()
    assert found.error.max() < 1
    assert (found.second_error > 25).all()
    assert (found.second != found.size).all()
    for size in range(4):
        assert len(set(zip(wire[found.members(size)].round(-1), depth[found.members(size)], strict=True))) == 1
    best, grouped = found.steps[3].sizes.served, found.steps[3].wire_groups.served
    assert best.mean == pytest.approx(found.error.mean())
    assert best.near == 1.0
    assert grouped.mean > 10 * best.mean
    assert grouped.near == pytest.approx((apart(points)[found.steps[3].wire_groups.cup, np.arange(20)] <= NEAR).mean())
    assert found.catalogue.served.count == 2
    assert found.catalogue.served.mean > 10


def test_one_size_has_no_second():
    points = np.random.default_rng(3).normal(size=(5, 2))
    found = sizes_for(apart(points), np.arange(5.0), ["a"] * 5, 1, 5)
    assert (found.second == -1).all()
    assert np.isnan(found.second_error).all()
    assert [step.sizes.served.count for step in found.steps] == [1, 2, 3, 4, 5]


def test_every_size_is_worn_though_cups_are_the_same():
    """A scan that is in a population twice, and more sizes than there are different cups."""
    points = np.array([(0.0, 0.0), (0.0, 0.0), (9.0, 0.0), (9.0, 0.0), (9.0, 0.0)])
    found = sizes_for(apart(points), np.arange(5.0), ["a"] * 5, 4, 5)
    assert (found.size[found.medoids] == np.arange(4)).all()
    assert (found.error == 0).all()
    assert np.isfinite(found.second_error).all()
