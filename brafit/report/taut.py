"""The taut tape: the shortest way over a cup between two places, a geodesic; flat panels show it as a straight line
wherever it does not meet an edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import minimize

from brafit.geometry.nearest import Feet
from brafit.geometry.polyline import polyline_length
from brafit.geometry.spline import between, slopes


@dataclass(frozen=True)
class Place:
    """A place on a cup: its panel, the station as a real-valued index, and the share of the ruling from below."""

    panel: int
    station: float
    share: float


def taut_lengths(
    flat: Float[ndarray, "fits each panels 2 n 2"], straps: Float[ndarray, "fits each"], feet: Feet
) -> Float[ndarray, "fits each"]:
    """Of each fit's own cup the shortest way from strap point to apex; of the others, which are nearly that cup, the
    way that crosses the ridges at the same stations: it is longer than the shortest only to second order.

    Args:
        flat: edges of the panels of each fit's own cup, then of the others.
        straps: stations of the strap points on the upper edge.
        feet: of the apexes, one after another.
    """
    station = (feet.interval + feet.tau).numpy().reshape(straps.shape)
    panel, share = (v.numpy().reshape(straps.shape) for v in (feet.panel, feet.u))
    ends = [list(map(Place, *(v.tolist() for v in own))) for own in zip(panel, station, share, strict=True)]
    each = zip(flat, slopes(flat), straps, ends, strict=True)
    return np.stack([_lengths(*own) for own in each])


def _lengths(
    flat: Float[ndarray, "each panels 2 n 2"],
    slope: Float[ndarray, "each panels 2 n 2"],
    straps: Float[ndarray, " each"],
    ends: Sequence[Place],
) -> Float[ndarray, " each"]:
    """Of one fit; `slope`: of the edges of its panels."""

    def way(k: int) -> Way:
        return Way.between(flat_curves(flat[k]), Place(flat.shape[1] - 1, float(straps[k]), 1.0), ends[k])

    first = way(0).straightest().shortest()
    alike, part = np.array([end.panel == first.end.panel for end in ends]), slice(first.end.panel, None)
    lengths = np.full(len(ends), np.nan)
    lengths[alike] = _straight(
        flat[alike, part],
        slope[alike, part],
        first.crossings,
        straps[alike],
        np.array([(end.station, end.share) for end in ends])[alike],
    )
    lengths[0] = first.length
    for k in np.flatnonzero(np.isnan(lengths)).tolist():
        own = replace(way(k), crossings=first.crossings) if alike[k] else way(k).straightest().shortest()
        lengths[k] = own.length
    return lengths


def _straight(
    flat: Float[ndarray, "cups panels 2 n 2"],
    slope: Float[ndarray, "cups panels 2 n 2"],
    crossings: Sequence[float],
    straps: Float[ndarray, " cups"],
    ends: Float[ndarray, "cups 2"],
) -> Float[ndarray, " cups"]:
    """Lengths of ways of many cups that are straight in every panel; nan where one would leave its panel.

    Args:
        flat: edges of the panels from that of the end to that of the start.
        slope: of these by the stations.
        crossings: stations where they cross the ridges, from below.
        straps: stations on the upper edge of the last panel, where they start.
        ends: stations in the first panel, and shares of the rulings there, from below.
    """
    last, (station, share) = flat.shape[1] - 1, ends.T

    def on(panel: int, edge: int, stations: Float[ndarray, " cups"]) -> Float[ndarray, "cups 2"]:
        return between(flat[:, panel, edge], slope[:, panel, edge], stations)

    reached = station, (1 - share)[:, None] * on(0, 0, station) + share[:, None] * on(0, 1, station)
    total = np.zeros(len(flat))
    for i in range(last + 1):
        leaving = straps if i == last else np.full(len(flat), crossings[i])
        total += _within_panel(flat[:, i], reached, (leaving, on(i, 1, leaving)))
        if i < last:
            reached = leaving, on(i + 1, 0, leaving)
    return total


_Reached = tuple[Float[ndarray, " cups"], Float[ndarray, "cups 2"]]
"""Stations and places."""


def _within_panel(edges: Float[ndarray, "cups 2 n 2"], one: _Reached, other: _Reached) -> Float[ndarray, " cups"]:
    """Distances of two places each in flat panels; nan where the line between them would leave the panel."""
    low, high = np.minimum(one[0], other[0])[:, None], np.maximum(one[0], other[0])[:, None]
    gates, p, along = np.arange(edges.shape[2]), one[1], other[1] - one[1]
    lower, across = edges[:, 0], edges[:, 1] - edges[:, 0]
    turn = along[:, :1] * across[..., 1] - along[:, 1:] * across[..., 0]
    offset = p[:, None] - lower
    share = (along[:, :1] * offset[..., 1] - along[:, 1:] * offset[..., 0]) / np.where(turn == 0, 1.0, turn)
    inside = ((share >= 0) & (share <= 1)) | (gates <= low) | (gates >= high)
    return np.where(inside.all(axis=1), np.linalg.norm(along, axis=1), np.nan)


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


def flat_curves(flat: Float[ndarray, "panels 2 n 2"]) -> list[FlatCurves]:
    """The panels of a cup; `flat`: samples of their edges."""
    spline = CubicSpline(np.arange(flat.shape[2]), flat, axis=2)

    def curve(i: int, j: int) -> PPoly:
        return PPoly.construct_fast(np.ascontiguousarray(spline.c[:, :, i, j]), spline.x)

    return [FlatCurves(curve(i, 0), curve(i, 1)) for i in range(len(flat))]


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
