"""A breast's surface as triangles, cut along lines into parts, laid flat by other programs, and what that strains.

Strain of a triangle: the principal stretches of its map from the surface to the plane (the singular values), less 1,
the larger one by size. Shares of the surface are shares of its area.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from readers import module
from scipy.interpolate import RBFInterpolator

from brafit.geometry.polyline import polyline_length, running_length
from brafit.report.mesh import panel_faces
from brafit.surface.directions import Chart
from brafit.surface.gaps import SMOOTHING

ROWS = 24
"""Rows of triangles from the wire to the neckline, over all parts."""
EVERY = 2
"""Of a cup's stations, every so many is one of the mesh."""
FILTER_EDGE = 8.0
"""Edges of the even triangles that MeshLab's filter works on, mm; on finer ones it takes many times as long."""
ARAP_STEPS, SLIM_STEPS = 100, 25
"""More change the largest, the 95th percentile and the mean of the strain by a tenth at most."""


class FoldedError(Exception):
    """Lines between which no mesh can be laid."""


@dataclass(frozen=True)
class Part:
    """A part of a surface in space and laid flat.

    Attributes:
        vertices: (v, 3), mm.
        faces: (f, 3), counter-clockwise seen from outside.
        lower, upper: numbers of the vertices along its two edges, from the inner end.
        flat: (v, 2), mm; None: not yet.
    """

    vertices: np.ndarray
    faces: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    flat: np.ndarray | None = None

    @property
    def laid(self) -> np.ndarray:
        """The flat places.

        Raises:
            ValueError: it is not laid flat yet.
        """
        if self.flat is None:
            raise ValueError("the part is not laid flat yet")
        return self.flat

    def lengths(self, upper: bool) -> tuple[float, float]:
        """Length of an edge in space and flat, mm."""
        edge = self.upper if upper else self.lower
        return polyline_length(self.vertices[edge]), polyline_length(self.laid[edge])


# the surface


