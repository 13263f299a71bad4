"""Where landmarks lie on a cup: on which edge or panel, and where along the wire."""

from __future__ import annotations

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

    The apex marks its foot on the cup, the bust point; and the place of the nearest ridge that is nearest to it, so
    that both pieces sewn there bear a match point, which may be far from the tip of the cup. Where that is the bust
    point itself, there is but one mark. The strap point marks the upper edge.

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


def _tensor(point: Float[ndarray, "3"]) -> torch.Tensor:
    return torch.as_tensor(np.asarray(point, float))[None]


def nearest_on_edge(shape: CupShape, edge: int, point: Float[ndarray, "3"]) -> tuple[float, float]:
    """Distance from an edge, and the place on it as a real-valued index of the stations."""
    x, v = (tensor.detach().cpu().double().numpy() for tensor in (shape.edges[edge], shape.tangents[edge]))
    away, station = nearest_on_curves(x[None], v[None], shape.stations.cpu().double().numpy(), point[None])
    return float(away[0]), float(station[0])


def nearest_on_curves(
    x: Float[ndarray, "curves n 3"],
    v: Float[ndarray, "curves n 3"],
    stations: Float[ndarray, " n"],
    point: Float[ndarray, "#curves 3"],
) -> tuple[Float[ndarray, " curves"], Float[ndarray, " curves"]]:
    """Distances of points from curves, and the places on them as real-valued indices of the stations.

    Args:
        x: samples of the curves.
        v: the derivatives there by the station.
        stations: of the samples.
        point: of each curve, or of all; anywhere.
    """
    rows, last = np.arange(len(x))[:, None], x.shape[1] - 2
    k = np.linalg.norm(x - point[:, None], axis=2).argmin(1)
    i = np.stack((np.maximum(k - 1, 0), np.minimum(k, last)), axis=1)  # the arcs on both sides of the nearest sample
    h = np.diff(stations)[i][..., None, None]
    start, end, slope, goal = (
        values[:, :, None] for values in (x[rows, i], x[rows, i + 1], v[rows, i], v[rows, i + 1])
    )
    low, high = np.zeros(i.shape), np.ones(i.shape)
    best, place = np.full(i.shape, np.inf), np.zeros(i.shape)
    for _ in range(3):  # the nearest of a few places, then finer about it
        at = np.linspace(low, high, 33, axis=-1)
        t = at[..., None]  # a cubic Hermite arc between stations, as everywhere
        arc = (2 * t**3 - 3 * t**2 + 1) * start + (3 * t**2 - 2 * t**3) * end
        arc = arc + h * ((t**3 - 2 * t**2 + t) * slope + (t**3 - t**2) * goal)
        away = np.linalg.norm(arc - point[:, None, None], axis=3)
        j = away.argmin(2)[..., None]
        found, where = np.take_along_axis(away, j, 2)[..., 0], i + np.take_along_axis(at, j, 2)[..., 0]
        nearer = found < best
        best, place = np.where(nearer, found, best), np.where(nearer, where, place)
        low, high = (np.take_along_axis(at, np.clip(j + by, 0, 32), 2)[..., 0] for by in (-1, 1))
    side = np.argmin(best, axis=1)[:, None]
    return np.take_along_axis(best, side, 1)[:, 0], np.take_along_axis(place, side, 1)[:, 0]
