"""Meshes: PLY, OBJ, STL, OFF and glTF, read each by its own module and sampled evenly by area."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from brafit.cloud.gltf import read_gltf
from brafit.cloud.obj import read_obj
from brafit.cloud.off import read_off
from brafit.cloud.ply import read_ply
from brafit.cloud.polygons import Mesh
from brafit.cloud.stl import read_stl

READERS: dict[str, Callable[[Path], Mesh]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
}
"""What reads the files of an extension."""
MESH_FORMATS = frozenset(READERS)
FLAG = "inside"
"""A column of the vertices that only a cloud has; with it a mesh counts as one."""
ABSURD = 1e9
"""A coordinate beyond this is no measurement in any unit: it counts as not finite."""
_PLASTIC = 1.3247179572447460
"""The plastic number p: (k/p, k/p^2) mod 1 fills the unit square most evenly (Roberts' R2 sequence)."""


def read_mesh(path: Path, count: int) -> dict[str, np.ndarray]:
    """Points of a mesh file.

    Args:
        path: the extension says how it is read, see `READERS`.
        count: points to sample on its faces; a file without faces gives its vertices and what it says of each.

    Returns:
        positions; where there are faces also `vertices` and `faces`, the numbers of the mesh's vertices and triangles.

    Raises:
        RefusedError: the file is whole, but of a kind that is not read.
        ValueError: with a short reason, if the file is damaged or holds no usable surface.
        OSError: the file cannot be read.
    """
    mesh = READERS[path.suffix.lower()](path)
    if not len(mesh.triangles) or FLAG in mesh.columns:
        return {"positions": mesh.vertices, **mesh.columns}
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[mesh.triangles] = True
    lost = used & ~(np.abs(mesh.vertices) < ABSURD).all(axis=1)
    if lost.any():
        raise ValueError(f"{lost.sum()} of {used.sum()} vertices of its faces are NaN, infinite or absurdly large")
    return {
        "positions": sample_faces(mesh.vertices, mesh.triangles, count),
        "vertices": np.array([len(mesh.vertices)]),
        "faces": np.array([len(mesh.triangles)]),
    }


def sample_faces(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], count: int
) -> Float[np.ndarray, "count 3"]:
    """`count` points spread evenly by area over a mesh; always the same ones.

    Every face gets its share to within one point (equal steps along the running sum of areas). Within the faces the
    points follow Roberts' R2 sequence, folded from the unit square into the triangle.

    Args:
        vertices: positions, in any unit.
        faces: corners of triangles, as rows of `vertices`.
        count: as many points as this.

    Raises:
        ValueError: the faces have no area.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    running = np.cumsum(area)
    if not (np.isfinite(running[-1]) and running[-1] > 0):
        raise ValueError("its faces have no area")
    steps = (np.arange(count) + 0.5) / count * running[-1]
    face = np.minimum(np.searchsorted(running, steps), len(faces) - 1)
    k = np.arange(1, count + 1)
    u, v = (k / _PLASTIC) % 1.0, (k / _PLASTIC**2) % 1.0
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u)[:, None], np.where(beyond, 1 - v, v)[:, None]
    return a[face] + u * (b - a)[face] + v * (c - a)[face]
