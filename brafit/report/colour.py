"""Colours of signed distances, the same for every scan: blue inside the cup, grey on it, red outside."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

STEPS = np.array((0.5, 1.0, 2.0, 5.0))
"""Distances in mm, inside and outside of the cup, at which the colour changes. A fit that leaves many points beyond the
last is warned of."""
DIVERGING = np.array(
    [
        (13, 60, 130), (40, 110, 190), (90, 155, 212), (150, 195, 225), (205, 203, 198), (245, 185, 150),
        (238, 135, 95), (212, 70, 55), (128, 15, 35),
    ]
)  # fmt: skip
"""RGB between the steps, from far inside to far outside. The middle is a grey that shows on white and on black."""

PANELS = np.array([(236, 219, 201), (219, 198, 184), (242, 230, 212)])
"""Cloth-like RGB of the panels, from the wire up; repeated when there are more."""


def distance_limit(distances: Float[ndarray, " n"]) -> float:
    """End of a symmetric axis in mm: a round number near the 98th percentile of the finite sizes."""
    sizes = np.abs(distances[np.isfinite(distances)])
    wanted = float(np.percentile(sizes, 98)) if len(sizes) else 0.0
    if wanted <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= wanted * (1 - 1e-9)))


def distance_colours(distances: Float[ndarray, " n"]) -> UInt8[ndarray, "n 3"]:
    """RGB of signed distances in mm, positive outside, by STEPS; NaN black."""
    place = np.searchsorted(np.concatenate((-STEPS[::-1], STEPS)), np.nan_to_num(distances))
    colours = DIVERGING[place].astype(np.uint8)
    colours[np.isnan(distances)] = 0
    return colours
