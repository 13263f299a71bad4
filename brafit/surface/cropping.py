"""The breast cut out of a torso: along the surface, by the closed curve of wire and neckline.

Points near the curve are told inside from outside by their normals; every other point goes with the nearest of these,
measured along the surface. So a breast that hangs over its wire is kept whole, and the belly behind it is not taken.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from brafit.geometry.polyline import evenly_spaced
from brafit.surface.normals import Surface, links, nearest_source

COLLAR = 14.0
"""Points within this distance of the curve (mm) are told apart directly."""
CONFIDENCE = 0.35
"""Least absolute value of the sine that decides on which side a point of the collar lies."""
DOWN = np.radians(14.5)
"""The direction that the planes of 14 given necklines share lies so far below the normal of the wire's plane, within
6 degrees."""


def crop(surface: Surface, curve: Float[np.ndarray, "k 3"]) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which points lie within a closed curve on the surface, and which could not be reached along it.

    Near the curve the surface is one or two sheets that start there. Round the curve's tangent tau, free space lies
    between the breast's sheet and the other one, and outward normals look into it: at a point p with normal n, whose
    nearest place on the curve is c, the sign of n . (tau x (p - c)) says to which of the two it belongs. tau runs so
    that the inside is to the left of it as seen from in front.

    Args:
        surface: with outward normals; mm.
        curve: closed (the last point is joined to the first), about the breast; either way round.

    Returns:
        inside; unreached: neither near the curve nor linked, over a third of its length at most, to a point that is.
    """
    inside, reached = np.zeros((2, len(surface.points)), dtype=bool)
    # No place of a breast is farther from its edge than half the curve's length over pi, and by far.
    segments = np.linalg.norm(np.diff(curve, axis=0, append=curve[:1]), axis=1)
    size, collar = float(segments.sum()), max(COLLAR, 3 * surface.spacing)
    away = KDTree(curve).query(surface.points, distance_upper_bound=size / 3 + collar + segments.max())[0]
    curve = _anticlockwise(curve, surface, away)
    about = np.flatnonzero(away < collar + segments.max())
    distance, sine = _side_of(surface.points[about], surface.normals[about], curve)
    sure = (distance < collar) & (np.abs(sine) > CONFIDENCE)
    if sure.any():
        side = np.zeros(len(surface.points))
        side[about] = sine
        # Ways that are short enough lead over near places only.
        near = np.flatnonzero(np.isfinite(away))
        sources = np.searchsorted(near, about[sure])
        _, origin = nearest_source(links(surface)[near][:, near], sources, size / 3)
        reached[near] = origin >= 0
        inside[near] = reached[near] & (side[near[np.maximum(origin, 0)]] > 0)
    return inside, ~reached


def neckline_over(
    surface: Surface,
    inner: Float[np.ndarray, "3"],
    strap: Float[np.ndarray, "3"],
    outer: Float[np.ndarray, "3"],
    front: Float[np.ndarray, "3"],
    count: int = 21,
) -> Float[np.ndarray, "m 3"]:
    """A neckline where none is given: from the inner end by the strap point to the outer end.

    Each half is the section of the surface with the plane that holds the two points and the direction `front`. In 14
    breasts the given necklines are such sections, to a thousandth of a millimetre.

    Args:
        surface: about the breast, mm.
        inner: the wire's inner end.
        strap: where the strap is.
        outer: the wire's outer end.
        front: where the breast looks to, see `facing`.
        count: points of each half.
    """
    # A torso that is closed at the back can have all normals inwards: those at the three places say which way.
    near = np.asarray(surface.tree.query(np.stack([inner, strap, outer]), k=min(20, len(surface.points)))[1])
    if np.median(surface.normals[near.ravel()] @ front) < 0:
        surface = Surface(surface.points, -surface.normals, surface.spacing)
    halves = [_section(surface, a, b, front, count) for a, b in ((inner, strap), (strap, outer))]
    return np.concatenate([halves[0], halves[1][1:]])


