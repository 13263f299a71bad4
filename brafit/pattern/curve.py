"""Smooth curves of few arcs: chains of cubic Bezier arcs, fitted to points or to other curves within a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

TOLERANCE = 0.01
"""How far (mm) a fitted curve may lie from what it is fitted to."""

Trace = Callable[[Float[ndarray, " n"]], tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]]
"""Positions and unit tangents of a curve at values of its parameter."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)

# How arcs are fitted.
_SHARES = np.linspace(0, 1, 33)
"""Where an arc is compared with the curve, in shares of the parameter."""
_CELLS = 512
"""Parts of a curve whose wanted density of joints is told apart."""
_TURN, _LEAST = 1.0, 5
"""How many arcs are tried first: one for every _TURN radians of turning, and _LEAST besides."""
_ORDER = 5.0
"""The error of an arc grows with about this power of its length."""
_DAMPING = 1e-3
"""Of the handles' lengths, in squared mm of error by mm."""
_FEWER = 0.75
"""Good arcs are tried anew where this share of them seems to do."""
_ROUNDS = 10
"""Rounds of moving joints at most."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Cubic Bezier arcs that join with a common tangent, in mm.

    Attributes:
        controls: the four control points of each arc; an arc begins where the one before it ends.
    """

    controls: Float[ndarray, "arcs 4 2"]

    def __getstate__(self) -> dict[str, object]:
        return {"controls": self.controls}  # what follows of them is not sent or kept

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
        return curves_through([points], tolerance)[0]

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
        return np.cumsum(_arc_lengths(self.controls, np.ones(len(self.controls))))

    def places(self, distances: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
        """The parameters (number of the arc plus place in it) at arc lengths from the start, clipped to the curve."""
        distances = np.clip(distances, 0.0, self.length)
        k = np.clip(np.searchsorted(self._ends, distances), 0, len(self.controls) - 1)
        starts = np.append(0.0, self._ends[:-1])
        goal, arcs = distances - starts[k], self.controls[k]
        t = goal / np.maximum(self._ends[k] - starts[k], 1e-12)
        for _ in range(30):
            slope = np.linalg.norm(_derivatives(arcs, t[:, None])[:, 0], axis=1)
            step = (_arc_lengths(arcs, t) - goal) / np.maximum(slope, 1e-9)
            t = np.clip(t - step, 0.0, 1.0)
            if (np.abs(step) < 1e-9).all():
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
        position, tangent = self.trace(self.places(np.array([distance])))
        return position[0], tangent[0]

    def polyline(self, tolerance: float = 0.02) -> Float[ndarray, "n 2"]:
        """Points whose chords stay within `tolerance` of the curve; corners between arcs are among them."""
        if tolerance not in self._polylines:
            self._polylines[tolerance] = self._drawn(tolerance)
        return self._polylines[tolerance]

    @cached_property
    def _polylines(self) -> dict[float, Float[ndarray, "_ 2"]]:
        """Those that have been asked for: outlines, texts and files ask for the same ones."""
        return {}

    def _drawn(self, tolerance: float) -> Float[ndarray, "n 2"]:
        bend = np.linalg.norm(np.diff(self.controls, 2, axis=1), axis=2).max(1)
        counts = np.maximum(1, np.ceil(np.sqrt(0.75 * bend / tolerance)).astype(int))
        k = np.repeat(np.arange(len(counts)), counts)
        t = (np.arange(len(k)) - np.repeat(np.cumsum(counts) - counts, counts) + 1) / counts[k]
        points = (_bernstein(t)[:, None] @ self.controls[k])[:, 0]
        return np.concatenate((self.controls[:1, 0], points))

    def map(self, function: Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]) -> Curve:
        """The curve under an affine map."""
        return Curve(function(self.controls.reshape(-1, 2)).reshape(self.controls.shape))

    def reversed(self) -> Curve:
        return replace(self, controls=self.controls[::-1, ::-1])

    def offset(self, distance: float, tolerance: float = TOLERANCE) -> Curve | None:
        """The parallel curve to the right (to the left where negative); None where it would turn back on itself."""
        return offsets([self], [distance], tolerance)[0]

    def parallel(self, distance: float) -> Trace:
        """The trace of the parallel curve to the right, by this curve's own parameter."""

        def trace(u: ndarray) -> tuple[ndarray, ndarray]:
            position, tangent = self.trace(u)
            return position + distance * right_of(tangent), tangent

        return trace

    def turns_back(self, distance: float) -> bool:
        """Whether the parallel curve to the right folds back on itself somewhere."""
        dense = np.linspace(0, len(self.controls), 32 * len(self.controls) + 1)
        return bool((1 + distance * self.curvature(dense) <= 0.02).any())


