"""The bottom of a crease, found in sections across it, and the smooth line through what was found.

A section shows two sheets, chest and breast, that meet in the crease. The line runs where the section lies deepest
against the direction to which the two look: the middle of their mean normals. Along the crease these places are held
together by what wires are like: nearly flat and nearly round.

The frame is that of `brafit.anatomy.wire_detection`: x down along the chest, y outwards, z out of the chest.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from brafit.surface.normals import Surface

REACH, SLAB = 16.0, 6.0
"""Half width (mm) of a section, and how far along the crease its points come from."""
BAND = 3.0
"""Width (mm) of the bell with which a section's points are averaged."""
NEAR, FAR = 5.0, 11.0
"""A sheet is judged by its points between these distances (mm) from the crease."""
SHORE = 3
"""Millimetres to both sides of the bottom in which there must be points."""
CHEST = 1.2
"""Weight of the chest's normal against the breast's: a wire lies on the chest where the crease is round."""
SHARP = (0.5, 1.0)
"""Between these strengths a crease goes over from round, where it is the averaged surface itself, to sharp, where
averaging fills it and the sheets are prolonged until they meet."""
ANGLES = np.radians(np.arange(-125.0, 126.0, 3.5))
"""Where the line is known, round its circle's centre, from the bottom towards the outer end."""
STIFFNESS, TOWARDS = 30.0, 0.0005
"""Weights in `rim`: of the smoothness along the line, and of its distance from the circle."""
STRAY = 2.5
"""At this distance (mm) from the line a place has a quarter of its weight."""
RADIUS = (69.0, 8.0)
"""Radius of the circle that fits a wire, mm: mean and spread of 14."""
LEVEL = 30.0
"""Millimetres by which a wire's height may change over its width for what counts as much as a millimetre off it."""


