"""Cups as points at corresponding places, whatever their panels and stations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

ALONG, ACROSS = 24, 9
"""Places along the wire, and from the wire to the upper edge, at which cups are compared."""
_CHUNK = 1024


def corresponding(
    edges: Float[ndarray, "cups edges n 3"], along: int = ALONG, across: int = ACROSS
) -> Float[ndarray, "cups along across 3"]:
    """Points of cups at the same shares of the wire's length, and of the way from the wire to the upper edge.

    The way across is that of the rulings, and measured by length: so cups with different numbers of panels correspond.
    The first point across is on the wire, the last on the upper edge; the wire's ends, where all edges meet, are left
    out.

    Args:
        edges: from the wire up, at stations that are evenly spaced along the wire.
        along: places along the wire, at the middles of equal parts.
        across: places from the wire to the upper edge.
    """
    count = edges.shape[2]
    place = (np.arange(along) + 0.5) / along * (count - 1)
    first = np.minimum(place.astype(int), count - 2)
    share = (place - first)[:, None]
    ribs = (1 - share) * edges[:, :, first] + share * edges[:, :, first + 1]  # (cups, edges, along, 3)
    steps = np.linalg.norm(np.diff(ribs, axis=1), axis=-1)
    run = np.concatenate((np.zeros_like(steps[:, :1]), np.cumsum(steps, axis=1)), axis=1)
    wanted = np.linspace(0, 1, across)[:, None, None, None] * run[None, :, -1:]
    panel = (wanted >= run[None, :, 1:-1]).sum(2)[:, :, None]  # (across, cups, 1, along)
    low, high = (np.take_along_axis(run[None], panel + k, axis=2) for k in (0, 1))
    part = ((wanted - low) / np.maximum(high - low, 1e-12))[..., None]
    lower, upper = (np.take_along_axis(ribs[None], panel[..., None] + k, axis=2) for k in (0, 1))
    return np.moveaxis((lower + part * (upper - lower))[:, :, 0], 0, 2)


def point_areas(points: Float[ndarray, "cups along across 3"]) -> Float[ndarray, " places"]:
    """The share of the surface that each place stands for, on average over the cups; they add up to one."""
    total = np.zeros(points.shape[1:3])
    for k in range(0, len(points), _CHUNK):
        u, v = (np.gradient(points[k : k + _CHUNK], axis=axis) for axis in (1, 2))
        area = np.linalg.norm(np.cross(u, v), axis=-1)
        area[:, :, [0, -1]] /= 2  # the outermost ones have a surface on one side only
        total += (area / area.sum((1, 2), keepdims=True)).sum(0)
    return (total / len(points)).ravel()
