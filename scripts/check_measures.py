"""A tape on the written cup, by libraries that brafit does not measure with: libigl and trimesh."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from readers import module, polyline_length


def measure_figures(folder: Path, fit: Mapping[str, Any]) -> dict[str, float]:
    """How far fit.json's measures over the surface are from those on cup.obj, at most."""
    own = {name: value for part, name, value, *_ in fit["pattern"]["dimensions"] if part == "over the surface"}
    marks = fit["landmarks"]
    frame = np.array(fit["frame"]["axes"]), np.array(fit["frame"]["origin"])
    others = taped(folder / "cup.obj", marks["apex"], marks["strap_point"], *frame)
    off = {name: abs(own[name] - value) for name, value in others.items()}
    return {
        "over the surface: sections, trimesh": max(v for name, v in off.items() if "strap" not in name),
        "over the surface: geodesic, libigl": max(v for name, v in off.items() if "strap" in name),
    }


def taped(
    path: Path, apex: Any, strap_point: Any, axes: np.ndarray, origin: np.ndarray | None = None
) -> dict[str, float]:
    """Measures on an OBJ file of panels.

    Args:
        path: the file.
        apex: in the cup frame.
        strap_point: in the cup frame; None: there is none.
        axes: of the cup frame in the file's: rows x, y, z.
        origin: of the cup frame in the file's.
    """
    trimesh = module("trimesh")
    loaded: Any = trimesh.load(path, process=False)
    parts = loaded.geometry.values() if hasattr(loaded, "geometry") else [loaded]
    places = np.vstack([part.vertices for part in parts]) - (0 if origin is None else origin)
    firsts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.vstack([np.asarray(part.faces) + first for part, first in zip(parts, firsts, strict=False)])
    mesh: Any = trimesh.Trimesh(places @ np.asarray(axes).T, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=6)
    vertices, triangles = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    foot = module("igl", "libigl").point_mesh_squared_distance(np.array([apex], float), vertices, triangles)[2][0]
    down, up = section(mesh, foot, 1)
    found = {
        "bust point down to the wire (bottom cup depth)": down,
        "bust point up to the upper edge (upper cup depth)": up,
        "vertical over the bust point": down + up,
        "horizontal over the bust point": sum(section(mesh, foot, 0)),
    }
    if strap_point is not None:
        found["strap point to bust point"] = shortest(mesh, foot, on_rim(mesh, np.asarray(strap_point, float)))
    return found


def section(mesh: Any, start: np.ndarray, axis: int) -> tuple[float, float]:
    """Lengths of the section by the plane across an axis on both sides of a point, that towards the greater x first."""
    pieces = module("trimesh").intersections.mesh_plane(mesh, np.eye(3)[axis], start)
    plane = [i for i in range(3) if i != axis]
    merged = shapely.line_merge(shapely.set_precision(shapely.multilinestrings(pieces[..., plane]), 1e-6))
    lines = [np.asarray(part.coords) for part in getattr(merged, "geoms", [merged])]
    point = start[plane]
    line = min(lines, key=lambda points: segment_distances(points, point).min())
    k = int(segment_distances(line, point).argmin())
    ends = {}
    for part in (line[: k + 1][::-1], line[k + 1 :]):
        ends[part[-1][0]] = polyline_length(np.vstack((point, part)))
    return ends[max(ends)], ends[min(ends)]


def segment_distances(line: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Distances of a point from a polyline's segments."""
    a, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - a) * step).sum(1) / np.maximum((step**2).sum(1), 1e-30), 0, 1)
    return np.linalg.norm(a + share[:, None] * step - point, axis=1)


def on_rim(mesh: Any, point: np.ndarray) -> np.ndarray:
    """The nearest point of the mesh's border whose side away from the wire's plane it is on."""
    sides = np.sort(mesh.edges, axis=1)
    unique, count = np.unique(sides, axis=0, return_counts=True)
    a, b = mesh.vertices[unique[count == 1][:, 0]], mesh.vertices[unique[count == 1][:, 1]]
    share = np.clip(((point - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-30), 0, 1)
    feet = a + share[:, None] * (b - a)
    return feet[int(np.linalg.norm(feet - point, axis=1).argmin())]


def shortest(mesh: Any, start: np.ndarray, end: np.ndarray) -> float:
    """Length of the exact geodesic between two points of the mesh, by libigl."""
    igl = module("igl", "libigl")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    vertices, faces, first = with_vertex(vertices, faces, start)
    vertices, faces, last = with_vertex(vertices, faces, end)
    none = np.zeros(0, dtype=np.int64)
    (length,) = np.atleast_1d(igl.exact_geodesic(vertices, faces, np.array([first]), none, np.array([last]), none))
    return float(length)


def with_vertex(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The mesh with a point of it as a vertex: its triangle, or the triangles at its side, are divided."""
    near = int(np.linalg.norm(vertices - point, axis=1).argmin())
    if np.linalg.norm(vertices[near] - point) < 1e-4:
        return vertices, faces, near
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.maximum((normal**2).sum(1), 1e-30)
    weights = np.stack([
        (np.cross(corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3], point - corners[:, (i + 1) % 3]) * normal).sum(1)
        / double for i in range(3)
    ], axis=1)  # fmt: skip
    clipped = np.clip(weights, 0, None)
    clipped /= clipped.sum(1, keepdims=True)
    face = int(np.linalg.norm(np.einsum("fi,fij->fj", clipped, corners) - point, axis=1).argmin())
    new, inner = len(vertices), clipped[face] > 1e-5
    vertices = np.vstack((vertices, clipped[face] @ corners[face]))
    side = set(faces[face][inner].tolist())
    kept, divided = [], []
    for triangle in faces:
        if side <= set(triangle.tolist()):
            for i in range(3):
                a, b = triangle[i], triangle[(i + 1) % 3]
                if not (len(side) == 2 and {int(a), int(b)} == side):
                    divided.append((a, b, new))
        else:
            kept.append(triangle)
    return vertices, np.array([*kept, *divided], dtype=np.int64), new
