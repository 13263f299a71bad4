"""Colours of signed distances, the same in every picture: blue inside the cup, grey on it, red outside."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

DIVERGING = np.array(
    [(13, 60, 130), (50, 125, 200), (135, 185, 220), (205, 203, 198), (240, 160, 120), (212, 80, 60), (128, 15, 35)]
)
"""RGB at equal steps from far inside to far outside. The middle is a grey that shows on white and on black."""

PANELS = np.array([(236, 219, 201), (219, 198, 184), (242, 230, 212)])
"""Cloth-like RGB of the panels, from the wire up; repeated when there are more."""


def distance_limit(distances: Float[ndarray, " n"]) -> float:
    """End of a symmetric colour scale in mm: a round number near the 98th percentile of the finite sizes."""
    sizes = np.abs(distances[np.isfinite(distances)])
    wanted = float(np.percentile(sizes, 98)) if len(sizes) else 0.0
    if wanted <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(next(step * power for step in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= wanted * (1 - 1e-9)))


def distance_colours(distances: Float[ndarray, " n"], limit: float) -> UInt8[ndarray, "n 3"]:
    """RGB of signed distances (positive outside) from -limit to limit; beyond them the ends' colours, NaN black."""
    place = np.clip(np.nan_to_num(distances) / limit, -1, 1)
    steps = np.linspace(-1, 1, len(DIVERGING))
    colours = np.stack([np.interp(place, steps, DIVERGING[:, i]) for i in range(3)], axis=-1)
    colours[np.isnan(distances)] = 0
    return np.rint(colours).astype(np.uint8)