@dataclass(frozen=True)
class Surface:
    """A breast between wire and neckline as a smooth surface: on the chart of directions from within, the logarithm of
    the radius is a spline through the points and the lines, by which scans' gaps are bridged too.

    Attributes:
        chart: of the directions.
        spline: logarithm of the radius (mm) at places of the chart.
        neckline: (m, 3), where the surface ends.
    """

    chart: Chart
    spline: RBFInterpolator
    neckline: np.ndarray

    @staticmethod
    def of(points: np.ndarray, wire: np.ndarray, neckline: np.ndarray, chart: Chart) -> Surface:
        """The surface of a scan.

        Args:
            points: (n, 3) of the breast, mm; noise is smoothed away.
            wire: (k, 3), from the inner end; it is kept exactly.
            neckline: (m, 3), the same.
            chart: that all scans of this breast share.
        """
        lines = np.concatenate([wire, neckline])
        (place, radius), (rim, rim_radius) = chart.flat(points), chart.flat(lines)
        places, values = np.concatenate([place, rim]), np.log(np.concatenate([radius, rim_radius]))
        smoothing: Any = np.concatenate([np.full(len(place), SMOOTHING), np.zeros(len(rim))])
        _, first = np.unique(np.round(places[::-1], 6), axis=0, return_index=True)  # of two, the one on a line
        one = np.sort(len(places) - 1 - first)
        spline = RBFInterpolator(places[one], values[one], smoothing=smoothing[one], kernel="cubic")
        return Surface(chart, spline, neckline)

    def at(self, places: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the surface at places (n, 2) of the chart."""
        return self.chart.space(places, np.exp(self.spline(places)))

    def parts(self, edges: np.ndarray, rows: int = ROWS, every: int = EVERY) -> list[Part]:
        """The surface cut into parts along a cup's ridges, seen from the chart's centre.

        Args:
            edges: (panels + 1, n, 3) of the cup: wire, ridges and upper edge, in whose place the neckline is taken.
            rows: of triangles from wire to neckline.
            every: of the stations, one in so many.

        Raises:
            FoldedError: seen from the centre, the lines cross.
        """
        edges = edges[:, ::every]
        ends = edges[0, [0, -1]]
        lines = [edges[0], *(self.at(self.chart.flat(ridge)[0]) for ridge in edges[1:-1])]
        lines.append(_at_shares(self.neckline, edges[-1]))
        for line in lines:
            line[[0, -1]] = ends
        strips = max(1, round(rows / (len(lines) - 1)))
        return [self._between(lower, upper, strips) for lower, upper in pairwise(lines)]

    def _between(self, lower: np.ndarray, upper: np.ndarray, strips: int) -> Part:
        """The part between two lines: on the chart, their points of the same number are joined by straight lines."""
        a, b = (self.chart.flat(line)[0] for line in (lower, upper))
        share = np.linspace(0, 1, strips + 1)[None, :, None]
        places = (1 - share) * a[1:-1, None] + share * b[1:-1, None]
        points = self.at(places.reshape(-1, 2)).reshape(*places.shape[:2], 3)
        points[:, 0], points[:, -1] = lower[1:-1], upper[1:-1]
        vertices = np.concatenate([lower[:1], points.reshape(-1, 3), lower[-1:]])
        faces = panel_faces(len(lower), strips)
        turning = _turning(np.concatenate([a[:1], places.reshape(-1, 2), a[-1:]]), faces)
        if turning.min() <= 0 < turning.max():
            raise FoldedError("seen from within the breast, the lines cross: no mesh can be laid between them")
        inner = np.arange(1, len(vertices) - 1, strips + 1)
        sides = (np.concatenate([[0], inner + row, [len(vertices) - 1]]) for row in (0, strips))
        return Part(vertices, faces, *sides)


def _at_shares(line: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Points of a line at the shares of its length at which another's points are."""
    shares, along = running_length(like), running_length(line)
    at = shares / shares[-1] * along[-1]
    return np.stack([np.interp(at, along, column) for column in line.T], axis=1)


def _turning(flat: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Twice the area of flat triangles (f,), negative for those that run clockwise."""
    a, b = (flat[faces[:, k]] - flat[faces[:, 0]] for k in (1, 2))
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


# laying flat


def lscm(vertices: np.ndarray, faces: np.ndarray, held: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Least squares conformal map by libigl, (v, 2), with vertices `held` at `places`."""
    igl = module("igl", "libigl")
    flat, *_ = igl.lscm(np.ascontiguousarray(vertices), _whole(faces), _whole(held), np.ascontiguousarray(places))
    return flat


def arap(vertices: np.ndarray, faces: np.ndarray, start: np.ndarray, held: int = 0, steps: int = 50) -> np.ndarray:
    """As rigid as possible by libigl, (v, 2), from a flat start, with one vertex held."""
    igl = module("igl", "libigl")
    data, one = igl.ARAPData(), np.array([held], dtype=np.int64)
    data.energy, data.max_iter = igl.ARAP_ENERGY_TYPE_DEFAULT, steps
    start = np.ascontiguousarray(start)
    igl.arap_precomputation(np.ascontiguousarray(vertices), _whole(faces), 2, one, data)
    return igl.arap_solve(np.ascontiguousarray(start[one]), data, start)


def slim(vertices: np.ndarray, faces: np.ndarray, start: np.ndarray, steps: int = SLIM_STEPS) -> np.ndarray:
    """Scalable locally injective map by libigl, (v, 2), symmetric Dirichlet energy, from a flat start without folds."""
    igl = module("igl", "libigl")
    nothing, nowhere = np.zeros(0, dtype=np.int32), np.zeros((0, 2), order="F")
    space, flat = (np.asfortranarray(places) for places in (vertices, start))
    triangles, energy = np.asfortranarray(faces, dtype=np.int32), igl.MappingEnergyType.SYMMETRIC_DIRICHLET
    data = igl.slim_precompute(space, triangles, flat, energy, nothing, nowhere, 0.0)
    return np.ascontiguousarray(igl.slim_solve(data, steps)[:, :2])


def _whole(numbers: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers, dtype=np.int64)


def laid_flat(part: Part, method: str) -> Part:
    """A part laid flat: LSCM with its two tips held, then scaled to the surface's area; ARAP and SLIM from there.

    Args:
        part: in space.
        method: `LSCM`, `ARAP` or `SLIM`.

    Raises:
        MissingReaderError: libigl is not installed.
    """
    tips = part.lower[[0, -1]]
    places = np.array([[0.0, 0.0], [np.linalg.norm(np.diff(part.vertices[tips], axis=0)), 0.0]])
    flat = lscm(part.vertices, part.faces, tips, places)
    flat *= np.sqrt(areas(part).sum() / (_turning(flat, part.faces).sum() / 2))
    if method == "ARAP":
        flat = arap(part.vertices, part.faces, flat, int(tips[0]), ARAP_STEPS)
    elif method == "SLIM":
        flat = slim(part.vertices, part.faces, flat)
    return replace(part, flat=flat)


def made_developable(parts: Sequence[Part], evaluations: int) -> list[Part]:
    """The parts after MeshLab's developability filter.

    It works on the whole surface, made anew of even triangles: slim ones at the tips would stop it. Where it moves
    these, the parts' vertices go with them, so that the surface can be cut along the same lines.

    Args:
        parts: of one surface, with common vertices where they meet.
        evaluations: of its energy, at most.

    Raises:
        MissingReaderError: pymeshlab or libigl is not installed.
    """
    pymeshlab, igl = module("pymeshlab"), module("igl", "libigl")
    vertices, faces, own = whole(parts)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    meshes.meshing_isotropic_explicit_remeshing(targetlen=pymeshlab.PureValue(FILTER_EDGE))
    even, triangles = meshes.current_mesh().vertex_matrix().copy(), _whole(meshes.current_mesh().face_matrix())
    meshes.apply_coord_developability_of_mesh(maxfunevals=evaluations, edgeflips=False, edgecollapses=False)
    shifts = meshes.current_mesh().vertex_matrix() - even
    _, under, places = igl.point_mesh_squared_distance(vertices, even, triangles)
    corners = triangles[under]
    shares = igl.barycentric_coordinates(places, *(np.ascontiguousarray(even[corners[:, k]]) for k in range(3)))
    moved = vertices + (shares[..., None] * shifts[corners]).sum(axis=1)
    return [replace(part, vertices=moved[numbers]) for part, numbers in zip(parts, own, strict=True)]


def whole(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """One mesh of all parts: vertices (v, 3), faces (f, 3) and, for each part, the numbers of its vertices there."""
    vertices, numbers = np.unique(np.concatenate([part.vertices for part in parts]), axis=0, return_inverse=True)
    own = np.split(numbers.reshape(-1), np.cumsum([len(part.vertices) for part in parts])[:-1])
    faces = np.concatenate([new[part.faces] for part, new in zip(parts, own, strict=True)])
    return vertices, faces, own


METHODS = ("LSCM", "ARAP", "SLIM")
FILTER = "developability filter, then ARAP"
LONG_FILTER = "the same filter for longer"


def peers(evaluations: int) -> dict[str, Callable[[Sequence[Part]], list[Part]]]:
    """What lays parts flat, by its name; raises MissingReaderError where it is not installed."""

    def plain(method: str) -> Callable[[Sequence[Part]], list[Part]]:
        return lambda parts: [laid_flat(part, method) for part in parts]

    def filtered(parts: Sequence[Part]) -> list[Part]:
        return plain("ARAP")(made_developable(parts, evaluations))

    return {method: plain(method) for method in METHODS} | {FILTER: filtered}


# measuring


def stretches(part: Part) -> np.ndarray:
    """Principal stretches (f, 2) of every triangle, the larger one first."""
    corners, flat = part.vertices[part.faces], part.laid[part.faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    base = np.linalg.norm(a, axis=1)
    along = (a * b).sum(axis=1) / base
    across = np.linalg.norm(np.cross(a, b), axis=1) / base
    u = (flat[:, 1] - flat[:, 0]) / base[:, None]
    v = (flat[:, 2] - flat[:, 0] - along[:, None] * u) / across[:, None]
    return np.linalg.svd(np.stack([u, v], axis=2), compute_uv=False)


def areas(part: Part) -> np.ndarray:
    """Areas (f,) of the triangles in space."""
    a, b = (part.vertices[part.faces[:, k]] - part.vertices[part.faces[:, 0]] for k in (1, 2))
    return np.linalg.norm(np.cross(a, b), axis=1) / 2


def strains(parts: Sequence[Part]) -> tuple[float, float, float]:
    """Largest strain of any triangle, the one that is not exceeded on 95 % of the surface, and the mean over it."""
    strain = np.concatenate([np.abs(stretches(part) - 1).max(axis=1) for part in parts])
    share = np.concatenate([areas(part) for part in parts])
    share /= share.sum()
    order = np.argsort(strain)
    most = strain[order][np.searchsorted(np.cumsum(share[order]), 0.95).clip(max=len(order) - 1)]
    return float(strain.max()), float(most), float(strain @ share)


def seam_gaps(parts: Sequence[Part]) -> tuple[float, float]:
    """Of the worst seam: by which share one of its flat sides differs from its length in space, and by how many
    millimetres the two flat sides differ from each other; 0 for one part.
    """
    share, apart = 0.0, 0.0
    for below, above in pairwise(parts):
        (space, first), (_, second) = below.lengths(True), above.lengths(False)
        share = max(share, abs(first / space - 1), abs(second / space - 1))
        apart = max(apart, abs(first - second))
    return share, apart


def distances(points: np.ndarray, parts: Sequence[Part]) -> np.ndarray:
    """Distances (n,) of points (n, 3) from the surface of all parts, by libigl, mm."""
    igl = module("igl", "libigl")
    vertices, faces, _ = whole(parts)
    squares, *_ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), vertices, _whole(faces))
    return np.sqrt(squares)
