"""The wire line where none is given: the crease between breast and chest, found where the surface is hollow.

All of it works in a breast frame: x down along the chest, y outwards, z out of the chest, origin at the apex, mm; right
breasts mirrored. A curve of a wire's usual shape is first placed where it runs along hollow places best, then drawn to
the bottom of the hollow, first as it is seen from in front, then in sections (`brafit.anatomy.crease_sections`). The
ends are cut off by the rules that the given landmarks of 14 breasts follow to a millimetre or two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage, sparse
from scipy.spatial import KDTree

from brafit.anatomy.crease_sections import folds, rim, smoothed
from brafit.anatomy.wire_ends import lowest, usual_ends
from brafit.geometry.polyline import evenly_spaced, polyline_length
from brafit.geometry.rigid import laid_on
from brafit.surface.normals import Surface, settle
from brafit.surface.simplex import minimised

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
RISE, ABOVE, TILT = 0.4345, 9.3, 0.05
"""The middle of the wire's ends is so high above its bottom, over its span, but no lower than ABOVE mm above the apex
(in 14 breasts within 0.01 and 0.6 mm); the outer end is higher than the inner one by TILT of the span (within 0.01)."""
LEGS = np.array([[-32.0, -65.0], [-32.0, 76.5]])
"""Where the ends usually are (x, y; mm), for creases that do not show: spread 7 and 10 mm across."""
PLAIN = (0.04, 0.15)
"""Strength from which on a crease counts, and how much more makes it count in full."""
WINDOWS = (12.0, 9.0, 7.0, 6.0, 6.0)
"""How far (mm) to either side of the line the crease is sought, round by round."""
FIRST, LAID, USUAL, HELD = 0.005, 0.1, 1.0, 3.0
"""Weights, against a plain crease's 1: of the first placing, of the surface where there is no crease, of each of LEGS,
of ends that are given."""
OUTER_PART, FADED, LED = 0.72, 0.3, 2.0
"""From this share of the way to the outer end on it is looked whether the crease fades. Where there is less than
so much of a plain crease, the outer one of LEGS gives way to the place of `usual_ends`, of this weight at most."""
KEPT = 1.0
"""Weight of the first placing where without it the line went astray, as it does where a crease hardly shows, or runs
nearly straight (in underwear), so that a much larger circle fits it."""
LONGEST, FARTHEST, ASHORE, WIDEST, UNSHOWN = 310.0, 60.0, 12.0, 165.0, 0.3
"""Such a line is longer than LONGEST (mm; the wires of 14 breasts: 186 to 273), or somewhere FARTHEST mm from the first
placing, or a fifth of it is ASHORE mm from the surface, or its ends are WIDEST mm apart (13 of 14: 127 to 155) though
more than the share UNSHOWN of it shows no crease."""
FLAT = 0.02
"""Where no crease shows and the ends are given: weight of the line's distance from the ends' plane."""
ASTRAY = 5.0
"""A place of a rigid wire farther (mm) than this from the crease does not lie in it."""
FITTINGS = 20
"""Rounds of nearest points in which a rigid wire is laid on a crease."""
OFF, BESIDE = 20.0, 5.0
"""A line farther than OFF mm from the surface is not laid on it, nor one that would lie more than BESIDE mm from any
point, over a hole."""
PRIOR = 0.006
"""Penalty for each squared standard deviation from the usual wire, in units of concavity."""
SCALE = 11.0
"""Radius in which hollowness is measured, mm."""
STARTS, REFINED = 3000, 6
"""Places at which a wire's usual shape is tried, and how many of the best of them are refined."""
HOLLOW = 0.03
"""Least concavity that counts as a crease."""
DEEPEST = 0.15
"""Concavity is clipped here: a deeper crease is no stronger evidence."""
STIFF = 30.0
"""Of the smoothing of heights along a line that is laid on the surface."""
PIXEL, HALF = 2.0, 170.0
UNSEEN = -0.02
"""Counted as the concavity where no points are: no reason to lay a wire there."""
REACH, OFF_COST = 14.0, 0.03
"""How far (mm) the crease may lie off the usual shape, and what that costs, in units of concavity."""
STATIONS = 61
COUNT = 51


@dataclass(frozen=True, eq=False)
class FoundWire:
    """A wire line that was found.

    Attributes:
        line: points from the inner to the outer end.
        guessed: share of its length where the scan shows no crease, or where a rigid wire does not lie in it.
        hollow: mean concavity along it: how plain the crease is.
    """

    line: Float[np.ndarray, "k 3"]
    guessed: float
    hollow: float


