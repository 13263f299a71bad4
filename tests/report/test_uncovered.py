"""The share of a cup without data, against looking at every place of it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from lunes import lune_cup
from scipy.spatial.distance import cdist

from brafit.cup.shape import CupShape
from brafit.report.uncovered import uncovered_share


def places_of(shape: CupShape) -> tuple[np.ndarray, np.ndarray]:
    """Middles of 40 by n - 1 parts of every panel, and their areas."""
    places, areas = [], []
    for lower, upper in itertools.pairwise(shape.edges.numpy()):
        for k in range(40):
            share = (k + 0.5) / 40
            line = (1 - share) * lower + share * upper
            places.append((line[1:] + line[:-1]) / 2)
            across = (upper[1:] + upper[:-1] - lower[1:] - lower[:-1]) / 2
            areas.append(np.linalg.norm(np.cross(np.diff(line, axis=0), across), axis=1))
    return np.concatenate(places), np.concatenate(areas)


@pytest.mark.parametrize("stations", [201, 98, 3])
@pytest.mark.parametrize("reach", [0.5, 5.0, 30.0])
def test_share_is_that_of_all_places(stations, reach):
    shape = lune_cup(2, n=stations)
    places, areas = places_of(shape)
    random = np.random.default_rng(0)
    points = places[random.permutation(len(places))[:300]]
    points = points[points[:, 0] > np.median(places[:, 0])] + random.normal(0, 0.1, 3)  # half of the cup has none
    away = cdist(places, points).min(axis=1)
    expected = areas[away >= reach].sum() / areas.sum()
    assert 0 < expected < 1
    assert uncovered_share(shape, points, reach) == pytest.approx(expected, abs=1e-12)
