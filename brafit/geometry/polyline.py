"""Polylines as arrays (NumPy): length, even spacing, distances, nearest places."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float, Int


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
    best, foot = np.full(len(points), np.inf), np.zeros_like(points)
    for a, b in itertools.pairwise(line):
        step = b - a
        share = np.clip((points - a) @ step / max(float(step @ step), 1e-30), 0, 1)
        place = a + share[:, None] * step
        square = ((points - place) ** 2).sum(axis=1)
        nearer = square < best
        best[nearer], foot[nearer] = square[nearer], place[nearer]
    return foot