def trace(surface: Surface, ends: Float[np.ndarray, "2 3"] | None = None) -> FoundWire:
    """The wire line on a surface about a breast, in the breast frame (see above).

    Args:
        surface: the points about the apex.
        ends: inner and outer end, where they are known. Without them they follow from RISE, ABOVE and TILT.
    """
    surface, hollow = _hollow(surface)
    image = _image(surface.points, hollow)
    drawn, strength = _drawn(image, _place(image, ends))
    start = _lifted(drawn, strength, ends, surface.points, hollow)
    if ends is None and _ashore(surface, start):  # too little of a crease shows to say how the line lies in space
        start = np.column_stack([drawn, smoothed(_front(surface, drawn), np.ones(len(drawn)), STIFF, 0.0)])
    wire = _settled(surface, start, ends, FIRST)
    guessed = guessed_share(surface, wire)
    if ends is None and _astray(surface, wire, start, guessed):
        wire = _settled(surface, start, ends, KEPT)
        if _astray(surface, wire, start, 0.0):
            wire = evenly_spaced(_cut(evenly_spaced(start, 1000), None), STATIONS)
        guessed = guessed_share(surface, wire)
    return FoundWire(evenly_spaced(wire, COUNT), guessed, _plainness(strength))


def guessed_share(surface: Surface, wire: Float[np.ndarray, "k 3"]) -> float:
    """The share of a wire where the surface shows no crease."""
    return float(1 - (folds(surface, wire, WINDOWS[-1])[1] >= PLAIN[0]).mean())


def _astray(surface: Surface, wire: np.ndarray, start: np.ndarray, guessed: float) -> bool:
    """Whether a wire left the place where it was first laid, or the surface."""
    span, away = float(np.linalg.norm(wire[-1] - wire[0])), KDTree(start).query(wire)[0].max()
    wide = span > WIDEST and guessed > UNSHOWN
    return bool(polyline_length(wire) > LONGEST or away > FARTHEST or _ashore(surface, wire) or wide)


def _ashore(surface: Surface, line: np.ndarray) -> bool:
    """Whether a fifth of a line is farther than ASHORE from the surface."""
    return bool(np.quantile(surface.tree.query(line)[0], 0.8) > ASHORE)


def _front(surface: Surface, places: np.ndarray) -> np.ndarray:
    """Heights of the surface at places (k, 2) seen from in front."""
    return surface.points[KDTree(surface.points[:, :2]).query(places)[1], 2]


def _settled(surface: Surface, start: np.ndarray, ends: np.ndarray | None, first: float) -> np.ndarray:
    """The line drawn from where it was first placed to the bottom of the crease, and cut off at its ends.

    Args:
        surface: in the breast's frame, its apex in the origin.
        start: the first placing of the line.
        ends: marked ends that the line keeps; None: it ends where the crease does.
        first: weight of the first placing.
    """
    line = start
    for window in WINDOWS:
        places, plain = folds(surface, line, window)
        counts = np.clip((plain - PLAIN[0]) / PLAIN[1], 0, 1)
        level = settle(surface, line, max(8.0, 3 * surface.spacing))[0]
        bare = LAID * np.clip(1 - 3 * counts, 0, 1) * (np.linalg.norm(level - line, axis=1) < OFF)
        bare *= np.asarray(surface.tree.query(level)[0]) < max(BESIDE, 2 * surface.spacing)
        known, trust = _unmarked(surface, line, counts) if ends is None else (ends, np.full(2, HELD))
        weights = [np.full(len(start), first), counts, bare, trust]
        shown = np.concatenate([start, places, level, known]), np.concatenate(weights)
        line = rim(*shown, held=1) if ends is None else rim(*shown, held=2, flat=FLAT)
    wire = evenly_spaced(_cut(evenly_spaced(line, 1000), ends), STATIONS)
    return wire if ends is None else _through(wire, ends)


def plainness(surface: Surface) -> float:
    """How plain a crease there is below the apex: about `FoundWire.hollow` of the wire that `trace` would find."""
    surface, hollow = _hollow(surface)
    image = _image(surface.points, hollow)
    return _plainness(_drawn(image, _starts(image)[0])[1])


