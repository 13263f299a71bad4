"""Meshes of polygons, and the triangles that fill them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

STRAIGHT = 1e-6
"""Sine of the angle up to which a polygon that turns inward at a corner goes straight on, but for rounding."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """What a file holds, in the file's unit and frame.

    Attributes:
        vertices: positions, all that the file has, finite or not.
        triangles: their vertices; none in a file that is a cloud.
        columns: what else it says of each vertex, by name (`normals`, `inside`), one row a vertex.
    """

    vertices: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "f 3"] = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)


def filled(
    vertices: Float[np.ndarray, "v 3"], corners: Int[np.ndarray, " c"], sizes: Int[np.ndarray, " p"]
) -> Int[np.ndarray, "f 3"]:
    """Triangles that fill polygons, in the order of the polygons.

    A polygon that is convex, seen along its normal, becomes a fan; one that is not has its ears cut off one by one.
    Polygons of fewer than three corners have no area and give none.

    Args:
        vertices: positions, in any unit.
        corners: the vertices of the polygons, one polygon after another.
        sizes: how many corners each polygon has.

    Raises:
        ValueError: a corner is no vertex.
    """
    check_corners(corners, len(vertices))
    starts = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    firsts = np.cumsum(counts) - counts
    triangles = np.empty((int(counts.sum()), 3), dtype=np.int64)
    for size in np.flatnonzero(np.bincount(sizes[sizes > 2])):
        chosen = np.flatnonzero(sizes == size)
        polygons = corners[starts[chosen, None] + np.arange(size)]
        places = firsts[chosen, None] + np.arange(size - 2)
        if size > 3:
            polygons, bent = _fannable(vertices, polygons)
            for k in np.flatnonzero(bent):
                triangles[places[k]] = _without_ears(vertices, polygons[k])
            polygons, places = polygons[~bent], places[~bent]
        hub = np.repeat(polygons[:, :1], size - 2, axis=1)
        triangles[places] = np.stack([hub, polygons[:, 1:-1], polygons[:, 2:]], axis=-1)
    return triangles


def check_corners(corners: Int[np.ndarray, "*shape"], count: int) -> None:
    """Refuse corners that are none of `count` vertices.

    Raises:
        ValueError: there are such corners; names one.
    """
    wrong = corners[(corners < 0) | (corners >= count)]
    if wrong.size:
        raise ValueError(f"a face names vertex {wrong[0]}, counted from 0, of {count}")


def _fannable(
    vertices: Float[np.ndarray, "v 3"], polygons: Int[np.ndarray, "p k"]
) -> tuple[Int[np.ndarray, "p k"], Bool[np.ndarray, " p"]]:
    """Polygons turned so that a fan from their first corner fills them, and which cannot be so turned."""
    places = vertices[polygons]
    with np.errstate(all="ignore"):  # vertices that are not finite are refused later
        ahead = np.roll(places, -1, axis=1) - places
        turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
        normal = np.cross(places - places[:, :1], np.roll(places, -1, axis=1) - places[:, :1]).sum(axis=1)
        sizes = np.linalg.norm(ahead, axis=2)
        least = STRAIGHT * sizes * np.roll(sizes, 1, axis=1) * np.linalg.norm(normal, axis=1)[:, None]
        reflex = (turns * normal[:, None]).sum(axis=2) < -least
    inward = reflex.sum(axis=1)
    turned = polygons.copy()
    quads = inward == 1 if polygons.shape[1] == 4 else np.zeros(len(polygons), dtype=bool)
    order = (reflex[quads].argmax(axis=1)[:, None] + np.arange(polygons.shape[1])) % polygons.shape[1]
    turned[quads] = np.take_along_axis(polygons[quads], order, axis=1)
    return turned, (inward > 0) & ~quads


def _without_ears(vertices: Float[np.ndarray, "v 3"], polygon: Int[np.ndarray, " k"]) -> Int[np.ndarray, "t 3"]:
    """Triangles of a polygon: again and again a corner is cut off that no other corner lies behind.

    Of a polygon that crosses itself, where none can be cut off so, what is left becomes a fan.
    """
    places = vertices[polygon] - vertices[polygon].mean(axis=0)
    normal = np.cross(places, np.roll(places, -1, axis=0)).sum(axis=0)
    flat = np.delete(places, np.abs(normal).argmax(), axis=1)  # seen along the axis nearest to the normal
    if _cross(flat, np.roll(flat, -1, axis=0)).sum() < 0:
        flat = flat * [1, -1]
    left = list(range(len(polygon)))
    triangles = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(flat[left], i)), None)
        if ear is None:
            break
        triangles.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    triangles += [(left[0], left[i], left[i + 1]) for i in range(1, len(left) - 1)]
    return polygon[np.array(triangles)]


def _is_ear(flat: Float[np.ndarray, "k 2"], i: int) -> bool:
    corners = flat[[i - 1, i, (i + 1) % len(flat)]]
    if _cross(corners[1] - corners[0], corners[2] - corners[1]) <= 0:
        return False
    others = np.delete(flat, [i - 1, i, (i + 1) % len(flat)], axis=0)
    sides = np.roll(corners, -1, axis=0) - corners
    within = (_cross(sides, others[:, None] - corners) >= 0).all(axis=1)
    # A corner at the same place as one of the ear's, as where a bridge leads to a hole, is in nobody's way.
    return not (within & (others[:, None] != corners).any(axis=2).all(axis=1)).any()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
