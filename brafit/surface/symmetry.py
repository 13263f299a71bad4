"""The plane that parts a body's left from its right, from the scan alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from brafit.surface.cleaning import tidy
from brafit.surface.normals import Surface, settle
from brafit.surface.planes import normals_at
from brafit.surface.thinning import distinct

SAMPLE, TRIED = 6000, 1500
"""Points that the plane is fitted with, and those with which each start is tried."""
ROUNDS = 60
PLAIN = 3.0
"""Rms (mm) of a plane that needs no further looking for."""
COMPARED = 500
"""Places at which two surfaces are compared."""
PATCH = 6.0
"""Radius (mm) over which each is averaged there, so that noise does not count."""
SYMMETRIC = 3.0
"""Largest rms (mm) between a body and its mirror image at which one side says something of the other."""
ALIKE, SKETCH, SKETCHED = 0.5, 4500, 0.6
"""Rms (mm) within which a breast and the other one's mirror image are alike (less than scanners err); about how many
points of each are compared, and within how many wire lengths from the middle of the wire they lie."""


@dataclass(frozen=True)
class Mirror:
    """Reflection in the plane {p : normal . p = offset}.

    Attributes:
        normal: unit vector across the plane.
        offset: mm.
        rms: how well the body agrees with its mirror image: root mean square distance of the better 80 % of its
            points from the mirrored body's surface, mm.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    rms: float

    def __call__(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """The mirror images of points."""
        return points - 2 * (points @ self.normal - self.offset)[..., None] * self.normal


def mirror_of(points: Float[np.ndarray, "n 3"]) -> Mirror:
    """The plane of best mirror symmetry of a torso or a body (mm). It goes with the body, and does not depend on the
    order or repetition of the points.

    Started from the three principal axes through the middle, refined by iterated nearest points: the distances from
    the mirrored points to the planes through their nearest neighbours are made least squares over the plane's three
    degrees of freedom, without the worst fifth (an arm held differently, what only one side shows).
    """
    chosen = _along_the_body(points, 4 * SAMPLE)
    tree = KDTree(chosen)
    normals = normals_at(chosen, np.asarray(tree.query(chosen, k=min(12, len(chosen)))[1]))
    moving, some = _strided(chosen, SAMPLE), _strided(chosen, TRIED)
    centre = moving.mean(axis=0)
    axes = np.linalg.eigh(np.cov(moving.T))[1].T

    def tried(directions: np.ndarray) -> list[Mirror]:
        return [_refine(tree, chosen, normals, some, axis, float(axis @ centre), 8) for axis in directions]

    starts = tried(axes)
    if min(start.rms for start in starts) > PLAIN:
        # The frame's own axes as well: many scanners keep to the vertical.
        starts += tried(np.eye(3))
    best = min(starts, key=lambda mirror: mirror.rms)
    return _refine(tree, chosen, normals, moving, best.normal, best.offset, ROUNDS)


def _along_the_body(points: np.ndarray, count: int) -> np.ndarray:
    """About `count` of the distinct points, evenly picked along the body's own longest axis."""
    single = distinct(points)
    centred = single - single.mean(axis=0)
    along = centred @ np.linalg.eigh(np.cov(centred.T))[1][:, 2]
    along = along * (1.0 if (along**3).sum() >= 0 else -1.0)
    return _strided(single[np.argsort(along, kind="stable")], count)


def _strided(points: np.ndarray, count: int) -> np.ndarray:
    return points[np.arange(min(count, len(points))) * len(points) // min(count, len(points))]


def apart(one: Surface, other: Surface, places: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square distance (mm) of two surfaces about places of the first, along its normals; where both have
    data.

    Each surface is the mean plane of its points about a place, so that noise averages out. Infinite if they share less
    than half of the places.

    Args:
        one: with outward normals, mm.
        other: likewise, in the same frame.
        places: of the first surface.
    """
    chosen = places[:: max(1, len(places) // COMPARED)]
    radius = max(PATCH, 3 * max(one.spacing, other.spacing))
    mine, normal = settle(one, chosen, radius)
    its, facing = settle(other, mine, radius)
    near = other.tree.query(chosen)[0] < radius
    seen = near & ((normal * facing).sum(axis=1) > 0.7)
    if not len(chosen) or seen.mean() < 0.5:
        return float("inf")
    return float(np.sqrt(np.mean(((its - mine) * normal).sum(axis=1)[seen] ** 2)))


def breasts_apart(
    one: Float[np.ndarray, "n 3"],
    other: Float[np.ndarray, "m 3"],
    middle: Float[np.ndarray, "3"],
    length: float,
    outliers: float | None = 3.0,
    neighbours: int = 16,
) -> float:
    """Root mean square distance (mm) of a breast and the mirror image of the other, both in a frame whose z leads out
    of the chest; infinite where there are too few points to say.

    Args:
        one: the points about it.
        other: those about the other breast, mirrored.
        middle: of the wire.
        length: of the wire, mm.
        outliers: see `brafit.surface.cleaning.tidy`.
        neighbours: likewise.
    """
    sketches = []
    for cloud in (one, other):
        near = cloud[((cloud - middle) ** 2).sum(axis=1) < (SKETCHED * length) ** 2]
        sketches.append(tidy(near, outliers=outliers, neighbours=neighbours, dense=SKETCH).surface)
    mine, its = sketches
    if mine is None or its is None:
        return np.inf
    return apart(mine, its, mine.points[((mine.points - middle) ** 2).sum(axis=1) < (length / 2) ** 2])


def _refine(
    tree: KDTree,
    points: np.ndarray,
    normals: np.ndarray,
    moving: np.ndarray,
    normal: np.ndarray,
    offset: float,
    rounds: int,
) -> Mirror:
    rms = np.inf
    for _ in range(rounds):
        signed = moving @ normal - offset
        image = moving - 2 * signed[:, None] * normal
        distance, near = (np.asarray(found) for found in tree.query(image))
        kept = distance <= np.quantile(distance, 0.8)
        q, m, p, s = points[near[kept]], normals[near[kept]], moving[kept], signed[kept]
        residual = ((image[kept] - q) * m).sum(axis=1)
        # normal -> normal + a u + b v (u, v across it), offset -> offset + c, in image = p - 2 (normal.p - offset)
        # normal
        u = np.linalg.svd(normal[None])[2][1]
        v = np.cross(normal, u)
        mn = m @ normal
        columns = [-2 * ((p @ w) * mn + s * (m @ w)) for w in (u, v)] + [2 * mn]
        jacobian = np.stack(columns, axis=1)
        step = np.linalg.lstsq(jacobian.T @ jacobian, -jacobian.T @ residual, rcond=None)[0]
        turned = normal + np.clip(step[0], -0.2, 0.2) * u + np.clip(step[1], -0.2, 0.2) * v
        size = float(np.linalg.norm(turned))
        normal, offset = turned / size, float(offset + step[2]) / size
        rms = float(np.sqrt(np.mean(residual**2)))
        if np.abs(step[:2]).max() < 1e-7 and abs(step[2]) < 1e-4:
            break
    return Mirror(normal, offset, rms)