def curves_through(lines: Sequence[Float[ndarray, "_ 2"]], tolerance: float = TOLERANCE) -> list[Curve]:
    """`Curve.through` for several lines of points at once, which is faster.

    Raises:
        ValueError: a line has fewer than two distinct points.
    """
    found: dict[int, Curve] = {}
    stretches: dict[int, Stretch] = {}
    for i, line in enumerate(lines):
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        points, steps = line[np.append(True, steps > 1e-9)], steps[steps > 1e-9]
        if len(points) < 2:
            raise ValueError("a curve needs two distinct points")
        if len(points) == 2:
            found[i] = Curve.line(*points)
        else:
            along = np.append(0.0, np.cumsum(steps))
            stretches[i] = Stretch(_spline_trace(CubicSpline(along, points)), 0.0, float(along[-1]))
    found |= zip(stretches, fit_curves(list(stretches.values()), tolerance), strict=True)
    return [found[i] for i in range(len(lines))]


def offsets(curves: Sequence[Curve], distances: Sequence[float], tolerance: float = TOLERANCE) -> list[Curve | None]:
    """`Curve.offset` for several curves at once, which is faster."""
    found: dict[int, Curve | None] = {}
    stretches: dict[int, Stretch] = {}
    for i, (curve, distance) in enumerate(zip(curves, distances, strict=True)):
        if distance == 0:
            found[i] = curve
        elif curve.turns_back(distance):
            found[i] = None
        else:
            count = len(curve.controls)
            stretches[i] = Stretch(curve.parallel(distance), 0.0, float(count), count)
    found |= zip(stretches, fit_curves(list(stretches.values()), tolerance), strict=True)
    return [found[i] for i in range(len(curves))]


def closed(curves: Sequence[Curve], tolerance: float) -> Float[ndarray, "n 2"]:
    """Curves in a ring as one polygon without repeated points."""
    points = np.concatenate([curve.polyline(tolerance) for curve in curves])
    away = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-7
    return points[away]


def enclosed_area(curves: Sequence[Curve]) -> float:
    """Area within curves in a ring, positive where they run counter-clockwise."""
    area = 0.0
    for curve, after in zip(curves, [*curves[1:], curves[0]], strict=True):
        t = np.broadcast_to((_NODES + 1) / 2, (len(curve.controls), len(_NODES)))
        position, slope = _bernstein(t[0]) @ curve.controls, _derivatives(curve.controls, t)
        area += float((position[..., 0] * slope[..., 1] - position[..., 1] * slope[..., 0]).sum(0) @ _WEIGHTS / 4)
        area += float(curve.end[0] * after.start[1] - curve.end[1] * after.start[0]) / 2
    return area