def folds(
    surface: Surface, line: Float[np.ndarray, "k 3"], window: float
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """The bottom of the crease near each place of a line that runs along it.

    Args:
        surface: with outward normals, mm.
        line: about where the crease runs, within `window` of it.
        window: how far it is sought to either side, mm.

    Returns:
        places; strengths: how steeply the section rises to both sides, the smaller of the two (0: a plane, 1: a right
        angle between the sheets). Where there are too few points the place itself, with strength 0.
    """
    places, strengths = line.copy(), np.zeros(len(line))
    tangents = _unit(np.gradient(line, axis=0))
    sections = []
    for k, near in enumerate(surface.tree.query_ball_point(line, REACH)):
        away = surface.points[near] - line[k]
        kept = np.abs(away @ tangents[k]) < SLAB
        if kept.sum() >= 16:
            sections.append((k, away[kept], surface.normals[near][kept]))
    if sections:
        stations = np.array([k for k, _, _ in sections])
        moves, strengths[stations] = _bottoms(sections, tangents[stations], window)
        places[stations] += moves
    return places, strengths


def _bottoms(
    sections: list[tuple[int, np.ndarray, np.ndarray]], tangents: Float[np.ndarray, "s 3"], window: float
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Where sections lie deepest, and how steeply they rise to both sides."""
    away, normals = (np.concatenate([section[i] for section in sections]) for i in (1, 2))
    sizes = np.array([len(section[1]) for section in sections])
    section, starts = np.repeat(np.arange(len(sizes)), sizes), np.cumsum(sizes) - sizes

    def across(direction: np.ndarray) -> np.ndarray:
        return _unit(direction - (direction * tangents).sum(axis=1, keepdims=True) * tangents)

    opening = across(np.add.reduceat(normals, starts))
    seen = np.ones(len(sizes), dtype=bool)
    for _ in range(3):  # the middle of both sheets' normals, however many points each has
        place = (away * np.cross(tangents, opening)[section]).sum(axis=1)
        sides = [place > 1.5, place < -1.5]
        for side in sides:
            seen &= np.add.reduceat(side.astype(int), starts) >= 4
        chest, breast = (_unit(np.add.reduceat(normals * side[:, None], starts)) for side in sides)
        opening = across(CHEST * chest + breast)
    along = np.cross(tangents, opening)
    grid = np.arange(-REACH + 2, REACH - 1.9)
    places, heights = ((away * axis[section]).sum(axis=1) for axis in (along, opening))
    split = zip(np.split(places, starts[1:]), np.split(heights, starts[1:]), strict=True)
    height, known = (np.stack(values) for values in zip(*(_averaged(*pair, grid) for pair in split), strict=True))
    depth = np.where(known & (np.abs(grid) <= window), height, np.inf)
    at, row = depth.argmin(axis=1), np.arange(len(sizes))
    seen &= np.isfinite(depth[row, at])
    # A deepest place that is the shore of a hole: the bottom was not seen.
    shore = np.pad(known, ((0, 0), (SHORE, SHORE)), constant_values=True)
    seen &= np.lib.stride_tricks.sliding_window_view(shore, 2 * SHORE + 1, axis=1)[row, at].all(axis=1)
    place, low = grid[at], height[row, at]
    before, after = np.maximum(at - 1, 0), np.minimum(at + 1, len(grid) - 1)
    inner = (at > 0) & (at < len(grid) - 1) & known[row, before] & known[row, after]
    bend = height[row, before] - 2 * low + height[row, after]
    step = (height[row, before] - height[row, after]) / 2 / np.maximum(bend, 1e-3)
    place = place + np.where(inner, np.clip(step, -0.5, 0.5), 0.0)
    offset = grid - place[:, None]
    slopes, levels = [], []
    for sign in (1.0, -1.0):
        sheet = known & (sign * offset > NEAR) & (sign * offset < FAR)
        seen &= sheet.sum(axis=1) >= 3
        slope, level = _lines(offset, height, sheet)
        slopes.append(slope)
        levels.append(level)
    (first, second), (a, b) = slopes, levels
    strength = np.minimum(first, -second)
    share = np.clip((strength - SHARP[0]) / (SHARP[1] - SHARP[0]), 0.0, 1.0)
    meet = np.clip((b - a) / np.where(share > 0, first - second, 1.0), -NEAR, NEAR)
    # The bell raises the bottom of a V by so much; a deeper meeting point belongs to a round crease.
    filled = BAND * np.sqrt(2 / np.pi) * (np.abs(first) + np.abs(second)) / 2
    place, low = place + share * meet, low + share * np.clip(a + first * meet - low, -filled, 0.0)
    move = place[:, None] * along + low[:, None] * opening
    return np.where(seen[:, None], move, 0.0), np.where(seen, strength, 0.0)


def _lines(
    x: Float[np.ndarray, "s g"], y: Float[np.ndarray, "s g"], used: Bool[np.ndarray, "s g"]
) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]:
    """Slope and level of the line through the places used of each row (least squares)."""
    count = np.maximum(used.sum(axis=1), 1)
    x, y = np.where(used, x, 0.0), np.where(used, y, 0.0)
    middle, level = x.sum(axis=1) / count, y.sum(axis=1) / count
    away = np.where(used, x - middle[:, None], 0.0)
    slope = (away * y).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1e-12)
    return slope, level - slope * middle


def _averaged(place: np.ndarray, height: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights over a grid by local lines, and where there are points enough."""
    weight = np.exp(-0.5 * ((place - grid[:, None]) / BAND) ** 2)
    moments = np.stack([np.ones(len(place)), place, height, place**2, place * height], axis=1)
    total, *sums = (weight @ moments).T
    mean, level, square, product = np.stack(sums) / np.maximum(total, 1e-9)
    slope = (product - mean * level) / np.maximum(square - mean**2, 0.3)
    return level + slope * (grid - mean), total > 2


def rim(
    places: Float[np.ndarray, "k 3"], weights: Float[np.ndarray, " k"], held: int = 0, flat: float = TOWARDS
) -> Float[np.ndarray, "m 3"]:
    """The smooth line through weighted places, at ANGLES round the circle that fits them best, seen from in front.

    The places' distances from the circle and heights over a plane are smoothed (Whittaker); places off the line lose
    weight. Beyond the places the line goes on as it was, seen from the circle's centre.

    Args:
        places: seen from in front: z towards the viewer.
        weights: how far each place is trusted.
        held: the last `held` places keep their full weight.
        flat: weight of the line's distance from the plane.
    """
    trust = np.ones(len(places))
    line = places
    for _ in range(5):
        weight = weights * trust
        plane = _plane(places, weight)
        centre, radius = _circle(places[:, :2], weight)
        arm = places[:, :2] - centre
        angle = np.arctan2(arm[:, 1], arm[:, 0])
        off = np.stack([np.linalg.norm(arm, axis=1) - radius, places[:, 2] - _over(places, plane)], axis=1)
        share = weight * np.clip(1 - np.abs(ANGLES[:, None] - angle) / (ANGLES[1] - ANGLES[0]), 0, None)
        total = share.sum(axis=1)
        values = share @ off / np.maximum(total, 1e-9)[:, None]
        pairs = zip(values.T, (TOWARDS, flat), strict=True)
        smooth = np.stack([smoothed(column, total, STIFFNESS, towards) for column, towards in pairs], axis=1)
        on_line = np.stack([np.interp(angle, ANGLES, column) for column in smooth.T], axis=1)
        trust = 1 / (1 + (np.linalg.norm(off - on_line, axis=1) / STRAY) ** 2) ** 2
        trust[len(places) - held :] = 1.0
        reach = radius + smooth[:, 0]
        round_ = centre + reach[:, None] * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
        line = np.column_stack([round_, _over(round_, plane) + smooth[:, 1]])
    return line


def _plane(places: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """z = a x + b y + c by weighted least squares, weakly held level."""
    system = np.column_stack([places[:, :2], np.ones(len(places))])
    hold = np.diag([LEVEL, LEVEL, 0.0]) * np.sqrt(0.1 * weight.sum())
    rows = np.concatenate([np.sqrt(weight)[:, None] * system, hold])
    return np.linalg.lstsq(rows, np.append(np.sqrt(weight) * places[:, 2], np.zeros(3)), rcond=None)[0]


def _over(places: np.ndarray, plane: np.ndarray) -> np.ndarray:
    return places[:, :2] @ plane[:2] + plane[2]


def _circle(places: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius of the circle of least squared distances, by Gauss-Newton steps from the usual one."""
    root = np.sqrt(weight)
    radius = RADIUS[0]
    centre = np.average(places, axis=0, weights=weight) - np.array([radius / 2, 0.0])
    for _ in range(20):
        arm = places - centre
        length = np.maximum(np.linalg.norm(arm, axis=1), 1e-9)
        jacobian = np.column_stack([arm / length[:, None], np.ones(len(arm))]) * root[:, None]
        jacobian = np.append(jacobian, [[0.0, 0.0, 1 / RADIUS[1]]], axis=0)
        residual = np.append(root * (length - radius), (RADIUS[0] - radius) / RADIUS[1])
        step = np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)  # the last row makes it regular
        centre, radius = centre + step[:2], radius + float(step[2])
        if np.abs(step).max() < 1e-10:
            break
    return centre, radius


def smoothed(
    values: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], stiffness: float, towards: float
) -> Float[np.ndarray, " n"]:
    """Whittaker's smoother: near the weighted values, second differences small, weakly drawn `towards` zero.

    Args:
        values: evenly spaced.
        weight: of each value, 0 for one that is not known.
        stiffness: weight of the squared second differences.
        towards: weight of the squared values themselves.
    """
    second = np.diff(np.eye(len(values)), 2, axis=0)
    system = np.diag(weight + towards) + stiffness * second.T @ second
    return np.linalg.solve(system, weight * values)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
