"""The bust point: where on a body a breast sticks out farthest, as the surface there and its wire show it.

Rules and figures are those of 14 breasts (parametric bodies, a mean of standing scans, one person).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from brafit.anatomy.body import Body, shoulders
from brafit.anatomy.wire_detection import concavity
from brafit.cloud.read import MIN_POINTS
from brafit.geometry.polyline import evenly_spaced
from brafit.surface.cleaning import tidy
from brafit.surface.normals import Surface, settle, surface_of
from brafit.surface.thinning import averaged

COARSE, DENSE = 6_000, 24_000
"""Points about a breast that are used, at most: in the first, rough pass, and in the final one."""
BREAST_OUT = (25.0, 160.0)
"""Distance of an apex from the mirror plane, mm."""
AROUND, NEAR = (45.0, 5.0), 25.0
"""Distance (mm, give or take) of the ring over which an apex's height is measured, and of the points that say what is
outwards."""
CAP, ABOUT = 2.0, 35.0
"""Thickness of the cap of foremost points that an apex is the middle of, and the radius about it that is taken (mm)."""
AREOLA, SCALE, CONVEX, LEAST = 10.0, 11.0, 0.03, 0.0005
"""About the foremost place: how wide convexity counts (mm, standard deviation), the radius (mm) it is measured in, from
what on it counts, and as what every point counts, so that a flat place keeps to the middle."""
SIDEWAYS, RAISED, NUDGE = (0.21, 3.4), (0.15, 57.0), 6.0
"""Where the wire says that the bust point lies, seen along PROTRUDING: this share of the way to a place so far (mm)
inwards of the wire's middle; higher by this share of the breast's depth over so much (mm); at most NUDGE mm in all.
Each of 14 breasts by the others' rule: within 5.7 mm of the given point, 3.1 RMS; without the wire, 8.0 and 3.4."""
BELOW_SHOULDERS = 350.0
"""No apex lies farther below the shoulders, mm."""
LEVELS = 60.0
"""Largest difference in height (mm) of the two apexes; with half a breast beside a whole one it was 25."""
CELL, PROMINENCE = 6.0, 2.0
"""Steps of the height (mm) in which the foremost place is sought, and by how much (mm) it is before those above and
below it."""


def about(points: np.ndarray, place: np.ndarray, outward: np.ndarray, dense: int, radius: float = 190.0) -> Surface:
    """The surface within a radius of a place, in the scan's frame; tidied, but for a first look (COARSE).

    Args:
        points: of the torso, (n, 3), mm.
        place: the middle of what is taken.
        outward: a direction out of the body there; normals are turned to its side.
        dense: more points than this are averaged in voxels first; COARSE: without tidying.
        radius: mm.
    """
    near = points[np.linalg.norm(points - place, axis=1) < radius]
    if dense == COARSE and len(near) > MIN_POINTS:
        return surface_of(averaged(near, dense), outward)
    surface = tidy(near, dense=dense).surface
    if surface is None:
        return Surface(near, np.tile(outward, (len(near), 1)), 1.0)
    turned = np.sign(np.median(surface.normals @ outward) or 1.0)
    return Surface(surface.points, turned * surface.normals, surface.spacing)


def foremost(points: np.ndarray, body: Body, side: str, level: float | None = None) -> np.ndarray:
    """About where a breast sticks out farthest: the foremost place that has lower ones both above and below it.

    Args:
        points: of the trunk, (n, 3), mm, in the scan's frame.
        body: axes of the torso.
        side: the wearer's `left` or `right`.
        level: its height, where that is known to LEVELS mm.
    """
    out, height = body.away(points, side), points @ body.up
    trunk = np.abs(out) < BREAST_OUT[1]
    low, high = np.quantile(height[trunk], (0.02, 0.98))
    # Within the middle of the height of a torso; of a whole body, so far below the shoulders.
    low, high = max(low + 0.25 * (high - low), shoulders(body, points) - BELOW_SHOULDERS), float(high)
    if level is not None:
        low, high = max(low, level - LEVELS), min(high, level + LEVELS)
    zone = (out > BREAST_OUT[0]) & (out < BREAST_OUT[1]) & (height > low) & (height < high)
    if not zone.any():
        zone = trunk
    candidate, height = points[zone], height[zone]
    reach = candidate @ body.protruding(side)
    cell = ((height - height.min()) / CELL).astype(int)
    profile = np.full(cell.max() + 1, -np.inf)
    np.maximum.at(profile, cell, reach)
    from scipy.signal import find_peaks  # takes long to import, and marked scans do without

    peaks = find_peaks(ndimage.median_filter(profile, 3, mode="nearest"), prominence=PROMINENCE)[0]
    if len(peaks):  # not what goes on beyond the zone, as a belly does
        near = np.abs(cell - peaks[profile[peaks].argmax()]) <= 4
        candidate, reach = candidate[near], reach[near]
    return np.median(candidate[reach > np.quantile(reach, 0.999) - CAP], axis=0)


