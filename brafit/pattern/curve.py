"""Smooth curves of few arcs: chains of cubic Bezier arcs, fitted to points or to other curves within a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

TOLERANCE = 0.01
"""How far (mm) a fitted curve may lie from what it is fitted to."""

Trace = Callable[[Float[ndarray, " n"]], tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]]
"""Positions and unit tangents of a curve at values of its parameter."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, eq=False)
class Curve:
    """Cubic Bezier arcs that join with a common tangent, in mm.

    Attributes:
        controls: the four control points of each arc; an arc begins where the one before it ends.
    """

    controls: Float[ndarray, "arcs 4 2"]

    @staticmethod
    def line(*points: tuple[float, float] | Float[ndarray, "2"]) -> Curve:
        """Straight from point to point: an arc each, corners between them."""
        corners = np.asarray(points, float)
        share = np.arange(4)[None, :, None] / 3
        return Curve((1 - share) * corners[:-1, None] + share * corners[1:, None])

    @staticmethod
    def through(points: Float[ndarray, "n 2"], tolerance: float = TOLERANCE) -> Curve:
        """As few arcs as stay within `tolerance` of the cubic spline through the points, ends kept.

        Raises:
            ValueError: fewer than two distinct points.
        """
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        points = points[np.append(True, steps > 1e-9)]
        if len(points) < 2:
            raise ValueError("a curve needs two distinct points")
        if len(points) == 2:
            return Curve.line(*points)
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        spline = CubicSpline(along, points)

        def trace(u: ndarray) -> tuple[ndarray, ndarray]:
            return spline(u), _unit(spline(u, 1))

        return fit_curve(trace, 0.0, float(along[-1]), tolerance)

    @property
    def start(self) -> Float[ndarray, "2"]:
        return self.controls[0, 0]

    @property
    def end(self) -> Float[ndarray, "2"]:
        return self.controls[-1, 3]

    @property
    def length(self) -> float:
        """Arc length in mm."""
        return float(self._ends[-1])

    @cached_property
    def _ends(self) -> Float[ndarray, " arcs"]:
        """Arc length from the start to the end of each arc."""
        return np.cumsum([_arc_length(arc, 1.0) for arc in self.controls])

    def place(self, distance: float) -> float:
        """The parameter (number of the arc plus place in it) at an arc length from the start, clipped to the curve."""
        distance = float(np.clip(distance, 0.0, self.length))
        k = int(np.clip(np.searchsorted(self._ends, distance), 0, len(self.controls) - 1))
        before = self._ends[k - 1] if k else 0.0
        goal, t = distance - before, (distance - before) / max(self._ends[k] - before, 1e-12)
        for _ in range(30):
            slope = float(np.linalg.norm(_derivative(self.controls[k], np.array([t]))[0]))
            step = (_arc_length(self.controls[k], t) - goal) / max(slope, 1e-9)
            t = float(np.clip(t - step, 0.0, 1.0))
            if abs(step) < 1e-12:
                break
        return k + t

    def trace(self, u: Float[ndarray, " n"]) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]:
        """Positions and unit tangents at parameters from 0 to the number of arcs."""
        k = np.clip(np.floor(u).astype(int), 0, len(self.controls) - 1)
        t = (u - k)[:, None]
        arcs = self.controls[k]
        position = np.einsum("nk,nkj->nj", _bernstein(t[:, 0]), arcs)
        d = 3 * np.diff(arcs, axis=1)
        slope = (1 - t) ** 2 * d[:, 0] + 2 * t * (1 - t) * d[:, 1] + t**2 * d[:, 2]
        return position, _unit(slope)

    def curvature(self, u: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """Signed curvature in 1/mm, positive where the curve turns left."""
        k = np.clip(np.floor(u).astype(int), 0, len(self.controls) - 1)
        t = (u - k)[:, None]
        d = 3 * np.diff(self.controls[k], axis=1)
        first = (1 - t) ** 2 * d[:, 0] + 2 * t * (1 - t) * d[:, 1] + t**2 * d[:, 2]
        second = 2 * ((1 - t) * (d[:, 1] - d[:, 0]) + t * (d[:, 2] - d[:, 1]))
        return cross(first, second) / np.maximum(np.linalg.norm(first, axis=1), 1e-9) ** 3

    def at(self, distance: float) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Position and unit tangent at an arc length from the start."""
        position, tangent = self.trace(np.array([self.place(distance)]))
        return position[0], tangent[0]

    def polyline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """Points whose chords stay within `tolerance` of the curve; corners between arcs are among them."""
        parts = [self.controls[:1, 0]]
        for arc in self.controls:
            bend = np.linalg.norm(np.diff(arc, 2, axis=0), axis=1).max()
            n = max(1, int(np.ceil(np.sqrt(0.75 * bend / tolerance))))
            parts.append(_bernstein(np.arange(1, n + 1) / n) @ arc)
        return np.concatenate(parts)

    def map(self, function: Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]) -> Curve:
        """The curve under an affine map."""
        return Curve(function(self.controls.reshape(-1, 2)).reshape(self.controls.shape))

    def reversed(self) -> Curve:
        return replace(self, controls=self.controls[::-1, ::-1])

    def offset(self, distance: float, tolerance: float = TOLERANCE) -> Curve | None:
        """The parallel curve to the right (to the left where negative); None where it would turn back on itself."""
        if distance == 0:
            return self
        dense = np.linspace(0, len(self.controls), 32 * len(self.controls) + 1)
        if (1 + distance * self.curvature(dense) <= 0.02).any():
            return None

        def trace(u: ndarray) -> tuple[ndarray, ndarray]:
            position, tangent = self.trace(u)
            return position + distance * right_of(tangent), tangent

        return fit_curve(trace, 0.0, float(len(self.controls)), tolerance)


def closed(curves: Sequence[Curve], tolerance: float) -> Float[ndarray, "n 2"]:
    """Curves in a ring as one polygon without repeated points."""
    points = np.concatenate([curve.polyline(tolerance) for curve in curves])
    away = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-7
    return points[away]


def right_of(tangent: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
    """Unit vectors a quarter turn to the right of unit tangents."""
    return np.stack((tangent[..., 1], -tangent[..., 0]), axis=-1)


def fit_curve(trace: Trace, begin: float, end: float, tolerance: float) -> Curve:
    """Arcs with the traced curve's tangents at their joints, each as long as the tolerance allows.

    Handle lengths by least squares of the distances across the arc, the samples' places by Newton's method; joints
    by bisection, then moved to equal parts if that needs no more arcs.
    """
    joints, guess = [begin], (end - begin) / 4
    while joints[-1] < end:
        joints.append(_farthest(trace, joints[-1], end, guess, tolerance))
        guess = joints[-1] - joints[-2]
    even = np.linspace(begin, end, len(joints))
    arcs = [_fit_arc(trace, a, b) for a, b in pairwise(even)]
    if max(error for _, error in arcs) > 0.9 * tolerance:
        arcs = [_fit_arc(trace, a, b) for a, b in pairwise(joints)]
    controls = np.stack([arc for arc, _ in arcs])
    return Curve(controls)


def _farthest(trace: Trace, begin: float, end: float, guess: float, tolerance: float) -> float:
    """About the farthest joint that one arc reaches from `begin`; `guess` is how far that may be."""
    good, goal = begin, min(begin + guess, end)
    while good < goal and _fit_arc(trace, begin, goal)[1] <= 0.9 * tolerance:
        good, goal = goal, min(begin + 1.7 * (goal - begin), end)
    if good == end:
        return end
    bad = goal
    for _ in range(30):
        if good > begin and bad - good < 0.06 * (good - begin):
            return good
        middle = (good + bad) / 2
        if bad - begin < 1e-6 * (end - begin):
            break
        if _fit_arc(trace, begin, middle)[1] <= 0.9 * tolerance:
            good = middle
        else:
            bad = middle
    return bad  # a kink: no arc is short enough, take the shortest tried


def _fit_arc(trace: Trace, begin: float, end: float) -> tuple[Float[ndarray, "4 2"], float]:
    """One arc and the largest distance of samples from it."""
    points, tangents = trace(np.linspace(begin, end, 33))
    first, last, leave, arrive = points[0], points[-1], tangents[0], tangents[-1]
    steps = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    t = steps / max(steps[-1], 1e-12)
    arc = np.stack((first, first + leave * steps[-1] / 3, last - arrive * steps[-1] / 3, last))
    for _ in range(4):
        # only what lies across the arc counts: along it the samples' places give way
        across = right_of(_unit(_derivative(arc, t)))
        b = _bernstein(t)
        a1, a2 = b[:, 1] * (across @ leave), -b[:, 2] * (across @ arrive)
        ends = (b[:, 0] + b[:, 1])[:, None] * first + (b[:, 2] + b[:, 3])[:, None] * last
        rest = (across * (points - ends)).sum(1)
        m11, m12, m22 = a1 @ a1, a1 @ a2, a2 @ a2
        determinant = m11 * m22 - m12 * m12
        if determinant > 1e-10 * m11 * m22:
            r1, r2 = rest @ a1, rest @ a2
            alpha, beta = (r1 * m22 - r2 * m12) / determinant, (m11 * r2 - m12 * r1) / determinant
            low, high = 1e-3 * steps[-1], 2 * steps[-1]
            if low < alpha < high and low < beta < high:
                arc = np.stack((first, first + alpha * leave, last - beta * arrive, last))
        t = _nearer(arc, points, t)
    error = np.linalg.norm(_bernstein(t) @ arc - points, axis=1).max()
    return arc, float(error)


def _nearer(arc: ndarray, points: ndarray, t: ndarray) -> ndarray:
    """A Newton step of each point's parameter towards its foot on the arc."""
    delta = _bernstein(t) @ arc - points
    first = _derivative(arc, t)
    d2 = 6 * np.diff(arc, 2, axis=0)
    second = (1 - t)[:, None] * d2[0] + t[:, None] * d2[1]
    slope = (delta * first).sum(1)
    bend = (first * first).sum(1) + (delta * second).sum(1)
    moved = np.clip(t - slope / np.where(bend > 0, bend, np.inf), 0, 1)
    moved[0], moved[-1] = 0, 1
    return moved


def _bernstein(t: Float[ndarray, " n"]) -> Float[ndarray, "n 4"]:
    s = 1 - t
    return np.stack((s**3, 3 * s * s * t, 3 * s * t * t, t**3), axis=-1)


def _derivative(arc: Float[ndarray, "4 2"], t: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
    s = 1 - t
    return np.stack((s * s, 2 * s * t, t * t), axis=-1) @ (3 * np.diff(arc, axis=0))


def _arc_length(arc: Float[ndarray, "4 2"], t: float) -> float:
    """Arc length from 0 to t."""
    return float(_WEIGHTS @ np.linalg.norm(_derivative(arc, t * (_NODES + 1) / 2), axis=1) * t / 2)


def _unit(vectors: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def cross(a: Float[ndarray, "n 2"], b: Float[ndarray, "n 2"]) -> Float[ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
