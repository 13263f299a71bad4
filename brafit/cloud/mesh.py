"""Meshes: OBJ, STL, OFF, GLB and PLY with faces, read by trimesh in the readers' own process and sampled evenly."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from brafit.errors import BrafitError

MESH_FORMATS = frozenset({".obj", ".stl", ".off", ".glb"})
_PLASTIC = 1.3247179572447460
"""The plastic number p: (k/p, k/p^2) mod 1 fills the unit square most evenly (Roberts' R2 sequence)."""

USED = 0.5
"""Least share of an OBJ's vertices that its faces use."""
LONG, LONG_SHARE, APART = 10.0, 0.03, 0.02
"""A side of so many times the usual distance between vertices is long; largest share of faces with such sides;
largest share of the area in such faces that share no side with another."""


def read_mesh(path: Path, count: int) -> dict[str, np.ndarray]:
    """Points of a mesh file.

    Args:
        count: points to sample on its faces; a file without faces gives its vertices.

    Returns:
        positions; where there are faces also `faces`, their number.

    Raises:
        ValueError: with a short reason, if the file is damaged or holds no usable surface.
        OSError: the file cannot be read.
        BrafitError: trimesh is missing.
    """
    vertices, faces = _load(path)
    if not len(vertices):
        return {"positions": np.empty((0, 3))}
    if not len(faces):
        return {"positions": vertices}
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("a face names a vertex that there is not")
    used = vertices[np.unique(faces)]
    if not np.isfinite(used).all():
        raise ValueError("vertices of its faces are NaN or infinite")
    if path.suffix.lower() == ".obj":
        _check_obj(vertices, faces)
    return {"positions": sample_faces(vertices, faces, count), "faces": np.array([len(faces)])}


def sample_faces(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], count: int
) -> Float[np.ndarray, "count 3"]:
    """`count` points spread evenly by area over a mesh; always the same ones.

    Every face gets its share to within one point (equal steps along the running sum of areas). Within the faces the
    points follow Roberts' R2 sequence, folded from the unit square into the triangle.

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


def _load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of everything in a file, in one frame."""
    trimesh = _trimesh()
    # Materials and textures are not asked for, so that a missing image is no fault; STL repeats its vertices.
    options: dict[str, Any] = {"process": False}
    if path.suffix.lower() == ".off":
        _check_off(path)
    if path.suffix.lower() == ".obj":
        _check_obj_lines(path)
        options["skip_materials"] = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = trimesh.load(str(path), **options)
    except (OSError, MemoryError):
        raise
    except Exception as error:
        # trimesh passes on whatever its parsers raise; all of it means that the file is not what it should be.
        what = " ".join(str(error).split())
        raise ValueError(what[:120] if what and not isinstance(error, KeyError) else "it is not complete") from None
    if isinstance(loaded, trimesh.Scene):
        parts = [part for part in loaded.dump() if hasattr(part, "vertices")]
    else:
        parts = [loaded]
    vertices = [np.asarray(part.vertices, dtype=np.float64).reshape(-1, 3) for part in parts]
    faces = [_faces(part) for part in parts]
    starts = np.cumsum([0, *map(len, vertices)])
    moved = [face + start for face, start in zip(faces, starts[:-1], strict=True)]
    return (
        np.concatenate([np.empty((0, 3)), *vertices]),
        np.concatenate([np.empty((0, 3), dtype=np.int64), *moved]),
    )


def _check_obj(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse an OBJ, which has no counts, whose faces do not go with its vertices: cut off among the faces, or with
    lines lost or doubled, so that faces name vertices far apart.
    """
    used = np.unique(faces)
    if len(used) < USED * len(vertices):
        raise ValueError(f"its faces use {len(used)} of {len(vertices)} vertices only, as if its end were missing")
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    corners = index.ravel()[faces]
    shown = places[np.unique(corners)]
    spacing = float(np.median(np.asarray(KDTree(shown).query(shown, k=2)[0])[:, 1]))
    lengths = np.linalg.norm(places[corners] - places[np.roll(corners, 1, axis=1)], axis=2).max(axis=1)
    sides = np.sort(np.stack([corners, np.roll(corners, 1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    _, side, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    alone = (count[side.ravel()].reshape(-1, 3) == 1).all(axis=1)
    a, b, c = (places[corners[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    apart = area[alone & (lengths > LONG * spacing)].sum() > APART * area.sum()
    if apart or (lengths > LONG * spacing).mean() > LONG_SHARE:
        raise ValueError("its faces join vertices far apart, as if lines were lost or doubled")


def _check_obj_lines(path: Path) -> None:
    """Refuse an OBJ with a line that is too short, after which trimesh would read shifted."""
    with path.open(errors="replace") as file:
        for number, line in enumerate(file, start=1):
            words = line.split()
            if words and words[0] in ("v", "f") and len(words) < 4:
                raise ValueError(f"line {number} is not complete")


def _check_off(path: Path) -> None:
    """Refuse an OFF whose lines do not fit its counts, which trimesh would read shifted."""
    lines = [words for line in path.read_text(errors="replace").splitlines() if (words := line.split("#")[0].split())]
    if not lines or not lines[0][0].upper().endswith("OFF"):
        raise ValueError("its first line is not 'OFF'")
    lines[0] = lines[0][1:]
    lines = lines if lines[0] else lines[1:]
    counts = lines[0][:3] if lines else []
    if len(counts) < 2 or not all(word.isascii() and word.isdigit() and len(word) < 12 for word in counts):
        raise ValueError("it does not say how many vertices and faces it has")
    vertices, faces = int(counts[0]), int(counts[1])
    if len(lines) - 1 < vertices + faces:
        raise ValueError(f"it promises {vertices} vertices and {faces} faces, {len(lines) - 1} lines follow")
    shifted = [words for words in lines[1 + vertices : 1 + vertices + faces] if len(words) < 1 + _sides(words[0])]
    if shifted or any(len(words) < 3 for words in lines[1 : 1 + vertices]):
        raise ValueError("its lines are not as many vertices and faces as it promises")


def _sides(word: str) -> int:
    return int(word) if word.isascii() and word.isdigit() and 3 <= int(word) < 100 else 10_000


def _faces(part: Any) -> np.ndarray:
    faces = np.asarray(getattr(part, "faces", ()), dtype=np.int64)
    return faces.reshape(-1, 3) if faces.size else np.empty((0, 3), dtype=np.int64)


def _trimesh() -> Any:
    try:
        import trimesh
    except ModuleNotFoundError:
        raise BrafitError("trimesh, which reads meshes, is missing. Run: pip install trimesh") from None
    return trimesh