def apex_on(
    points: np.ndarray, body: Body, side: str, dense: int = DENSE, level: float | None = None
) -> tuple[np.ndarray, Surface]:
    """The bust point as the surface about it shows it: the middle of what is convex about the foremost place.

    Args:
        points: of the trunk, (n, 3), mm, in the scan's frame.
        body: axes of the torso.
        side: the wearer's `left` or `right`.
        dense: as in `about`.
        level: the breast's height, where that is known to LEVELS mm.
    """
    direction = body.protruding(side)
    apex = foremost(points, body, side, level)
    surface = about(points, apex, body.front, dense)
    reach = surface.points @ direction

    def nearby(apex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points near the apex, and the area that each stands for."""
        near = np.flatnonzero(((surface.points - apex) ** 2).sum(axis=1) < ABOUT**2)
        crowd = surface.tree.query_ball_point(surface.points[near], max(8.0, 3 * surface.spacing), return_length=True)
        return near, 1 / np.maximum(crowd, 4)

    near, area = nearby(apex)
    for _ in range(3):
        if len(near) < 20:
            break
        behind = np.clip(np.quantile(reach[near], 0.99) - reach[near], 0, None)
        apex = np.average(surface.points[near], axis=0, weights=area * np.exp(-((behind / CAP) ** 2)))
        near, area = nearby(apex)
    if len(near):
        convex = -concavity(surface, max(SCALE, 3 * surface.spacing), near)
        away = np.linalg.norm(surface.points[near] - apex, axis=1) / AREOLA
        weights = area * np.clip(convex - CONVEX, LEAST, None) * np.exp(-(away**2) / 2)
        apex = np.average(surface.points[near], axis=0, weights=weights)
    return settle(surface, apex[None], max(6.0, 2 * surface.spacing))[0][0], surface


def mound(surface: Surface, apex: Float[np.ndarray, "3"]) -> float:
    """How high (mm) a place lies over those about it, AROUND mm away from it: the mean of the sides, along the normal
    there. On a sphere of radius R, R - sqrt(R^2 - AROUND^2) and more; on a chest as round as a barrel 3 to 5.

    Args:
        surface: about the place, mm.
        apex: the place, on the surface.
    """
    away = surface.points - apex
    distance = np.linalg.norm(away, axis=1)
    normal = surface.normals[distance < NEAR].sum(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-9)
    ring = (np.abs(distance - AROUND[0]) < AROUND[1]) & (surface.normals @ normal > 0)
    if not ring.any():
        return 0.0
    return float(-(away[ring] @ normal).mean())


def nudged(surface: Surface, apex: np.ndarray, wire: np.ndarray, body: Body, side: str) -> np.ndarray:
    """The bust point as the surface shows it, and as the wire does (see `SIDEWAYS`)."""
    outwards, direction = body.outwards(side)[0], body.protruding(side)
    outwards = outwards - (outwards @ direction) * direction
    outwards /= np.linalg.norm(outwards)
    up = np.cross(direction, outwards)
    up *= np.sign(up @ body.up)
    away = evenly_spaced(wire, 200).mean(axis=0) - apex
    across = SIDEWAYS[0] * (away @ outwards - SIDEWAYS[1])
    rise = RAISED[0] * (-away @ direction - RAISED[1])
    step = across * outwards + rise * up
    apex = apex + step * min(1.0, NUDGE / max(float(np.linalg.norm(step)), 1e-9))
    return settle(surface, apex[None], max(6.0, 2 * surface.spacing))[0][0]
