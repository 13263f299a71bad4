"""Where landmarks lie on a cup: on which edge or panel, and where along the wire."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.geometry.nearest import nearest_feet, surface_points
from brafit.pattern.piece import CupMark

BUST_POINT, MATCH_POINT = "bust point", "match point"
_SAME = 3.5
"""A bust point this near (mm) to a seam is marked on the seam."""


def marks_on(
    shape: CupShape, apex: Float[ndarray, "3"] | None = None, strap_point: Float[ndarray, "3"] | None = None
) -> list[CupMark]:
    """Marks of the apex and the strap point on a fitted cup (no batch dimension, cup frame, mm).

    The apex marks its foot on the cup, the bust point; and the place of the nearest ridge that is nearest to it, where
    the tip of the sewn cup falls, so that both pieces sewn there bear a match point. Where that is the bust point
    itself, there is but one mark. The strap point marks the upper edge.

    Args:
        shape: the cup.
        apex: the bust point; None: it is not marked.
        strap_point: where the strap is sewn on; None: it is not marked.
    """
    marks = []
    if apex is not None:
        feet = nearest_feet(_tensor(apex), shape.edges, shape.tangents, shape.stations)
        station = float(feet.interval[0]) + float(feet.tau[0])
        foot = surface_points(shape.edges, shape.tangents, shape.stations, feet)[0].detach().cpu().double().numpy()
        bust = CupMark(BUST_POINT, station, None, int(feet.panel[0]), float(feet.u[0]))
        ridges = [(*nearest_on_edge(shape, i, foot), i) for i in range(1, shape.panels)]
        away, station, edge = min(ridges, default=(np.inf, 0.0, 0))
        if away > _SAME:
            marks.append(bust)
        if ridges:
            marks.append(CupMark(MATCH_POINT if away > _SAME else BUST_POINT, station, edge))
    if strap_point is not None:
        _, station = nearest_on_edge(shape, shape.panels, strap_point)
        marks.append(CupMark("strap point", station, shape.panels))
    return marks


def deepest_point(shape: CupShape) -> Float[ndarray, "3"]:
    """The cup's point farthest from the chest, the bust point where nobody marked it."""
    edges = shape.edges.detach().cpu().double()
    share = torch.linspace(0, 1, 33, dtype=edges.dtype)[:, None, None]
    points = torch.cat([(1 - share) * a + share * b for a, b in pairwise(edges)]).reshape(-1, 3)
    return points[points[:, 2].argmax()].numpy()


def _tensor(point: Float[ndarray, "3"]) -> torch.Tensor:
    return torch.as_tensor(np.asarray(point, float))[None]


def nearest_on_edge(shape: CupShape, edge: int, point: Float[ndarray, "3"]) -> tuple[float, float]:
    """Distance from an edge, and the place on it as a real-valued index of the stations."""
    x, v = (tensor.detach().cpu().double().numpy() for tensor in (shape.edges[edge], shape.tangents[edge]))
    h = np.diff(shape.stations.cpu().double().numpy())
    k = int(np.linalg.norm(x - point, axis=1).argmin())
    best = (np.inf, float(k))
    for i in {max(k - 1, 0), min(k, len(x) - 2)}:
        low, high = 0.0, 1.0
        for _ in range(3):  # the nearest of a few places, then finer about it
            t = np.linspace(low, high, 33)[:, None]  # a cubic Hermite arc between stations, as everywhere
            arc = (2 * t**3 - 3 * t**2 + 1) * x[i] + (3 * t**2 - 2 * t**3) * x[i + 1]
            arc = arc + h[i] * ((t**3 - 2 * t**2 + t) * v[i] + (t**3 - t**2) * v[i + 1])
            away = np.linalg.norm(arc - point, axis=1)
            j = int(away.argmin())
            best = min(best, (float(away[j]), i + float(t[j, 0])))
            low, high = float(t[max(j - 1, 0), 0]), float(t[min(j + 1, 32), 0])
    return best
