"""The neckline that a cup's upper edge is to follow: the given line made smooth, on either side of its corner.

A given neckline is mostly a cut through a triangle mesh, and an upper edge that follows it closely copies the jitter of
that cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import chebyshev

from brafit.geometry.polyline import distances, distinct, evenly_spaced, nearest_places, polyline_length
from brafit.geometry.smoothing import chord_parameter, smooth_series

STRAP_REACH = 8.0
"""The corner is at the strap point if that is nearer than this (mm) to the line, else there is none."""
DENSE = 200
"""Samples of each side."""
LEAST = 4
"""Points of a side that can be smoothed."""


@dataclass(frozen=True)
class Neckline:
    """A smooth neckline, mm.

    Attributes:
        sides: its smooth parts as dense polylines: two that meet in the corner, or one.
        smoothing: largest distance of the given points from it.
    """

    sides: tuple[Float[np.ndarray, "_ 3"], ...]
    smoothing: float

    def sampled(self, count: int) -> Float[np.ndarray, "count 3"]:
        """Points evenly spaced on each side, as many as its length asks for; the corner is one of them."""
        if len(self.sides) == 1:
            return evenly_spaced(self.sides[0], count)
        first, second = self.sides
        own = intervals(self.sides, count)
        return np.concatenate([evenly_spaced(first, own + 1), evenly_spaced(second, count - own)[1:]])


def intervals(sides: Sequence[Float[np.ndarray, "_ 3"]], count: int) -> int:
    """How many of the intervals between `count` points the first of two sides gets, by its length."""
    lengths = [polyline_length(side) for side in sides]
    return int(np.clip(round((count - 1) * lengths[0] / sum(lengths)), 1, count - 2))


def smooth_neckline(
    line: Float[np.ndarray, "k 3"], strap_point: Float[np.ndarray, "3"] | None, wave: float
) -> Neckline:
    """Smooth a neckline.

    Args:
        line: the given line, mm.
        strap_point: where it has its corner; None: nowhere.
        wave: length of the waves (mm) that lose half of their height; shorter ones vanish, much longer ones stay.
            0: the line stays as it is, with its corner brought to the strap point.
    """
    line = distinct(np.asarray(line, dtype=np.float64))
    given = line if strap_point is None else np.concatenate([line, strap_point[None]])
    parts = [given[rows] for rows in side_rows(line, strap_point)]
    sides = [side if wave == 0 or len(side) < LEAST else _smooth(side, wave) for side in parts]
    return Neckline(tuple(sides), float(distances(line, np.concatenate(sides)).max()))


def side_rows(
    line: Float[np.ndarray, "k 3"], strap_point: Float[np.ndarray, "3"] | None
) -> list[Int[np.ndarray, " _"]]:
    """The line parted at the strap point, as numbers of its points. The strap point, number k, takes the place of
    points that are next to it: an evenly sampled line cuts its corner off.

    Args:
        line: distinct points, mm.
        strap_point: where the line is parted; None: nowhere.
    """
    every = np.arange(len(line))
    if strap_point is None or len(line) < 3:
        return [every]
    (k,), (share,), (away,) = nearest_places(strap_point[None], line)
    inner = 0 < k + share < len(line) - 1
    if away > STRAP_REACH or not inner:
        return [every]
    near = np.linalg.norm(line - strap_point, axis=1) < 0.5 * np.linalg.norm(line[k + 1] - line[k])
    near[[0, -1]] = False
    first, second = every[: k + 1][~near[: k + 1]], every[k + 1 :][~near[k + 1 :]]
    return [np.append(first, len(line)), np.append(len(line), second)]


def _smooth(line: Float[np.ndarray, "k 3"], wave: float) -> Float[np.ndarray, "m 3"]:
    x, chords = chord_parameter(line)
    length = chords.sum()
    series = smooth_series(x, line * (np.pi / length), chords, (wave / (2 * length)) ** 6)
    return chebyshev.chebval(np.linspace(-1, 1, DENSE), series).T * (length / np.pi)
