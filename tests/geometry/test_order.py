from __future__ import annotations

import numpy as np
from lunes import sphere_points

from brafit.geometry.order import along_curve


def test_the_curve_goes_from_cell_to_adjacent_cell_through_all_of_them():
    grid = np.stack(np.meshgrid(*[np.arange(16.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    shuffled = np.random.default_rng(0).permutation(grid)
    way = shuffled[along_curve(shuffled, bits=4)]
    assert len(np.unique(way, axis=0)) == 16**3
    assert (np.abs(np.diff(way, axis=0)).sum(axis=1) == 1).all()


def test_every_seventh_point_is_spread_more_evenly_than_a_random_draw():
    points = sphere_points(2100)[0]
    few = points[along_curve(points)][::7]
    drawn = np.random.default_rng(1).permutation(points)[:300]
    # Shares on one side of planes, against those of the whole cloud.
    planes = np.random.default_rng(2).standard_normal((200, 3))

    def uneven(sample: np.ndarray) -> float:
        share = (((sample - points.mean(axis=0)) @ planes.T) > 0).mean(axis=0)
        return float(np.std(share - ((points - points.mean(axis=0)) @ planes.T > 0).mean(axis=0)))

    assert uneven(few) < 0.5 * uneven(drawn)


def test_clouds_without_extent():
    assert len(along_curve(np.empty((0, 3)))) == 0
    assert along_curve(np.ones((3, 3))).tolist() == [0, 1, 2]
