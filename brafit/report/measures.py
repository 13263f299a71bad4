"""Measures over the surface of a cup, as bra makers take them with a tape.

A tape that is held upright or level lies in a plane: its path is the plane's section of the cup. A tape laid taut
between two points lies along the shortest way over the cup, a geodesic; flat panels show it as a straight line wherever
it does not meet an edge. Down is the wire's down: in the wire's plane, at right angles to the line between its ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import minimize

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel
from brafit.geometry.nearest import Feet, nearest_feet, surface_points
from brafit.geometry.polyline import polyline_length
from brafit.pattern.marks import nearest_on_curves
from brafit.report.sections import sections

WIRE, DOWN, UP = "wire line", "apex straight down to the wire", "upper cup depth (apex straight up)"
VERTICAL, HORIZONTAL = "vertical over the apex", "horizontal over the apex"
NECKLINE, UNDERARM, UPPER = (
    "neckline (inner end to strap point)",
    "underarm edge (strap point to outer end)",
    "neckline",
)
STRAP = "strap point to apex"
_STRIPS = 4
"""Rows of triangles across a panel, for sections: the rulings are straight."""
_X, _Y = 0, 1


class Fitted(Protocol):
    """A cup and its flat panels: a fit or one of its alternatives."""

    @property
    def shape(self) -> CupShape: ...

    @property
    def panels(self) -> Sequence[FlatPanel]: ...


@dataclass(frozen=True)
class Place:
    """A place on a cup: its panel, the station as a real-valued index, and the share of the ruling from below."""

    panel: int
    station: float
    share: float


def over_surface(
    cups: Sequence[Fitted], apex: Float[ndarray, "3"], strap_point: Float[ndarray, "3"] | None = None
) -> dict[str, Float[ndarray, " cups"]]:
    """Measures of cups with as many panels and stations each, mm; nan where a section does not leave the cup.

    Args:
        cups: cup frame, mm, no batch dimension.
        apex: bust point; the measures begin at the cup's nearest point.
        strap_point: where the strap is sewn on; it counts as its nearest place on the upper edge.
    """
    edges = torch.stack([cup.shape.edges.detach().cpu().double() for cup in cups])
    tangents = torch.stack([cup.shape.tangents.detach().cpu().double() for cup in cups])
    stations = cups[0].shape.stations.cpu().double()
    point = torch.as_tensor(apex, dtype=torch.float64).expand(len(cups), 1, 3)
    feet = nearest_feet(point, edges, tangents, stations)
    at = surface_points(edges, tangents, stations, feet)[:, 0].numpy()
    numbers = edges.numpy()
    # how cups differ shows on every other station as well
    grids = _grids(numbers[:, :, :: 2 if len(cups) > 1 and numbers.shape[2] % 2 else 1])
    down, up = sections(grids, at, _Y)
    level = np.add(*sections(grids, at, _X))
    wires, uppers = _along(numbers[:, 0]), _along(numbers[:, -1])
    found = {WIRE: wires[:, -1]}
    if strap_point is None:
        found[UPPER] = uppers[:, -1]
    else:
        _, straps = nearest_on_curves(numbers[:, -1], tangents[:, -1].numpy(), stations.numpy(), strap_point)
        before = np.diagonal(CubicSpline(np.arange(uppers.shape[1]), uppers, axis=1)(straps))
        found |= {NECKLINE: before, UNDERARM: uppers[:, -1] - before}
        found[STRAP] = _taut(cups, straps.tolist(), feet)
    return found | {DOWN: down, UP: up, VERTICAL: down + up, HORIZONTAL: level}


def _taut(cups: Sequence[Fitted], straps: Sequence[float], feet: Feet) -> Float[ndarray, " cups"]:
    """Of the first cup the shortest way from strap point to apex; of the others, which are nearly that cup, the way
    that crosses the ridges at the same stations: it is longer than the shortest only to second order."""
    top, ways = len(cups[0].panels) - 1, []
    for i, (flats, station) in enumerate(zip(flat_curves([cup.panels for cup in cups]), straps, strict=True)):
        way = Way.between(flats, Place(top, station, 1.0), _place(feet, i))
        alike = bool(ways) and way.end.panel == ways[0].end.panel
        ways.append(replace(way, crossings=ways[0].crossings) if alike else way.straightest().shortest())
    return np.array([way.length for way in ways])


def _place(feet: Feet, i: int) -> Place:
    station = float(feet.interval[i, 0]) + float(feet.tau[i, 0])
    return Place(int(feet.panel[i, 0]), station, float(feet.u[i, 0]))


def _along(curves: Float[ndarray, "cups n 3"]) -> Float[ndarray, "cups n"]:
    """Lengths from the first sample to each, of the smooth curves through the samples."""
    slope = CubicSpline(np.arange(curves.shape[1]), curves, axis=1).derivative()
    nodes, weights = np.polynomial.legendre.leggauss(6)
    at = np.arange(curves.shape[1] - 1)[:, None] + (nodes + 1) / 2
    steps = np.linalg.norm(slope(at), axis=-1) @ weights / 2
    return np.concatenate((np.zeros((len(curves), 1)), np.cumsum(steps, axis=1)), axis=1)


# Sections


def _grids(edges: Float[ndarray, "cups e n 3"]) -> Float[ndarray, "cups rows n 3"]:
    """Rows of points from the wire to the upper edge; neighbouring panels share a row."""
    share = np.arange(_STRIPS)[None, None, :, None, None] / _STRIPS
    rows = (1 - share) * edges[:, :-1, None] + share * edges[:, 1:, None]
    return np.concatenate((rows.reshape(len(edges), -1, *edges.shape[2:]), edges[:, -1:]), axis=1)


# The taut tape


@dataclass(frozen=True)
class Way:
    """A way over a cup from a place down to another that crosses each panel between them once.

    In a flat panel it is a straight line, bent only where it would leave the panel.

    Attributes:
        flats: the panels from that of the end to that of the start.
        crossings: stations where it crosses the ridges, from below.
    """

    flats: tuple[FlatCurves, ...]
    start: Place
    end: Place
    crossings: tuple[float, ...]

    @staticmethod
    def between(flats: Sequence[FlatCurves], start: Place, end: Place) -> Way:
        """A way whose crossings are not known yet.

        Args:
            flats: all panels of the cup.
            start: where it begins, in the same panel as its end or one above.
            end: where it ends.
        """
        return Way(tuple(flats[end.panel : start.panel + 1]), start, end, ())

    def straightest(self) -> Way:
        """The way that would be shortest if panels went on beyond their edges, through stations."""
        return replace(self, crossings=self._straight_crossings())

    def shortest(self) -> Way:
        """The way whose crossings make it shortest: a geodesic."""
        if not self.crossings:
            return self
        last = self.flats[0].lower.x[-1]
        best = minimize(
            lambda crossings: replace(self, crossings=tuple(crossings.tolist())).length,
            self.crossings,
            method="L-BFGS-B",
            bounds=[(0.0, last)] * len(self.crossings),
            options={"ftol": 1e-13},
        )
        return replace(self, crossings=tuple(best.x.tolist()))

    @cached_property
    def length(self) -> float:
        """In mm."""
        flats = self.flats
        total, reached = 0.0, (self.end.station, flats[0].at(self.end.station, self.end.share))
        for flat, above, crossing in zip(flats, flats[1:], self.crossings, strict=False):
            total += flat.way(reached, (crossing, flat.at(crossing, 1.0)))
            reached = (crossing, above.at(crossing, 0.0))
        top = flats[-1]
        return total + top.way(reached, (self.start.station, top.at(self.start.station, self.start.share)))

    def _straight_crossings(self) -> tuple[float, ...]:
        flats = self.flats
        stations = flats[0].lower.x
        low = flats[0].at(self.end.station, self.end.share)
        costs, origins = [np.linalg.norm(flats[0].upper(stations) - low, axis=1)], []
        for flat in flats[1:-1]:
            steps = np.linalg.norm(flat.lower(stations)[:, None] - flat.upper(stations), axis=2) + costs[-1][:, None]
            origins.append(steps.argmin(0))
            costs.append(steps.min(0))
        high = flats[-1].at(self.start.station, self.start.share)
        total = costs[-1] + np.linalg.norm(flats[-1].lower(stations) - high, axis=1)
        found = [int(total.argmin())]
        for origin in reversed(origins):
            found.insert(0, int(origin[found[0]]))
        return tuple(float(k) for k in found[: len(flats) - 1])


@dataclass(frozen=True)
class FlatCurves:
    """A flat panel's edges as curves by the stations' indices."""

    lower: PPoly
    upper: PPoly

    def at(self, station: float, share: float) -> Float[ndarray, "2"]:
        """The place of a point on a ruling."""
        return (1 - share) * self.lower(station) + share * self.upper(station)

    def way(self, start: tuple[float, ndarray], end: tuple[float, ndarray]) -> float:
        """Length of the shortest way between two points, given with their stations, within the panel."""
        (a, p), (b, q) = sorted((start, end), key=lambda place: place[0])
        gates = np.arange(int(np.floor(a)) + 1, int(np.ceil(b)))
        lower, upper = self.lower(gates), self.upper(gates)
        along, across = q - p, upper - lower
        turn = along[0] * across[:, 1] - along[1] * across[:, 0]
        offset = p - lower
        share = (along[0] * offset[:, 1] - along[1] * offset[:, 0]) / np.where(turn == 0, 1.0, turn)
        if ((share >= 0) & (share <= 1)).all():
            return float(np.linalg.norm(along))
        return polyline_length(pulled(p, q, lower, upper))


def flat_curves(cups: Sequence[Sequence[FlatPanel]]) -> list[list[FlatCurves]]:
    """The panels of cups, each without batch dimension and all with as many stations."""
    edges = torch.stack([torch.stack([torch.stack((panel.lower, panel.upper)) for panel in cup]) for cup in cups])
    values = edges.detach().cpu().double().numpy()
    spline = CubicSpline(np.arange(values.shape[3]), values, axis=3)

    def curve(*which: int) -> PPoly:
        return PPoly.construct_fast(spline.c[(slice(None), slice(None), *which)], spline.x)

    return [
        [FlatCurves(curve(i, j, 0), curve(i, j, 1)) for j in range(values.shape[1])] for i in range(values.shape[0])
    ]


def pulled(
    start: Float[ndarray, "2"], end: Float[ndarray, "2"], right: Float[ndarray, "k 2"], left: Float[ndarray, "k 2"]
) -> Float[ndarray, "m 2"]:
    """The shortest way through a row of gates, a string pulled taut: its corners lie on the gates' ends.

    Args:
        start: where it begins.
        end: where it ends.
        right: the gates' ends on the right of someone who walks from start to end.
        left: those on the left.
    """
    sides = {1: np.vstack((right, end)), -1: np.vstack((left, end))}
    corners, apex, k = [start], start, 0
    while k < len(right) + 1:
        bound: dict[int, ndarray] = {}
        reached = dict.fromkeys(sides, k)
        turned = 0
        for j in range(k, len(right) + 1):
            for way, ends in sides.items():
                step = ends[j] - apex
                if way in bound and way * _cross(bound[way], step) < 0:
                    continue  # the gate is wider here than the funnel
                if -way in bound and way * _cross(bound[-way], step) > 0:
                    turned = -way
                    break
                bound[way], reached[way] = step, j
            if turned:
                break
        if not turned:
            break
        k = reached[turned] + 1
        apex = sides[turned][reached[turned]]
        corners.append(apex)
    return np.vstack((*corners, end))


def _cross(a: ndarray, b: ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])
