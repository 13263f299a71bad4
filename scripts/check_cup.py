"""The cup in 3D as it was written, its panels flattened again by libigl, and the patterns beside it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from flattenings import arap, lscm
from readers import LABEL, module, path_points
from scipy.interpolate import CubicSpline
from shapely import LineString

PLAIN = ("pattern against cup: edges of triangles, mm", "pattern against cup: their strain")
"""Figures without a limit."""


@dataclass(frozen=True)
class PanelFile:
    """A panel of an OBJ file: places in space and in the flat pattern, triangles."""

    name: str
    vertices: np.ndarray
    flat: np.ndarray
    faces: np.ndarray

    @property
    def strips(self) -> int:
        """Rows of triangles from edge to edge: the first tip's fan."""
        return int((self.faces == 0).any(1).sum())

    def edge(self, values: np.ndarray, upper: bool) -> np.ndarray:
        """The lower or upper edge's values, from the inner end."""
        rows = values[1:-1].reshape(-1, self.strips + 1, values.shape[1])
        return np.vstack((values[:1], rows[:, -1 if upper else 0], values[-1:]))


def read_obj(path: Path) -> list[PanelFile]:
    """The objects of an OBJ file whose vertices have texture coordinates of the same number."""
    columns: dict[str, list[list[float]]] = {"v": [], "vt": []}
    objects: list[tuple[str, list[list[int]]]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        word, *rest = line.split()
        if word in columns:
            columns[word].append([float(number) for number in rest])
        elif word == "o":
            objects.append((rest[0], []))
        elif word == "f":
            objects[-1][1].append([int(corner.split("/")[0]) - 1 for corner in rest])
    vertices, flat = np.array(columns["v"]), np.array(columns["vt"])
    panels = []
    for name, triangles in objects:
        faces = np.array(triangles)
        first, last = faces.min(), faces.max() + 1
        panels.append(PanelFile(name, vertices[first:last], flat[first:last], faces - first))
    return panels


def cup_figures(folder: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """The cup's own edges, strains and angles, and the drawn curves against the flat edges."""
    panels = read_obj(folder / "cup.obj")
    lengths_off, apart, strain, defect = 0.0, 0.0, 0.0, 0.0
    for panel, edges in zip(panels, lengths.values(), strict=True):
        for wanted, upper in zip(edges.values(), (False, True), strict=True):
            lengths_off = max(lengths_off, abs(spline_length(panel.edge(panel.vertices, upper)) - wanted))
        sides = [edge_lengths(values, panel.faces) for values in (panel.flat, panel.vertices)]
        apart = max(apart, float(np.abs(sides[0] - sides[1]).max()))
        strain = max(strain, edge_strain(panel.flat, panel.vertices, panel.faces))
        defect = max(defect, angle_defect(panel.vertices, panel.faces))
    figures = {
        "edge lengths, cup in 3D": lengths_off,
        PLAIN[0]: apart,
        PLAIN[1]: strain,
        "angle defect of inner vertices": defect,
    }
    svg = folder / "patterns.svg"
    return {**figures, "curves off the fitted outline": outline_gap(svg, panels)} if svg.exists() else figures


def outline_gap(path: Path, panels: list[PanelFile]) -> float:
    """How far the flat edges' samples lie from the curves that are drawn, at most; for patterns without ease."""
    elements = module("svgelements")
    root: Any = ET.parse(path).getroot()
    (sew,) = (group for group in root if group.get(LABEL) == "sew")
    worst = 0.0
    for panel, lines in zip(panels, sew, strict=False):
        drawn = [path_points(elements.Path(line.get("d")), 400) * (1, -1) for line in lines]
        moved = drawn[0][0] - panel.edge(panel.flat, False)[0]
        for line, upper in zip(drawn, (False, True), strict=True):
            samples = shapely.points(panel.edge(panel.flat, upper) + moved)
            worst = max(worst, float(shapely.distance(samples, LineString(line)).max()))
    return worst


def libigl_figures(path: Path) -> dict[str, float]:
    """Each panel flattened again, laid onto the pattern and compared with the cup."""
    lscm, arap, strain = 0.0, 0.0, 0.0
    for panel in read_obj(path):
        lscm = max(lscm, misfit(flattened(panel, "lscm"), panel.flat))
        flat = flattened(panel, "arap")
        arap = max(arap, misfit(flat, panel.flat))
        strain = max(strain, edge_strain(flat, panel.vertices, panel.faces))
    return {
        "libigl: off the pattern, LSCM": lscm,
        "libigl: off the pattern, ARAP": arap,
        "libigl: edge strain, ARAP against the cup": strain,
    }


def flattened(mesh: Any, method: str) -> np.ndarray:
    """A mesh flattened by libigl: LSCM with two points held as far apart as the pattern has them; ARAP from there with
    one held.

    Args:
        mesh: has vertices (v, 3), flat (v, 2) and faces (f, 3).
        method: `lscm` or `arap`.
    """
    loop = module("igl", "libigl").boundary_loop(np.ascontiguousarray(mesh.faces, dtype=np.int64))
    held = loop[[0, len(loop) // 2]]
    flat = lscm(mesh.vertices, mesh.faces, held, mesh.flat[held])
    return flat if method == "lscm" else arap(mesh.vertices, mesh.faces, flat, int(held[0]))


def misfit(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance after the best rigid motion of the plane, mirror images allowed."""
    a, b = a - a.mean(0), b - b.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    return float(np.linalg.norm(a @ u @ v - b, axis=1).max())


def edge_strain(flat: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> float:
    """By which share the triangles' edges differ in length at most."""
    return float(np.abs(edge_lengths(flat, faces) / edge_lengths(vertices, faces) - 1).max())


def edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3) of triangles."""
    corners = vertices[faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def angle_defect(vertices: np.ndarray, faces: np.ndarray) -> float:
    """How far the angles about an inner vertex are from a full turn at most, in radians."""
    corners = vertices[faces]
    a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    total = np.bincount(faces.ravel(), angles.ravel(), len(vertices))
    pairs = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    unique, count = np.unique(pairs, axis=0, return_counts=True)
    inner = np.setdiff1d(np.arange(len(vertices)), unique[count == 1])
    return float(np.abs(total[inner] - 2 * np.pi).max())


def spline_length(points: np.ndarray) -> float:
    """Length of the cubic spline through points."""
    chords = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    spline, (nodes, weights) = CubicSpline(chords, points), np.polynomial.legendre.leggauss(6)
    spans = [(a, b - a) for a, b in pairwise(chords)]
    return sum(float(np.linalg.norm(spline(a + h * (nodes + 1) / 2, 1), axis=1) @ weights) * h / 2 for a, h in spans)
