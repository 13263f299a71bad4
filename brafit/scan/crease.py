"""The wire line where none is given: the crease between breast and chest, found where the surface is hollow.

All of it works in a breast frame: x down along the chest, y outwards, z out of the chest, origin at the apex, mm; right
breasts mirrored. A curve of a wire's usual shape is first placed where it runs along hollow places best, then drawn to
the bottom of the hollow station by station, and kept to the smooth shape where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import ndimage, optimize
from scipy.spatial import KDTree

from brafit.scan.surface import Surface, settle

SHAPE = np.array([
    [0.0, 0.0], [0.156, 0.009], [0.309, 0.027], [0.455, 0.055], [0.592, 0.092], [0.714, 0.139], [0.819, 0.195],
    [0.902, 0.259], [0.963, 0.328], [0.994, 0.401], [0.999, 0.476], [0.977, 0.55], [0.932, 0.621], [0.864, 0.688],
    [0.775, 0.75], [0.667, 0.805], [0.548, 0.854], [0.42, 0.898], [0.285, 0.937], [0.144, 0.971], [0.0, 1.0],
])  # fmt: skip
"""A wire at equal steps of arc length: depth below its chord over its height, place along the chord over its span. Mean
of the wires of 14 breasts; standard deviation at most 0.018 and 0.027."""
SPAN, RATIO, TURN = (142.0, 22.0), (0.46, 0.05), (0.0, 6.0)
"""Usual value and spread of span (mm), height over span, and turn in the frame (degrees)."""
APEX_DOWN, APEX_OUT = (0.22, 0.05), (0.46, 0.07)
"""Where the apex lies in the wire's frame, over the span: below the chord and from the inner end."""
BODY_UP = np.array([-0.958, 0.05, 0.28])
"""The body's upward direction in the breast frame."""
ENDS_ABOVE_APEX = 9.0
"""The middle of the wire's ends is at least so far above the apex, mm (in 14 breasts 8.7 to 21)."""
PRIOR = 0.006
"""What one squared spread off the usual costs, in units of concavity."""
SCALE, MOST = 11.0, 160
"""Radius in which hollowness is measured, mm, and the most points in it that count."""
HOLLOW = 0.03
"""Least concavity that counts as a crease."""
DEEPEST = 0.15
"""More concavity than this says nothing more."""
PIXEL, HALF = 2.0, 170.0
UNSEEN = -0.02
"""Counted as the concavity where no points are: no reason to lay a wire there."""
REACH, OFF_COST = 14.0, 0.03
"""How far (mm) the crease may lie off the usual shape, and what that costs, in units of concavity."""
STATIONS = 61
COUNT = 51


@dataclass(frozen=True, eq=False)
class Wire:
    """A wire line that was found.

    Attributes:
        wire: points from the inner to the outer end.
        guessed: share of its length where the scan shows no crease.
        hollow: mean concavity along it: how plain the crease is.
    """

    wire: Float[np.ndarray, "k 3"]
    guessed: float
    hollow: float


@dataclass(frozen=True)
class _Placed:
    """A wire's usual shape in the x-y plane: its inner end, span, height over span, turn (degrees)."""

    x: float
    y: float
    span: float
    ratio: float
    turn: float

    def points(self, shape: np.ndarray) -> np.ndarray:
        angle = np.radians(self.turn)
        down, along = shape[:, 0] * self.ratio * self.span, shape[:, 1] * self.span
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([self.x + c * down - s * along, self.y + s * down + c * along], axis=1)

    def raised(self, height: float) -> _Placed:
        """With the same bottom and longer legs."""
        angle = np.radians(self.turn)
        x, y = self.x - height * np.cos(angle), self.y - height * np.sin(angle)
        return _Placed(x, y, self.span, self.ratio + height / self.span, self.turn)

    def cost(self) -> float:
        """Squared spreads off the usual."""
        angle = np.radians(self.turn)
        down = -self.x * np.cos(angle) - self.y * np.sin(angle)
        out = self.x * np.sin(angle) - self.y * np.cos(angle)
        values = (self.span, self.ratio, self.turn, down / self.span, out / self.span)
        usual = (SPAN, RATIO, TURN, APEX_DOWN, APEX_OUT)
        return sum(((value - mean) / spread) ** 2 for value, (mean, spread) in zip(values, usual, strict=True))


