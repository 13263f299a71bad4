"""A simulated structured-light scanner: what cameras see of a mesh, with noise, strays, holes and shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from brafit.cloud.mesh import sample_faces
from brafit.cloud.open3d_runtime import open3d

DISTANCE = 1100.0
"""Of the cameras from the middle of the body, mm."""
STEEPEST = 0.15
"""Least cosine between a surface's normal and the way to the camera at which it is still measured."""
HOLE_RADIUS = (8.0, 20.0)
STRAY = 0.35
"""Stray points fill the mesh's box, made larger by this share of its size on each side."""


@dataclass(frozen=True)
class Scanner:
    """Cameras and defects.

    Attributes:
        cameras: directions to them from the middle of the body (x left, y up, z front).
        points: points of a scan.
        noise: standard deviation of the noise, mm.
        outliers: share of stray points.
        holes: number of round holes.
    """

    cameras: Float[np.ndarray, "c 3"]
    points: int = 60_000
    noise: float = 0.3
    outliers: float = 0.01
    holes: int = 0

    @staticmethod
    def directions(above: float, below: float) -> Float[np.ndarray, "c 3"]:
        """Six directions round the body, from above and, if it is not 0, from `below` as well (tangents of angles)."""
        angle = np.arange(6) * np.pi / 3 + np.pi / 6
        ring = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
        heights = np.array([above, -below] if below else [above])
        return (ring + heights[:, None, None] * np.array([0.0, 1.0, 0.0])).reshape(-1, 3)


def simulate(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    scanner: Scanner,
    generator: np.random.Generator,
) -> Float[np.ndarray, "n 3"]:
    """A scan of a mesh (mm): evenly sampled, only what a camera sees, with the scanner's defects, shuffled."""
    dense = 2 * scanner.points
    points = sample_faces(vertices, faces, dense)
    points = points[seen(points, vertices, faces, scanner.cameras)]
    points = points[~holes(points, scanner.holes, generator)]
    strays = round(scanner.outliers * scanner.points)
    kept = generator.permutation(len(points))[: scanner.points - strays]
    measured = points[kept] + generator.normal(0, scanner.noise, (len(kept), 3))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    wide = STRAY * (high - low)
    stray = generator.uniform(low - wide, high + wide, (strays, 3))
    return generator.permutation(np.concatenate([measured, stray]))


def seen(
    points: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    cameras: Float[np.ndarray, "c 3"],
) -> Bool[np.ndarray, " n"]:
    """Which points of a mesh's surface at least one camera sees: nothing in the way, and not too slantwise.

    Args:
        points: on the mesh.
        vertices: of the mesh, mm.
        faces: corners of its triangles.
        cameras: directions to them from the middle of the mesh; any length.
    """
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(faces, dtype=np.uint32)),
    )
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    visible = np.zeros(len(points), dtype=bool)
    for direction in cameras:
        camera = centre + DISTANCE * direction / np.linalg.norm(direction)
        way = points - camera
        rays = np.concatenate([np.broadcast_to(camera, way.shape), way], axis=1).astype(np.float32)
        hit = scene.cast_rays(o3d.core.Tensor(rays))
        # The ray reaches the point at 1; a hit clearly before it is something in the way.
        free = hit["t_hit"].numpy() > 1 - 1.0 / DISTANCE
        normal = hit["primitive_normals"].numpy()
        slant = np.abs((normal * way).sum(axis=1)) / np.linalg.norm(way, axis=1)
        visible |= free & (slant > STEEPEST)
    return visible


def holes(points: Float[np.ndarray, "n 3"], count: int, generator: np.random.Generator) -> Bool[np.ndarray, " n"]:
    """Mask of the points in `count` round holes about points of the cloud, of random radius."""
    gone = np.zeros(len(points), dtype=bool)
    for centre in points[generator.integers(0, len(points), count)]:
        gone |= np.linalg.norm(points - centre, axis=1) < generator.uniform(*HOLE_RADIUS)
    return gone
