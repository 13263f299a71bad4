"""Polylines as arrays (NumPy): length, even spacing, distances, nearest places."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

_TOGETHER = 256
"""Points whose places on all segments are looked at together, few enough for the processor's cache."""


def polyline_length(line: Float[np.ndarray, "k d"]) -> float:
    """Sum of the lengths of a polyline's segments."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def running_length(line: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " k"]:
    """Length of a polyline from its start to each of its points; the first is 0."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))


def distinct(line: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "m d"]:
    """A polyline without points that repeat the one before."""
    return line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 0)]


def evenly_spaced(line: Float[np.ndarray, "k d"], count: int) -> Float[np.ndarray, "count d"]:
    """Points at equal arc length along a polyline, ends included: however densely each part was marked.

    Args:
        line: distinct or not, in any unit; no shorter than one segment.
        count: points wanted, at least 2.
    """
    line = np.asarray(line, dtype=np.float64)
    arc = running_length(line)
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, column) for column in line.T], axis=1)


def distances(points: Float[np.ndarray, "n d"], line: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " n"]:
    """Distances of points from a polyline.

    Args:
        points: in the unit of the line.
        line: corners of the polyline.
    """
    return nearest_places(points, line)[2]


def nearest_places(
    points: Float[np.ndarray, "n d"], line: Float[np.ndarray, "k d"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each point the nearest segment of a polyline, the share of it before the nearest place, and the distance.

    Args:
        points: in the unit of the line.
        line: corners of the polyline.
    """
    start, step = line[:-1], np.diff(line, axis=0)
    square = np.maximum((step**2).sum(axis=1), 1e-30)
    offset = points[:, None] - start
    place = ((offset * step).sum(axis=-1) / square).clip(0, 1)
    away = np.linalg.norm(offset - place[..., None] * step, axis=-1)
    rows, nearest = np.arange(len(points)), away.argmin(axis=1)
    return nearest, place[rows, nearest], away[rows, nearest]


def nearest_on(points: Float[np.ndarray, "n 3"], line: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n 3"]:
    """The nearest place of a polyline to each point.

    Args:
        points: in the unit of the line.
        line: corners of the polyline.
    """
    start, step, foot = line[:-1], np.diff(line, axis=0), np.empty_like(points)
    length = np.maximum([float(along @ along) for along in step], 1e-30)[:, None]
    for first in range(0, len(points), _TOGETHER):
        some = points[first : first + _TOGETHER]
        share = np.clip(((some - start[:, None]) @ step[..., None])[..., 0] / length, 0, 1)
        # component by component, which runs along memory
        places = [a[:, None] + share * along[:, None] for a, along in zip(start.T, step.T, strict=True)]
        x, y, z = (own - place for own, place in zip(some.T, places, strict=True))
        nearest = (x * x + y * y + z * z).argmin(axis=0)[None]
        foot[first : first + _TOGETHER] = np.stack([np.take_along_axis(p, nearest, axis=0)[0] for p in places], axis=1)
    return foot
