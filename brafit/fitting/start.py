"""Where fits start: every edge of the cup as a curve drawn on the cloud, a section by a plane through the wire's chord.

A cup that is first fitted to these curves starts near its best fit: from there the points lead most starts into the
same optimum, in a fifth of the steps that plain arcs need.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int

from brafit.cup.base import Cup
from brafit.fitting.targets import Target
from brafit.geometry.polyline import evenly_spaced

SAMPLES = 41
"""Evenly spaced points of each curve."""
_RIDGES = 2 / 3
"""The ridges divide this share of the angle between wire and upper edge evenly."""
_SPREAD = (1.0, 0.8, 1.25, 0.7, 0.9, 1.1, 1.4)
"""Where the ridges lie in the first starts, as multiples of that."""
_WIDTH, _WIDE = 0.12, 0.5
"""Angle in radians over which the cloud is averaged, and where it has holes."""
_DIRECTIONS = 31
"""Directions in which a section is measured."""
_CLOUD = 1000
"""Points of the cloud that are used, about."""


def start_cups(cup: Cup, targets: Sequence[Target], restarts: int = 1) -> Float[np.ndarray, "batch panels m 3"]:
    """Set cups to where fits start: to the first `restarts` starts of every target, target by target.

    Returns the curves, mm, that the starts were read from, see `start_curves`.

    Args:
        cup: B cups, B = targets times restarts.
        targets: the scans.
        restarts: starts per scan.

    Raises:
        ValueError: the cups are not as many as the starts.
    """
    if cup.batch != len(targets) * restarts:
        raise ValueError(f"{len(targets)} targets with {restarts} starts each need as many cups, not {cup.batch}")
    curves = np.concatenate([start_curves(target, cup.panels, restarts) for target in targets])
    angles, reaches = (torch.as_tensor(value).to(cup.stations) for value in middles(curves))
    cup.start(angles, reaches / cup.wire.scale[:, None])
    return curves


def start_curves(target: Target, panels: int, count: int) -> Float[np.ndarray, "count panels m 3"]:
    """Curves for the panels' upper edges, mm, for `count` starts of one scan.

    Seen along the wire's chord (the y axis), the cup is a profile from the wire's bottom over the apex to the upper
    edge. Each ridge is the section of the cloud at an angle about the chord between those two. The first start puts
    the ridges where breasts' cups usually have them, the next ones move them down and up, any further ones at
    random (the same for every scan). The last curve is the neckline, or the section where the cloud ends.

    Args:
        target: the scan.
        panels: of the cup.
        count: number of starts.
    """

    def polar(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.arctan2(points[..., 2], points[..., 0]), np.hypot(points[..., 0], points[..., 2])

    cloud = _Star(target)
    wire_angle, wire_reach = polar(target.wire)
    bottom = wire_angle[wire_reach.argmax()]
    if target.neckline is not None:
        line_angle, line_reach = polar(target.neckline)
        top, last = line_angle[line_reach.argmax()], target.neckline
    else:
        end = polar(target.seen)[0] if target.strap_point is None else polar(target.strap_point[None])[0]
        top = np.quantile(end, 0.98)
        last = cloud.section(top)
    random = np.random.default_rng(0)
    curves = np.empty((count, panels, SAMPLES, 3))
    for k in range(count):
        spread = _SPREAD[k] if k < len(_SPREAD) else random.uniform(0.6, 1.45)
        for i in range(panels - 1):
            share = _RIDGES * spread * (i + 1) / panels
            curves[k, i] = evenly_spaced(cloud.section(bottom + share * (top - bottom)), SAMPLES)
        curves[k, -1] = evenly_spaced(last, SAMPLES)
    return curves


def nearest_ridges(
    targets: Sequence[Target], curves: Float[np.ndarray, "scans panels m 3"]
) -> Int[np.ndarray, "scans ridges"]:
    """The ridges of cups in the order of their distance from the bust points, numbered from 1; from the lowest where
    there is no bust point.

    Args:
        targets: the scans.
        curves: of their starts, one each, see `start_curves`.
    """
    away = np.zeros((len(targets), curves.shape[1] - 1))
    for row, target in enumerate(targets):
        if target.apex is not None:
            away[row] = np.linalg.norm(curves[row, :-1] - target.apex, axis=-1).min(axis=-1)
    return 1 + np.argsort(away, axis=1, kind="stable")


def middles(curves: Float[np.ndarray, "*batch m 3"]) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch"]]:
    """Angle (radians, from +x over +z) and reach of the curves' middles about the wire's chord, for `Cup.start`."""
    middle = curves[..., curves.shape[-2] // 2, :]
    return np.arctan2(middle[..., 2], middle[..., 0]), np.hypot(middle[..., 0], middle[..., 2])


class _Star:
    """A cloud with its wire and neckline as a function of direction, seen from the middle of the wire's chord."""

    def __init__(self, target: Target):
        first, last = target.wire[0], target.wire[-1]
        self.middle, self.half = (first + last) / 2, np.linalg.norm(last - first) / 2
        lines = [target.wire] if target.neckline is None else [target.wire, target.neckline]
        some = target.seen[:: max(1, len(target.seen) // _CLOUD)]
        away = np.concatenate((some, *lines)) - self.middle
        reach = np.linalg.norm(away, axis=1)
        away, reach = away[reach > 0], reach[reach > 0]
        self.directions, self.reach = away / reach[:, None], reach

    def section(self, angle: float) -> Float[np.ndarray, "m 3"]:
        """The curve in the half-plane at this angle about the chord, from end to end of the wire."""
        turn = np.linspace(0, np.pi, _DIRECTIONS)
        direction = np.stack((np.sin(turn) * np.cos(angle), -np.cos(turn), np.sin(turn) * np.sin(angle)), axis=1)
        away = direction @ self.directions.T - 1
        weight = np.exp(away / _WIDTH**2) + 1e-12 * np.exp(away / _WIDE**2)
        reach = weight @ self.reach / weight.sum(axis=1)
        inner = np.clip(np.minimum(turn, np.pi - turn) / 0.2, 0, 1)
        inner = inner * inner * (3 - 2 * inner)
        return self.middle + (self.half * (1 - inner) + inner * reach)[:, None] * direction
