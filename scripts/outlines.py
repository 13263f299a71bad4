"""How far the outlines of cut patterns are apart."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from scipy.spatial import KDTree

from brafit.geometry.development import FlatPanel
from brafit.geometry.polyline import evenly_spaced
from brafit.geometry.rigid import laid_on


class Laid(Protocol):
    """A cut pattern: a fit, or anything else that has flat panels."""

    @property
    def panels(self) -> list[FlatPanel]: ...


def patterns_apart(one: Laid, other: Laid) -> float:
    """Largest distance (mm) of the outlines of the flat panels, each laid on the other as a rigid motion fits best.

    Edges are compared as curves: two cups with the same outlines can number their rulings differently.
    """
    worst = 0.0
    for a, b in zip(one.panels, other.panels, strict=True):
        p, q = ([evenly_spaced(_in_space(edge), 1000) for edge in (panel.lower, panel.upper)] for panel in (a, b))
        moved = np.split(laid_on(np.concatenate(p), np.concatenate(q)), 2)
        for mine, its in zip(moved, q, strict=True):
            away = (_to_polyline(mine, its), _to_polyline(its, mine))
            worst = max(worst, *(float(distance.max()) for distance in away))
    return worst


def _in_space(edge: torch.Tensor) -> np.ndarray:
    return np.pad(edge.numpy(), ((0, 0), (0, 1)))


def _to_polyline(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distances from a line's segments."""
    near = KDTree(line).query(points)[1]
    best = np.full(len(points), np.inf)
    for shift in (-1, 0):
        a = line[np.clip(near + shift, 0, len(line) - 2)]
        step = line[np.clip(near + shift, 0, len(line) - 2) + 1] - a
        share = np.clip(((points - a) * step).sum(axis=1) / (step**2).sum(axis=1), 0, 1)
        best = np.minimum(best, np.linalg.norm(a + share[:, None] * step - points, axis=1))
    return best
