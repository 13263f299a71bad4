from __future__ import annotations

import numpy as np
import pytest
from shapely import Polygon

from brafit.pattern.allowance import Ring, cut_outlines
from brafit.pattern.curve import Curve, closed

CORNER = Curve(
    np.array(
        [
            [[14.705, -28.910], [11.406, -23.371], [7.735, -17.149], [5.219, -11.924]],
            [[5.219, -11.924], [2.527, -6.333], [1.725, -3.135], [0.900, -1.267]],
            [[0.900, -1.267], [0.651, -0.702], [0.342, -0.154], [0.000, 0.000]],
            [[0.000, 0.000], [-0.693, 0.313], [-1.442, -0.519], [-1.523, -0.597]],
            [[-1.523, -0.597], [-2.607, -1.646], [-3.597, -2.949], [-5.380, -5.061]],
            [[-5.380, -5.061], [-9.570, -10.024], [-13.599, -13.972], [-18.284, -18.494]],
            [[-18.284, -18.494], [-24.323, -24.321], [-28.903, -28.669], [-35.258, -35.488]],
        ]
    )
)
"""A strap's corner (mm) of radius 0.8: where two of its arcs meet, the parallel folds over a tenth of a millimetre."""


TOLERANCE = 0.02


@pytest.mark.parametrize("width", [4.0, 6.0])
def test_a_parallel_that_folds_by_a_hair_is_drawn_once(width):
    """Both sides of the fold draw the same bit, and a line back between them would cross the outline."""
    ring = Ring([CORNER, Curve.line(CORNER.end, CORNER.start)], [width, width], 1.0)
    ((outline, warnings),) = cut_outlines([ring])
    assert warnings == []
    around = Polygon(closed(outline, TOLERANCE))
    assert around.is_valid
    assert around.buffer(1e-3).contains(Polygon(CORNER.polyline(TOLERANCE)).buffer(width - 0.05, quad_segs=32))


def test_cut_lines_of_sheared_corners_hold_their_allowance_and_do_not_swing_out():
    """Corners of many sizes and slants; the curves between long and short steps too."""
    random = np.random.default_rng(0)
    for _ in range(60):
        shear = np.array([[random.uniform(0.5, 1.6), random.uniform(-0.8, 0.8)], [0.0, random.uniform(0.5, 1.6)]])
        width = float(random.choice([4.0, 6.0, 10.0, 15.0]))
        curve = CORNER.map(lambda points, shear=shear: points @ shear)
        ring = Ring([curve, Curve.line(curve.end, curve.start)], [width, width], 1.0)
        ((outline, _),) = cut_outlines([ring])
        around = Polygon(closed(outline, TOLERANCE))
        inner = Polygon(curve.polyline(TOLERANCE)).buffer(0)
        assert around.is_valid, shear
        assert around.buffer(0.02).contains(inner.buffer(width - 0.05, quad_segs=32)), shear
        assert inner.buffer(3 * width).contains(around), shear
