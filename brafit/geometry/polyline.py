"""Polylines as arrays (NumPy): length, even spacing, distances."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def polyline_length(line: Float[np.ndarray, "k d"]) -> float:
    """Sum of the lengths of a polyline's segments."""
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def distinct(line: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "m d"]:
    """A polyline without points that repeat the one before."""
    return line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 0)]


def evenly_spaced(line: Float[np.ndarray, "k d"], count: int) -> Float[np.ndarray, "count d"]:
    """Points at equal arc length along a polyline, ends included: however densely each part was marked."""
    line = np.asarray(line, dtype=np.float64)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, column) for column in line.T], axis=1)


def distances(points: Float[np.ndarray, "n d"], line: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " n"]:
    """Distances of points from a polyline."""
    start, step = line[:-1], np.diff(line, axis=0)
    square = np.maximum((step**2).sum(axis=1), 1e-30)
    offset = points[:, None] - start
    place = ((offset * step).sum(axis=-1) / square).clip(0, 1)
    return np.linalg.norm(offset - place[..., None] * step, axis=-1).min(axis=1)