def trace(surface: Surface, ends: Float[np.ndarray, "2 3"] | None = None) -> Wire:
    """The wire line on a surface about a breast, in the breast frame (see above).

    Args:
        surface: the points about the apex.
        ends: inner and outer end, where they are known. Without them they follow from the usual shape, but are no
            lower than ENDS_ABOVE_APEX.
    """
    near = np.linalg.norm(surface.points, axis=1) < HALF
    surface = surface.select(near)
    hollow = concavity(surface, max(SCALE, 4 * surface.spacing))
    image = _image(surface.points, hollow)
    placed = _place(image, ends)
    line, measured, strength = _drawn(image, placed)
    wire = _lifted(line, strength, ends, surface.points, hollow)
    missing = ENDS_ABOVE_APEX - float((wire[[0, -1]] @ BODY_UP).mean())
    if ends is None and missing > 0:
        line, measured, strength = _drawn(image, placed.raised(missing))
        wire = _lifted(line, strength, ends, surface.points, hollow)
    if ends is not None:
        wire = _through(wire, ends)
    wire = _onto(wire, measured, surface)
    steps = np.linalg.norm(np.diff(wire, axis=0), axis=1)
    weight = np.append(steps, 0) + np.append(0, steps)
    guessed = float(weight[~measured].sum() / weight.sum())
    return Wire(_even(wire, COUNT), guessed, float(np.clip(strength, 0, DEEPEST).mean()))


def laid(surface: Surface, arc: Float[np.ndarray, "k 2"]) -> Wire:
    """A rigid planar wire laid where it runs along hollow places best, in the plane that the chest makes under it.

    Args:
        surface: the points about the apex, in the breast frame.
        arc: the wire: depth below its chord and place along it, mm.
    """
    surface = surface.select(np.linalg.norm(surface.points, axis=1) < HALF)
    hollow = concavity(surface, max(SCALE, 4 * surface.spacing))
    image = _image(surface.points, hollow)
    span, depth = float(arc[-1, 1]), float(arc[:, 0].max())
    shape = arc / np.array([depth, span])
    starts = [
        _Placed(-down * span + x, -out * span + y, span, depth / span, turn)
        for down, out in ((APEX_DOWN[0], APEX_OUT[0]),)
        for x in np.arange(-30.0, 31.0, 6.0)
        for y in np.arange(-30.0, 31.0, 6.0)
        for turn in (-8.0, 0.0, 8.0)
    ]

    def score(placed: _Placed) -> float:
        return float(_sample(image, placed.points(shape)).mean()) - PRIOR * placed.cost()

    placed = max(starts, key=score)
    line = placed.points(shape)
    strength = _sample(image, line)
    heights = _lifted(line, strength, None, surface.points, hollow)[:, 2]
    # The plane through these heights, with the arc's own plan kept rigid in it.
    slope = np.linalg.lstsq(np.column_stack([line, np.ones(len(line))]), heights, rcond=None)[0]
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    bottom = np.append(line.mean(axis=0), heights.mean())
    chord = np.append(line[-1] - line[0], 0.0)
    along = chord - (chord @ normal) * normal
    along /= np.linalg.norm(along)
    down = np.cross(along, normal)
    flat = arc - arc.mean(axis=0)
    wire = bottom + flat[:, :1] * down + flat[:, 1:] * along
    return Wire(wire, float((strength < HOLLOW).mean()), float(np.clip(strength, 0, DEEPEST).mean()))