def right_of(tangent: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
    """Unit vectors a quarter turn to the right of unit tangents."""
    return np.stack((tangent[..., 1], -tangent[..., 0]), axis=-1)


@dataclass(frozen=True)
class Stretch:
    """A curve to be fitted: its trace between two parameters.

    Attributes:
        arcs: about how many equal parts of the parameter are to be tried first; None: as it turns.
    """

    trace: Trace
    begin: float
    end: float
    arcs: int | None = None


def fit_curves(stretches: Sequence[Stretch], tolerance: float) -> list[Curve]:
    """Curves of few arcs within a tolerance, with the traced curves' tangents at their joints.

    From the errors of arcs that were tried follows how dense joints should lie, and so where they are to be tried next
    and how many of them, until all arcs are good. The arcs of all curves are fitted at once.
    """
    searches = [_Search(stretch, 0.9 * tolerance) for stretch in stretches]
    for _ in range(_ROUNDS):
        searching = [search for search in searches if not search.done]
        if not searching:
            break
        samples = [search.samples() for search in searching]
        counts = [len(points) for points, _ in samples]
        arcs, errors = _fit_arcs(*(np.concatenate(part) for part in zip(*samples, strict=True)))
        for search, first, count in zip(searching, np.cumsum(counts) - counts, counts, strict=True):
            search.judge(arcs[first : first + count], errors[first : first + count])
    return [search.result() for search in searches]


class _Search:
    """Where the joints of one curve's arcs are to be.

    Args:
        goal: the largest error that is allowed.
    """

    def __init__(self, stretch: Stretch, goal: float):
        self._trace, self._goal = stretch.trace, goal
        self._grid = np.linspace(stretch.begin, stretch.end, _CELLS + 1)
        tangents = _complex(stretch.trace(self._grid)[1])
        self._turn = np.abs(np.angle(tangents[1:] * tangents[:-1].conj()))
        if stretch.arcs is None:
            self._wanted = self._turn / _TURN + _LEAST / _CELLS
        else:
            self._wanted = np.full(_CELLS, stretch.arcs / _CELLS)
        self._count = max(1, round(float(self._wanted.sum())))
        self._joints = self._placed()
        self._found: Complex[ndarray, "arcs 4"] | None = None
        self.done = False

    def samples(self) -> tuple[Complex[ndarray, "arcs k"], Complex[ndarray, "arcs k"]]:
        """Points of the curve and its unit tangents there, along each of the arcs that are to be tried."""
        return _sampled(self._trace, self._joints)

    def judge(self, arcs: Complex[ndarray, "arcs 4"], errors: Float[ndarray, " arcs"]) -> None:
        """Learn from the arcs that were tried."""
        good = bool(errors.max() <= self._goal)
        if good:
            self._found = arcs
        middles = (self._grid[1:] + self._grid[:-1]) / 2
        owner = np.clip(np.searchsorted(self._joints, middles) - 1, 0, len(arcs) - 1)
        wanted = np.clip(errors / self._goal, 0.01, 30.0) ** (1 / _ORDER)
        # where an arc turns far, its error tells little
        wanted = np.maximum(wanted, np.bincount(owner, self._turn, len(arcs)) / (1.5 * _TURN))
        self._wanted *= (wanted / np.maximum(np.bincount(owner, self._wanted, len(arcs)), 1e-9))[owner]
        needed = int(np.ceil(wanted.sum()))
        self.done = self._found is not None and not (good and needed <= _FEWER * len(arcs))
        self._count = needed if good else max(needed, len(arcs) + 1)
        self._joints = self._placed()

    def result(self) -> Curve:
        """The arcs that were good; where there are none, those that are bad are halved until they are."""
        joints, found = self._joints, self._found
        while found is None:
            arcs, errors = _fit_arcs(*_sampled(self._trace, joints))
            bad = (errors > self._goal) & (np.diff(joints) > 1e-6 * (self._grid[-1] - self._grid[0]))
            if not bad.any():  # what is bad still is a kink
                found = arcs
            middles = (joints[1:] + joints[:-1]) / 2
            joints = np.sort(np.concatenate((joints, middles[bad])))
        return Curve(_pairs(found))

    def _placed(self) -> Float[ndarray, " joints"]:
        """As many arcs as wanted, joints as dense as wanted."""
        total = np.append(0.0, np.cumsum(self._wanted))
        return np.interp(np.linspace(0, total[-1], self._count + 1), total, self._grid)


def _sampled(
    trace: Trace, joints: Float[ndarray, " joints"]
) -> tuple[Complex[ndarray, "arcs k"], Complex[ndarray, "arcs k"]]:
    u = joints[:-1, None] + np.diff(joints)[:, None] * _SHARES
    points, tangents = trace(u.ravel())
    return _complex(points).reshape(u.shape), _complex(tangents).reshape(u.shape)


def _fit_arcs(
    points: Complex[ndarray, "arcs k"], tangents: Complex[ndarray, "arcs k"]
) -> tuple[Complex[ndarray, "arcs 4"], Float[ndarray, " arcs"]]:
    """An arc for each row of samples, and the largest distance of the samples from it.

    The directions at both ends are the curve's; the lengths of the two handles follow by Gauss and Newton from the
    samples' distances across the arc, a little damped because they mean nothing where the curve is straight. Along the
    arc the samples' places give way, by Newton's method.
    """
    first, last, leave, arrive = points[:, :1], points[:, -1:], tangents[:, :1], tangents[:, -1:]
    along = np.zeros(points.shape)
    np.cumsum(np.abs(np.diff(points, axis=1)), axis=1, out=along[:, 1:])
    size = along[:, -1:]
    t = along / np.maximum(size, 1e-12)
    a = b = size / 3
    best, errors = (a, b), np.full((len(points), 1), np.inf)
    for step in range(5):
        second, third = first + a * leave, last - b * arrive
        away, slope, bend = _off(first, second, third, last, t, points)
        if step:
            change = _dot(slope, slope) + _dot(away, bend)
            t = np.clip(t - _dot(away, slope) / np.where(change > 0, change, np.inf), 0, 1)
            t[:, 0], t[:, -1] = 0, 1
            away, slope, _ = _off(first, second, third, last, t, points)
            found = np.abs(away).max(1, keepdims=True)
            best = tuple(np.where(found < errors, new, old) for new, old in zip((a, b), best, strict=True))
            errors = np.minimum(errors, found)
        across = 1j * slope / np.maximum(np.abs(slope), 1e-12)
        s = 1 - t
        by_a, by_b = 3 * s * s * t * _dot(across, leave), -3 * s * t * t * _dot(across, arrive)
        rest = _dot(across, away)
        aa, ab, bb = (_sum(x * y) for x, y in ((by_a, by_a), (by_a, by_b), (by_b, by_b)))
        ra, rb = _sum(rest * by_a), _sum(rest * by_b)
        aa, bb = aa + _DAMPING, bb + _DAMPING
        determinant = aa * bb - ab * ab
        a = np.clip(a - (ra * bb - rb * ab) / determinant, 0.05 * size, 0.9 * size)
        b = np.clip(b - (rb * aa - ra * ab) / determinant, 0.05 * size, 0.9 * size)
    a, b = best
    return np.concatenate((first, first + a * leave, last - b * arrive, last), axis=1), errors[:, 0]


def _off(
    first: ndarray, second: ndarray, third: ndarray, last: ndarray, t: ndarray, points: ndarray
) -> tuple[Complex[ndarray, "arcs k"], Complex[ndarray, "arcs k"], Complex[ndarray, "arcs k"]]:
    """From the points to arcs at parameters t, and the arcs' first and second derivatives there."""
    s = 1 - t
    d1, d2, d3 = second - first, third - second, last - third
    slope = 3 * (s * s * d1 + 2 * s * t * d2 + t * t * d3)
    bend = 6 * (s * (d2 - d1) + t * (d3 - d2))
    return s * s * (s * first + 3 * t * second) + t * t * (3 * s * third + t * last) - points, slope, bend


def _dot(a: Complex[ndarray, "n k"], b: Complex[ndarray, "n #k"]) -> Float[ndarray, "n k"]:
    return np.real(a) * np.real(b) + np.imag(a) * np.imag(b)


def _sum(values: Float[ndarray, "arcs k"]) -> Float[ndarray, "arcs 1"]:
    return values.sum(1, keepdims=True)


def _complex(points: Float[ndarray, "*n 2"]) -> Complex[ndarray, "*n"]:
    return points[..., 0] + 1j * points[..., 1]


def _pairs(points: Complex[ndarray, "*n"]) -> Float[ndarray, "*n 2"]:
    return np.stack((np.real(points), np.imag(points)), axis=-1)


def _spline_trace(spline: CubicSpline) -> Trace:
    slope = spline.derivative()
    return lambda u: (spline(u), _unit(slope(u)))


def _bernstein(t: Float[ndarray, " n"]) -> Float[ndarray, "n 4"]:
    s = 1 - t
    return np.stack((s**3, 3 * s * s * t, 3 * s * t * t, t**3), axis=-1)


def _derivatives(arcs: Float[ndarray, "n 4 2"], t: Float[ndarray, "#n k"]) -> Float[ndarray, "n k 2"]:
    """Of each arc by its own parameters."""
    s = 1 - t
    return np.stack((s * s, 2 * s * t, t * t), axis=-1) @ (3 * np.diff(arcs, axis=1))


def _arc_lengths(arcs: Float[ndarray, "n 4 2"], t: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Arc length of each from 0 to t."""
    speed = np.linalg.norm(_derivatives(arcs, t[:, None] * (_NODES + 1) / 2), axis=2)
    return speed @ _WEIGHTS * t / 2


def _unit(vectors: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def cross(a: Float[ndarray, "n 2"], b: Float[ndarray, "n 2"]) -> Float[ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
