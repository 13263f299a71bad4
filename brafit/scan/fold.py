"""The bottom of a crease, found in sections across it, and the smooth line through what was found.

A section shows two sheets, chest and breast, that meet in the crease. The line runs where the section lies deepest
against the direction to which the two look: the middle of their mean normals. Along the crease these places are held
together by what wires are like: nearly flat and nearly round.

The frame is that of `brafit.scan.crease`: x down along the chest, y outwards, z out of the chest.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from brafit.scan.surface import Surface

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
"""Of the smoothing along the line, and with what weight it is drawn to the circle."""
STRAY = 2.5
"""A place so far (mm) from the line counts a quarter."""
RADIUS = (69.0, 8.0)
"""Radius of the circle that fits a wire, mm: mean and spread of 14."""
LEVEL = 30.0
"""Millimetres by which a wire's height may change over its width for what counts as much as a millimetre off it."""


def folds(
    surface: Surface, line: Float[np.ndarray, "k 3"], window: float
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """The bottom of the crease near each place of a line that runs along it.

    Args:
        window: how far it is sought to either side, mm.

    Returns:
        places; strengths: how steeply the section rises to both sides, the smaller of the two (0: a plane, 1: a right
        angle between the sheets). Where there are too few points the place itself, with strength 0.
    """
    places, strengths = line.copy(), np.zeros(len(line))
    tangents = _unit(np.gradient(line, axis=0))
    for k, near in enumerate(surface.tree.query_ball_point(line, REACH)):
        away, normals = surface.points[near] - line[k], surface.normals[near]
        kept = np.abs(away @ tangents[k]) < SLAB
        if kept.sum() >= 16:
            move, strengths[k] = _bottom(away[kept], normals[kept], tangents[k], window)
            places[k] += move
    return places, strengths


def _bottom(away: np.ndarray, normals: np.ndarray, tangent: np.ndarray, window: float) -> tuple[np.ndarray, float]:
    """Where a section lies deepest, and how steeply it rises to both sides."""

    def across(direction: np.ndarray) -> np.ndarray:
        return _unit(direction - (direction @ tangent) * tangent)

    opening = across(normals.mean(axis=0))
    for _ in range(3):  # the middle of both sheets' normals, however many points each has
        place = away @ np.cross(tangent, opening)
        sides = (place > 1.5, place < -1.5)
        if min(side.sum() for side in sides) < 4:
            return np.zeros(3), 0.0
        chest, breast = (_unit(normals[side].mean(axis=0)) for side in sides)
        opening = across(CHEST * chest + breast)
    along = np.cross(tangent, opening)
    grid = np.arange(-REACH + 2, REACH - 1.9)
    height, known = _averaged(away @ along, away @ opening, grid)
    depth = np.where(known & (np.abs(grid) <= window), height, np.inf)
    at = int(depth.argmin())
    if not np.isfinite(depth[at]) or not known[max(at - SHORE, 0) : at + SHORE + 1].all():
        return np.zeros(3), 0.0  # the deepest place is the shore of a hole: the bottom was not seen
    place, low = grid[at], height[at]
    if 0 < at < len(grid) - 1 and known[at - 1] and known[at + 1]:
        bend = height[at - 1] - 2 * low + height[at + 1]
        place = place + np.clip((height[at - 1] - height[at + 1]) / 2 / max(bend, 1e-3), -0.5, 0.5)
    slopes, crossings = [], []
    for sign in (1.0, -1.0):
        sheet = known & (sign * (grid - place) > NEAR) & (sign * (grid - place) < FAR)
        if sheet.sum() < 3:
            return np.zeros(3), 0.0
        slope, level = np.polyfit(grid[sheet] - place, height[sheet], 1)
        slopes.append(sign * slope)
        crossings.append((slope, level))
    strength = float(min(slopes))
    (first, a), (second, b) = crossings
    share = np.clip((strength - SHARP[0]) / (SHARP[1] - SHARP[0]), 0.0, 1.0)
    if share > 0:
        meet = np.clip((b - a) / (first - second), -NEAR, NEAR)
        # The bell raises the bottom of a V by so much; a deeper meeting point belongs to a round crease.
        filled = BAND * np.sqrt(2 / np.pi) * (abs(first) + abs(second)) / 2
        place, low = place + share * meet, low + share * np.clip(a + first * meet - low, -filled, 0.0)
    return place * along + low * opening, strength


def _averaged(place: np.ndarray, height: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights over a grid by local lines, and where there are points enough."""
    weight = np.exp(-0.5 * ((place - grid[:, None]) / BAND) ** 2)
    total = weight.sum(axis=1)
    safe = np.maximum(total, 1e-9)
    mean, level = (weight * place).sum(axis=1) / safe, (weight * height).sum(axis=1) / safe
    spread = (weight * place**2).sum(axis=1) / safe - mean**2
    slope = ((weight * place * height).sum(axis=1) / safe - mean * level) / np.maximum(spread, 0.3)
    return level + slope * (grid - mean), total > 2


def rim(
    places: Float[np.ndarray, "k 3"], weights: Float[np.ndarray, " k"], held: int = 0, flat: float = TOWARDS
) -> Float[np.ndarray, "m 3"]:
    """The smooth line through weighted places, at ANGLES round the circle that fits them best, seen from in front.

    The places' distances from the circle and heights over a plane are smoothed (Whittaker); places off the line lose
    weight. Beyond the places the line goes on as it was, seen from the circle's centre.

    Args:
        held: so many of the last places keep their weight.
        flat: with what weight the line is drawn to the plane.
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
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        centre, radius = centre + step[:2], radius + float(step[2])
    return centre, radius


def smoothed(
    values: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], stiffness: float, towards: float
) -> Float[np.ndarray, " n"]:
    """Whittaker's smoother: near the weighted values, second differences small, weakly drawn `towards` zero."""
    second = np.diff(np.eye(len(values)), 2, axis=0)
    system = np.diag(weight + towards) + stiffness * second.T @ second
    return np.linalg.solve(system, weight * values)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
