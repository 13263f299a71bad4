"""The grain line: along the grain of the cloth or, where it stretches, along its greatest stretch."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from shapely import Polygon

from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Hole


def grain_name(options: PatternOptions) -> str:
    """What the line is called."""
    return "greatest stretch" if options.stretch else "grain line"


def grain_line(inside: Polygon, angle: float, holes: Sequence[Hole]) -> Float[ndarray, "2 2"]:
    """Along the grain, off the middle of the piece so that the label has room; four fifths of what fits there."""
    along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
    across = np.array((-along[1], along[0]))
    outline = np.asarray(inside.exterior.coords)
    low, high = (outline @ across).min(), (outline @ across).max()
    best, best_length = np.stack((outline[0], outline[0] + along)), 0.0
    for share in (0.25, 0.75, 0.32, 0.68):
        level = low + share * (high - low)
        if any(abs(hole.point @ across - level) < 6 for hole in holes):
            continue
        chord = _longest_chord(outline, along, across, level)
        length = float(np.linalg.norm(chord[1] - chord[0]))
        if length > 1.15 * best_length:
            middle, half = chord.mean(0), min(0.8 * length, 150.0) / 2
            best, best_length = np.stack((middle - half * along, middle + half * along)), length
    return best


def _longest_chord(outline: ndarray, along: ndarray, across: ndarray, level: float) -> Float[ndarray, "2 2"]:
    """The longest part inside a polygon of the line at `level` across."""
    side = outline @ across - level
    i = np.nonzero((side[:-1] < 0) != (side[1:] < 0))[0]
    share = side[i] / (side[i] - side[i + 1])
    hits = np.sort((outline[i] + share[:, None] * (outline[i + 1] - outline[i])) @ along)
    pairs = hits[: len(hits) // 2 * 2].reshape(-1, 2)
    if len(pairs) == 0:
        return np.stack((level * across, level * across))
    ends = pairs[np.diff(pairs, axis=1)[:, 0].argmax()]
    return ends[:, None] * along + level * across


def too_wide(outline: Float[ndarray, "n 2"], options: PatternOptions) -> str:
    """What to say if the piece does not fit the cloth: its grain line along the selvedge; cloth that stretches may lie
    either way."""
    angle = math.radians(options.grain)
    ways = [np.array((-math.sin(angle), math.cos(angle)))]
    ways += [np.array((math.cos(angle), math.sin(angle)))] * options.stretch
    across = min(float(np.ptp(outline @ way)) for way in ways)
    limit = options.material_width
    return f"{across:.0f} mm across the grain, wider than the material ({limit:.0f} mm)" if across > limit else ""