def _hollow(surface: Surface) -> tuple[Surface, np.ndarray]:
    """The part of a surface in which a wire is sought, and its concavity."""
    near = np.linalg.norm(surface.points, axis=1) < HALF
    surface = Surface(surface.points[near], surface.normals[near], surface.spacing)
    return surface, concavity(surface, max(SCALE, 4 * surface.spacing))


def _plainness(strength: np.ndarray) -> float:
    return float(np.clip(strength, 0, DEEPEST).mean())


def laid(found: FoundWire, arc: Float[np.ndarray, "k 2"]) -> FoundWire:
    """A rigid planar wire laid on a crease that was found, as near to it as a rigid motion brings it: first place by
    place from end to end, then by iterated nearest points.

    Args:
        found: the wire line in the crease, in any frame.
        arc: the wire: depth below its chord and place along it, mm.
    """
    crease, flat = evenly_spaced(found.line, 500), np.column_stack([arc, np.zeros(len(arc))])
    tree = KDTree(crease)
    placed = laid_on(flat, evenly_spaced(found.line, len(arc)))
    for _ in range(FITTINGS):
        near = np.asarray(tree.query(placed)[1])
        within = (near > 0) & (near < len(crease) - 1)
        if within.sum() < len(arc) / 2:
            break
        placed = laid_on(flat, crease[near], within)
    within = np.asarray(tree.query(placed)[0]) <= ASTRAY
    return FoundWire(placed, float(1 - (1 - found.guessed) * within.mean()), found.hollow)