def facing(wire: Float[np.ndarray, "k 3"], front: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Where a breast looks to: the normal of the wire's plane, turned down by DOWN.

    Args:
        wire: the wire line, in any frame.
        front: the side of the wire on which the breast is.
    """
    along = (wire[-1] - wire[0]) / np.linalg.norm(wire[-1] - wire[0])
    centred = wire - wire.mean(axis=0)
    normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    normal = normal - (normal @ along) * along
    normal /= np.linalg.norm(normal) * np.sign(normal @ front)
    down = np.cross(along, normal)
    down *= np.sign(down @ (wire.mean(axis=0) - (wire[0] + wire[-1]) / 2))
    return np.cos(DOWN) * normal + np.sin(DOWN) * down


def _section(surface: Surface, a: np.ndarray, b: np.ndarray, front: np.ndarray, count: int) -> np.ndarray:
    chord = (b - a) / np.linalg.norm(b - a)
    up = front - (front @ chord) * chord
    up /= np.linalg.norm(up)
    radius = max(2.5 * surface.spacing, 4.0)
    facing = surface.normals @ up > 0.1
    points, normals = surface.points[facing], surface.normals[facing]
    away = points - a
    aside, height = away @ np.cross(up, chord), away @ up
    strip = (np.abs(aside) < radius) & (np.abs(height) < np.linalg.norm(b - a))
    along, aside, height, normals = (away @ chord)[strip], aside[strip], height[strip], normals[strip]
    places = np.linspace(0.0, float(np.linalg.norm(b - a)), count)
    heights = np.full(count, np.nan)
    heights[[0, -1]] = 0.0
    for i in range(1, count - 1):
        near = np.hypot(along - places[i], aside) < radius
        if near.sum() >= 4:
            # Of several sheets on the way out the foremost; then along each point's own plane to the ray.
            near &= height > height[near].max() - 2 * radius
            slope = normals[near] @ np.stack([chord, np.cross(up, chord)], axis=1)
            shift = np.stack([along[near] - places[i], aside[near]], axis=1)
            at_ray = height[near] + (slope * shift).sum(axis=1) / (normals[near] @ up)
            heights[i] = np.median(at_ray)
    known = np.isfinite(heights)
    heights = np.interp(places, places[known], heights[known])
    return evenly_spaced(a + places[:, None] * chord + heights[:, None] * up, count)


def _anticlockwise(curve: np.ndarray, surface: Surface, away: np.ndarray) -> np.ndarray:
    """The curve with its inside to the left, seen against the mean normal of the surface about it (`away`: the points'
    distances from the curve's corners).
    """
    closed = np.append(curve, curve[:1], axis=0)
    area = 0.5 * np.cross(closed[:-1] - curve[0], closed[1:] - curve[0]).sum(axis=0)
    near = away < np.linalg.norm(np.ptp(curve, axis=0)) / 3
    front = surface.normals[near].mean(axis=0) if near.any() else surface.normals.mean(axis=0)
    return curve if area @ front >= 0 else curve[::-1].copy()


def _side_of(points: np.ndarray, normals: np.ndarray, curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of each point from the curve, and n . (tau x (p - c)) over that distance."""
    start, end = curve, np.roll(curve, -1, axis=0)
    length = np.linalg.norm(end - start, axis=1)
    kept = length > 1e-9
    start, end, length = start[kept], end[kept], length[kept]
    tangent = (end - start) / length[:, None]
    best = np.full(len(points), np.inf)
    offset = np.zeros_like(points)
    tau = np.zeros_like(points)
    for k in range(len(start)):
        along = np.clip((points - start[k]) @ tangent[k], 0.0, length[k])
        gap = points - start[k] - along[:, None] * tangent[k]
        square = (gap**2).sum(axis=1)
        nearer = square < best
        best[nearer], offset[nearer] = square[nearer], gap[nearer]
        # At a corner both segments count; elsewhere the sum is the segment's own tangent, nearly.
        corner = np.where(along <= 0, k - 1, np.where(along >= length[k], (k + 1) % len(start), k))
        tau[nearer] = (tangent[k] + tangent[corner])[nearer]
    distance = np.sqrt(best)
    size = np.maximum(distance * np.linalg.norm(tau, axis=1), 1e-9)
    return distance, (normals * np.cross(tau, offset)).sum(axis=1) / size