def concavity(surface: Surface, radius: float) -> Float[np.ndarray, " n"]:
    """How hollow the surface is at each point: the height of the mean of the points within `radius` over the middle of
    the inner ones, along the mean normal, over the radius. 0 on a plane, -radius/(4 R) and less on a sphere of radius
    R, positive in a crease; up to about 0.3 in a narrow one.
    """
    tree = KDTree(surface.points)
    count = min(MOST, len(surface.points))
    distances, near = tree.query(surface.points, k=count, distance_upper_bound=radius)
    within = np.isfinite(distances)
    near = np.where(within, near, 0)
    around = surface.points[near]

    def mean(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
        return np.einsum("nki,nk->ni", values, mask.astype(float)) / mask.sum(axis=1)[:, None]

    normal = mean(surface.normals[near], within)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    offset = mean(around, within) - mean(around, distances < 0.4 * radius)
    value = (offset * normal).sum(axis=1) / radius
    return np.where(within.sum(axis=1) >= 8, value, 0.0)


def _image(points: np.ndarray, hollow: np.ndarray) -> np.ndarray:
    """Concavity seen from in front, the largest in each pixel, smoothed; where no points are, 0."""
    size = int(2 * HALF / PIXEL)
    cell = np.floor((points[:, :2] + HALF) / PIXEL).astype(int)
    good = ((cell >= 0) & (cell < size)).all(axis=1)
    image = np.full((size, size), -np.inf)
    np.maximum.at(image, tuple(cell[good].T), np.clip(hollow[good], -DEEPEST, DEEPEST))
    seen = np.isfinite(image)
    value = ndimage.gaussian_filter(np.where(seen, image, 0.0), 1.5)
    share = ndimage.gaussian_filter(seen.astype(float), 1.5)
    return np.where(share > 0.05, value / np.maximum(share, 0.05), UNSEEN)


def _sample(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The image at places (..., 2), mm."""
    index = (places + HALF) / PIXEL - 0.5
    return ndimage.map_coordinates(image, np.moveaxis(index, -1, 0), order=1, mode="nearest")


def _place(image: np.ndarray, ends: np.ndarray | None) -> _Placed:
    """The usual shape where it runs along hollow places best."""
    if ends is not None:
        chord = ends[1, :2] - ends[0, :2]
        span, angle = float(np.linalg.norm(chord)), float(np.degrees(np.arctan2(-chord[0], chord[1])))

        def of_ratio(ratio: float) -> _Placed:
            return _Placed(float(ends[0, 0]), float(ends[0, 1]), span, ratio, angle)

        ratios = np.linspace(0.3, 0.75, 46)
        return max(map(of_ratio, ratios), key=lambda p: _score(image, p, prior=0.3))

    random = np.random.default_rng(0)
    starts = []
    for _ in range(3000):
        span, ratio, turn, down, out = (
            random.normal(mean, 1.3 * spread) for mean, spread in (SPAN, RATIO, TURN, APEX_DOWN, APEX_OUT)
        )
        angle = np.radians(turn)
        x = -np.cos(angle) * down * span + np.sin(angle) * out * span
        y = -np.sin(angle) * down * span - np.cos(angle) * out * span
        starts.append(_Placed(x, y, max(span, 80.0), max(ratio, 0.25), turn))
    best = sorted(starts, key=lambda p: -_score(image, p))[:6]
    scale = np.array([10.0, 10.0, 15.0, 0.05, 4.0])

    def loss(v: np.ndarray) -> float:
        return -_score(image, _Placed(*(v * scale)))

    found = []
    for start in best:
        v = np.array([start.x, start.y, start.span, start.ratio, start.turn]) / scale
        result = optimize.minimize(
            loss, v, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1e-6, "maxiter": 400}
        )
        found.append(_Placed(*(float(a) for a in result.x * scale)))
    return max(found, key=lambda p: _score(image, p))


def _score(image: np.ndarray, placed: _Placed, prior: float = 1.0) -> float:
    return float(_sample(image, placed.points(SHAPE)).mean()) - prior * PRIOR * placed.cost()


def _drawn(image: np.ndarray, placed: _Placed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The shape drawn to the bottom of the hollow: places (STATIONS, 2), whether there is a crease, its concavity."""
    line = _even(placed.points(SHAPE), STATIONS)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    offsets = np.arange(-REACH, REACH + 0.5, 1.0)
    values = _sample(image, line[:, None] + offsets[:, None] * across[:, None])
    chosen = _smoothest(values - OFF_COST * (offsets / REACH) ** 2)
    strength = values[np.arange(STATIONS), chosen]
    measured = strength >= HOLLOW
    weight = np.where(measured, np.clip(strength, 0, DEEPEST) / DEEPEST, 0.0)
    offset = _smoothed(offsets[chosen], weight, 30.0, 1e-2)
    return line + offset[:, None] * across, measured, strength


def _smoothest(gain: np.ndarray) -> np.ndarray:
    """For each row the column that makes the sum of gains largest, less what jumps cost (dynamic programming)."""
    columns = np.arange(gain.shape[1])
    jump = 0.004 * (columns[:, None] - columns) ** 2
    total, best = gain[0], []
    for row in gain[1:]:
        candidates = total[:, None] - jump
        best.append(candidates.argmax(axis=0))
        total = candidates.max(axis=0) + row
    path = [int(total.argmax())]
    for before in reversed(best):
        path.append(int(before[path[-1]]))
    return np.array(path[::-1])


def _smoothed(values: np.ndarray, weight: np.ndarray, stiffness: float, towards: float) -> np.ndarray:
    """Whittaker's smoother: near the weighted values, second differences small, weakly drawn `towards` zero."""
    second = np.diff(np.eye(len(values)), 2, axis=0)
    system = np.diag(weight + towards) + stiffness * second.T @ second
    return np.linalg.solve(system, weight * values)


def _lifted(
    line: np.ndarray, strength: np.ndarray, ends: np.ndarray | None, points: np.ndarray, hollow: np.ndarray
) -> np.ndarray:
    """Heights to the places: those of the hollow points near them, smooth, and in a plane in between."""
    tree = KDTree(points[:, :2])
    height, weight = np.zeros(len(line)), np.zeros(len(line))
    for k, near in enumerate(tree.query_ball_point(line, 5.0)):
        if near and strength[k] >= HOLLOW:
            value = np.clip(hollow[near], 1e-3, DEEPEST)
            deep = value >= 0.6 * value.max()
            height[k] = np.average(points[near, 2][deep], weights=value[deep])
            weight[k] = min(strength[k] / DEEPEST, 1.0) ** 2
    if ends is not None:
        height[[0, -1]], weight[[0, -1]] = ends[:, 2], 2.0
    if (weight > 0).sum() < 3:  # nothing to go by: the chest's height at the places
        height, weight = points[tree.query(line)[1], 2], np.ones(len(line))
    plane = np.column_stack([line, np.ones(len(line))])
    root = np.sqrt(weight)
    level = plane @ np.linalg.lstsq(root[:, None] * plane, root * height, rcond=None)[0]
    return np.column_stack([line, level + _smoothed(height - level, weight, 30.0, 1e-2)])


def _through(wire: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The wire moved so that it runs from end to end: by all of the gap at the ends, by less and less away from
    them.
    """
    share = np.linspace(0, 1, len(wire))[:, None]
    fade = 0.2
    first, last = np.clip(1 - share / fade, 0, 1) ** 2, np.clip(1 - (1 - share) / fade, 0, 1) ** 2
    return wire + first * (ends[0] - wire[0]) + last * (ends[1] - wire[-1])


def _onto(wire: np.ndarray, measured: np.ndarray, surface: Surface) -> np.ndarray:
    """Places without a crease drawn onto the surface, where it is near and does not lead far away."""
    placed, _ = settle(surface, wire, max(3 * surface.spacing, 6.0))
    near = KDTree(surface.points).query(wire)[0] < max(8.0, 3 * surface.spacing)
    on = near & (np.linalg.norm(placed - wire, axis=1) < 8.0) & ~measured
    on[[0, -1]] = False
    move = np.where(on[:, None], placed - wire, 0.0)
    smooth = np.stack([_smoothed(column, np.where(on | measured, 1.0, 0.0), 2.0, 1e-2) for column in move.T], axis=1)
    return wire + smooth


def _even(line: np.ndarray, count: int) -> np.ndarray:
    """Points at equal steps of arc length."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    return np.stack([np.interp(np.linspace(0, arc[-1], count), arc, column) for column in line.T], axis=1)
