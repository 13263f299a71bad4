"""The grain line: along the grain of the cloth or, where it stretches, along its greatest stretch."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Polygon

from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Hole, Side

_CLEAR = (4.0, 2.0, 0.0)
"""Distances in mm that the line keeps from sewing lines, the first that leaves it long enough."""
_SHORT = 20.0
"""A line in mm shorter than this is hard to lay along the grain."""


def grain_angle(options: PatternOptions, side: Side) -> float:
    """Its direction on the drawn piece, in degrees from +x; the pieces of the two sides are mirror images."""
    return options.grain if side == "left" else 180.0 - options.grain


def grain_name(options: PatternOptions) -> str:
    """What the line is called."""
    return "greatest stretch" if options.by_stretch else "grain line"


def grain_line(inside: Polygon, angle: float, holes: Sequence[Hole]) -> Float[ndarray, "2 2"]:
    """Along the grain, off the middle of the piece so that the label has room; four fifths of what fits there.

    It keeps clear of the sewing lines, less so only on a piece that is too narrow.
    """
    along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
    best = np.stack((np.asarray(inside.exterior.coords)[0],) * 2)
    for clear in _CLEAR:
        line = _longest_line(inside, along, clear, holes)
        if line is not None:
            best = line
            if np.linalg.norm(line[1] - line[0]) >= _SHORT:
                break
    return best


def _longest_line(
    inside: Polygon, along: Float[ndarray, "2"], clear: float, holes: Sequence[Hole]
) -> Float[ndarray, "2 2"] | None:
    """The line that keeps `clear` from the sewing lines; None where there is none."""
    across = np.array((-along[1], along[0]))
    outline = np.asarray(inside.exterior.coords)
    low, high = (outline @ across).min(), (outline @ across).max()
    reach = np.array(((outline @ along).min(), (outline @ along).max()))[:, None] * along
    room = inside.buffer(-clear)
    best, best_length = None, 0.0
    for share in (0.25, 0.75, 0.32, 0.68, 0.5):
        level = low + share * (high - low)
        if any(abs(hole.point @ across - level) < 6 for hole in holes):
            continue
        chord = max(
            shapely.get_parts(room.intersection(LineString(reach + level * across))), key=shapely.length, default=None
        )
        if chord is not None and chord.length > 1.15 * best_length:
            middle, half = np.asarray(chord.coords).mean(0), min(0.8 * chord.length, 150.0) / 2
            best, best_length = np.stack((middle - half * along, middle + half * along)), chord.length
    return best


def too_wide(outline: Float[ndarray, "n 2"], options: PatternOptions, side: Side) -> str:
    """What to say if the piece does not fit the cloth: its grain line along the selvedge; cloth that stretches may lie
    either way."""
    angle = math.radians(grain_angle(options, side))
    ways = [np.array((-math.sin(angle), math.cos(angle)))]
    ways += [np.array((math.cos(angle), math.sin(angle)))] * options.by_stretch
    across = min(float(np.ptp(outline @ way)) for way in ways)
    limit = options.material_width
    return f"{across:.0f} mm across the grain, wider than the material ({limit:.0f} mm)" if across > limit else ""