def _unmarked(surface: Surface, line: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places on the surface where the ends usually are, and their weights; the last is the outer end's where the crease
    fades. `counts` says how plain the crease is along the line, 0 to 1.
    """
    near = KDTree(line[:, :2]).query(LEGS)[1]
    legs = np.column_stack([LEGS, line[near, 2]])
    places = settle(surface, np.concatenate([legs, usual_ends(line)[1:]]), max(8.0, 3 * surface.spacing))[0]
    last = int(np.linalg.norm(line - _cut(line, None)[-1], axis=1).argmin())
    faded = float(np.clip(1 - counts[int(OUTER_PART * last) : last + 1].mean() / FADED, 0, 1))
    return places, np.array([USUAL, USUAL * (1 - faded), LED * faded])


def _cut(line: np.ndarray, ends: np.ndarray | None) -> np.ndarray:
    """The part between the ends: those given, or where the rules put them."""
    if ends is not None:
        first, last = np.sort(np.asarray(KDTree(line).query(ends)[1]))
        return line[first : max(last, first + 2) + 1]
    height = line @ BODY_UP
    bottom = lowest(height)
    first, last, span = 0, len(line) - 1, SPAN[0]
    for _ in range(12):
        middle = max(ABOVE, height[bottom] + RISE * span)
        inner = np.flatnonzero(height[:bottom] >= middle - TILT / 2 * span)
        outer = np.flatnonzero(height[bottom:] >= middle + TILT / 2 * span)
        first = int(inner[-1]) if len(inner) else 0
        last = bottom + int(outer[0]) if len(outer) else len(line) - 1
        span = float(np.linalg.norm(line[last] - line[first]))
    return line[first : last + 1]


def concavity(surface: Surface, radius: float, chosen: Int[np.ndarray, " m"] | None = None) -> Float[np.ndarray, " m"]:
    """How hollow the surface is at each point: the height of the mean of the points within `radius` over the middle of
    the inner ones, along the mean normal, over the radius. 0 on a plane, -radius/(4 R) and less on a sphere of radius
    R, positive in a crease; up to about 0.3 in a narrow one.

    Args:
        surface: with outward normals.
        radius: in the unit of the surface, mm.
        chosen: indices of the points that it is wanted at; None: all.
    """
    at = surface.tree if chosen is None else KDTree(surface.points[chosen])
    pairs = at.sparse_distance_matrix(surface.tree, radius, output_type="ndarray")
    values = np.column_stack([surface.points, surface.normals, np.ones(len(surface.points))])

    def sums(kept: np.ndarray | slice) -> np.ndarray:
        """Of the values about each point."""
        i, j = pairs["i"][kept], pairs["j"][kept]
        return sparse.coo_array((np.ones(len(i)), (i, j)), shape=(at.n, len(values))).tocsr() @ values

    within, inner = sums(slice(None)), sums(pairs["v"] < 0.4 * radius)
    normal = within[:, 3:6] / np.maximum(np.linalg.norm(within[:, 3:6], axis=1, keepdims=True), 1e-9)
    offset = within[:, :3] / within[:, 6:] - inner[:, :3] / inner[:, 6:]
    return np.where(within[:, 6] >= 8, (offset * normal).sum(axis=1) / radius, 0.0)


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


def _place(image: np.ndarray, ends: np.ndarray | None) -> np.ndarray:
    """The bow (see `_bows`) of a wire's usual shape where it runs along hollow places best."""
    if ends is not None:
        chord = ends[1, :2] - ends[0, :2]
        span, angle = float(np.linalg.norm(chord)), float(np.degrees(np.arctan2(-chord[0], chord[1])))
        ratios = np.linspace(0.3, 0.75, 46)
        bows = np.array([[*ends[0, :2], span, ratio, angle] for ratio in ratios])
        return bows[_scores(image, bows, prior=0.3).argmax()]
    scale = np.array([10.0, 10.0, 15.0, 0.05, 4.0])
    starts = _starts(image) / scale
    found = scale * minimised(lambda v: -_scores(image, v * scale), starts, xatol=0.01, fatol=1e-6, rounds=400)
    return found[_scores(image, found).argmax()]


def _starts(image: np.ndarray) -> np.ndarray:
    """The REFINED best of many bows drawn from the usual ones, best first."""
    mean, spread = np.array([SPAN, RATIO, TURN, APEX_DOWN, APEX_OUT]).T
    span, ratio, turn, down, out = np.random.default_rng(0).normal(mean, 1.3 * spread, (STARTS, 5)).T
    angle = np.radians(turn)
    x = -np.cos(angle) * down * span + np.sin(angle) * out * span
    y = -np.sin(angle) * down * span - np.cos(angle) * out * span
    bows = np.stack([x, y, np.maximum(span, 80.0), np.maximum(ratio, 0.25), turn], axis=1)
    return bows[np.argsort(-_scores(image, bows), kind="stable")[:REFINED]]


def _bows(bows: np.ndarray, shape: np.ndarray = SHAPE) -> np.ndarray:
    """Points (m, k, 2) of a wire's shape (k, 2) laid in the x-y plane by its inner end, span, height over span and turn
    in degrees (m, 5).
    """
    x, y, span, ratio, turn = bows.T[:, :, None]
    angle = np.radians(turn)
    down, along = shape[:, 0] * ratio * span, shape[:, 1] * span
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([x + c * down - s * along, y + s * down + c * along], axis=-1)


def _unusual(bows: np.ndarray) -> np.ndarray:
    """Squared spreads off the usual."""
    x, y, span, ratio, turn = bows.T
    angle = np.radians(turn)
    down = -x * np.cos(angle) - y * np.sin(angle)
    out = x * np.sin(angle) - y * np.cos(angle)
    mean, spread = np.array([SPAN, RATIO, TURN, APEX_DOWN, APEX_OUT]).T
    return (((np.stack([span, ratio, turn, down / span, out / span], axis=1) - mean) / spread) ** 2).sum(axis=1)


def _scores(image: np.ndarray, bows: np.ndarray, prior: float = 1.0) -> np.ndarray:
    return _sample(image, _bows(bows)).mean(axis=1) - prior * PRIOR * _unusual(bows)


def _drawn(image: np.ndarray, bow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shape drawn to the bottom of the hollow: places (STATIONS, 2) and the concavity there."""
    line = evenly_spaced(_bows(bow[None])[0], STATIONS)
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    offsets = np.arange(-REACH, REACH + 0.5, 1.0)
    values = _sample(image, line[:, None] + offsets[:, None] * across[:, None])
    chosen = _smoothest(values - OFF_COST * (offsets / REACH) ** 2)
    strength = values[np.arange(STATIONS), chosen]
    weight = np.where(strength >= HOLLOW, np.clip(strength, 0, DEEPEST) / DEEPEST, 0.0)
    offset = smoothed(offsets[chosen], weight, 30.0, 1e-2)
    return line + offset[:, None] * across, strength


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
    return np.column_stack([line, level + smoothed(height - level, weight, 30.0, 1e-2)])


def _through(wire: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The wire moved so that it runs from end to end: by all of the gap at the ends, by less and less away from
    them.
    """
    share = np.linspace(0, 1, len(wire))[:, None]
    fade = 0.2
    first, last = np.clip(1 - share / fade, 0, 1) ** 2, np.clip(1 - (1 - share) / fade, 0, 1) ** 2
    return wire + first * (ends[0] - wire[0]) + last * (ends[1] - wire[-1])
