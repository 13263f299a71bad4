"""Pattern pieces: closed outlines of named edges, in millimetres.

Pieces are seen from the outside of the cup, that is with the right side of the cloth up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import CubicSpline
from shapely import LinearRing

from brafit.cup.names import edge_names, panel_names
from brafit.geometry.development import FlatPanel
from brafit.geometry.polyline import polyline_length, running_length

Kind = Literal["wire", "ridge", "upper"]
"""What an edge is sewn to: the wire casing, the neighbouring panel, or nothing (the free upper edge)."""

KIND_NAMES: Mapping[Kind, str] = {"wire": "wire", "ridge": "seam", "upper": "upper"}
"""What labels call them."""

Side = Literal["left", "right"]
"""The wearer's side."""


@dataclass(frozen=True)
class Mark:
    """A place on an edge that a landmark belongs to: its distance from the inner end, mm."""

    name: str
    distance: float


@dataclass(frozen=True)
class Hole:
    """A place inside a piece that is to be marked by a drilled hole."""

    name: str
    point: Float[ndarray, "2"]


@dataclass(frozen=True)
class Edge:
    """One side of a piece, a polyline in outline order. The two edges that are sewn together bear the same name."""

    name: str
    kind: Kind
    points: Float[ndarray, "n 2"]
    marks: tuple[Mark, ...] = ()

    @property
    def length(self) -> float:
        """Length of the polyline in mm."""
        return polyline_length(self.points)

    def at(self, fraction: float) -> Float[ndarray, "2"]:
        """The point after `fraction` of the length, 0 at the first sample and 1 at the last."""
        along = running_length(self.points)
        return np.array([np.interp(fraction * along[-1], along, self.points[:, i]) for i in range(2)])


@dataclass(frozen=True)
class Piece:
    """A piece of cloth: its edges follow each other and close the outline. x runs right, y up, both in mm.

    The pieces of a cup have two edges: the lower one from the inner wire end to the outer, and the upper one back.
    """

    name: str
    edges: tuple[Edge, ...]
    holes: tuple[Hole, ...] = ()

    @property
    def outline(self) -> Float[ndarray, "n 2"]:
        """The closed outline; the first point is not repeated, nor is any point where two edges meet."""
        points = np.concatenate([edge.points for edge in self.edges])
        away = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-9
        return points[away]

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Lower left and upper right corner."""
        outline = self.outline
        return outline.min(0), outline.max(0)

    @property
    def area(self) -> float:
        """Area within the outline in mm^2, positive whichever way the outline runs."""
        x, y = self.outline.T
        return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)

    @property
    def middle(self) -> Float[ndarray, "2"]:
        """A point well inside a cup's piece, for its name: half way between the middles of its first two edges."""
        return (self.edges[0].at(0.5) + self.edges[1].at(0.5)) / 2

    def map(self, function: Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]) -> Piece:
        """The piece with `function`, an isometry, applied to the points of every edge and to the holes."""
        edges = tuple(replace(edge, points=function(edge.points)) for edge in self.edges)
        holes = tuple(replace(hole, point=function(hole.point[None])[0]) for hole in self.holes)
        return replace(self, edges=edges, holes=holes)

    def mirrored(self) -> Piece:
        """The same piece for the other breast."""
        return self.map(lambda points: points * (-1.0, 1.0))

    def crossings(self) -> Float[ndarray, "k 2"]:
        """Where the outline crosses or touches itself. Cloth cannot be cut along an outline that has any."""
        return self_crossings(self.outline)


@dataclass(frozen=True)
class CupMark:
    """Where a landmark lies on a cup: on an edge, or inside a panel.

    Attributes:
        name: such as `apex`.
        station: place along the wire as a real-valued index of the cup's stations.
        edge: index of the edge, 0 at the wire; None for a mark inside a panel.
        panel, share: for those, index of the panel and place on its ruling, 0 at the lower edge and 1 at the upper.
    """

    name: str
    station: float
    edge: int | None = None
    panel: int = 0
    share: float = 0.0

    def on(self, edge: Float[ndarray, "n 2"]) -> Mark:
        """The mark on that edge's samples, which run from the inner end."""
        along = _arc_length(edge)
        return Mark(self.name, float(CubicSpline(np.arange(len(edge)), along)(self.station)))

    def inside(self, lower: Float[ndarray, "n 2"], upper: Float[ndarray, "n 2"]) -> Float[ndarray, "2"]:
        """Its place in the flat panel.

        Args:
            lower: the panel's lower edge laid flat.
            upper: its upper edge.
        """
        a, b = (CubicSpline(np.arange(len(edge)), edge)(self.station) for edge in (lower, upper))
        return (1 - self.share) * a + self.share * b


@runtime_checkable
class Drawable(Protocol):
    """What can be set on a sheet."""

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]: ...

    def map(self, function: Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]], /) -> Any: ...


P = TypeVar("P", bound=Drawable)


@dataclass(frozen=True)
class Sheet(Generic[P]):
    """Pieces in place on a sheet of the given size in mm, its origin in the lower left corner."""

    pieces: tuple[P, ...]
    width: float
    height: float


def pieces_from_panels(panels: Sequence[FlatPanel], side: Side = "left", marks: Sequence[CupMark] = ()) -> list[Piece]:
    """The pieces of one cup, from the wire up.

    Args:
        panels: developed panels of one cup in mm, from the wire up, without batch dimensions; all cups are developed as
            left ones.
        side: the breast they are for. Pieces for the right one are mirrored, so that they cut right.
        marks: landmarks on the cup, see `brafit.pattern.marks`.

    Returns:
        Pieces with their two ends level, the wire downwards, the inner end on the left for a left cup.

    Raises:
        ValueError: no panels, or an unknown side.
    """
    if not panels:
        raise ValueError("a cup has at least one panel")
    if side not in ("left", "right"):
        raise ValueError(f"side must be left or right, not {side!r}")
    names, seams = panel_names(len(panels)), edge_names(len(panels))
    ridges: list[Kind] = ["ridge"] * (len(panels) - 1)
    kinds: list[Kind] = ["wire", *ridges, "upper"]
    pieces = []
    for i, panel in enumerate(panels):
        lower, upper = (curve.detach().cpu().double().numpy() for curve in (panel.lower, panel.upper))
        edges = (
            Edge(seams[i], kinds[i], lower, tuple(m.on(lower) for m in marks if m.edge == i)),
            Edge(seams[i + 1], kinds[i + 1], upper[::-1], tuple(m.on(upper) for m in marks if m.edge == i + 1)),
        )
        holes = tuple(Hole(m.name, m.inside(lower, upper)) for m in marks if m.edge is None and m.panel == i)
        piece = _levelled(Piece(names[i], edges, holes))
        pieces.append(piece.mirrored() if side == "right" else piece)
    return pieces


def layout(pieces: Sequence[P], gap: float = 12.0) -> Sheet[P]:
    """Set pieces on a sheet, one above the other as they are worn, `gap` mm apart; no two overlap."""
    return layout_columns([pieces], gap)


def layout_columns(columns: Sequence[Sequence[P]], gap: float = 12.0) -> Sheet[P]:
    """Set columns of pieces side by side; in a column one above the other. No two pieces come nearer than `gap` mm."""
    placed, left, top = [], 0.0, 0.0
    for pieces in columns:
        width = max(float(np.subtract(*piece.bounds[::-1])[0]) for piece in pieces)
        height = 0.0
        for piece in pieces:
            low, high = piece.bounds
            shift = np.array([left + (width - (high - low)[0]) / 2, height]) - low
            placed.append(piece.map(lambda points, shift=shift: points + shift))
            height += float((high - low)[1]) + gap
        left, top = left + width + gap, max(top, height - gap)
    return Sheet(tuple(placed), left - gap, top)


def _arc_length(points: Float[ndarray, "n 2"]) -> Float[ndarray, " n"]:
    """Length from the first sample to each, of the smooth curve through the samples."""
    chords = running_length(points)
    distinct = np.append(True, np.diff(chords) > 1e-9)
    spline = CubicSpline(chords[distinct], points[distinct])
    nodes, weights = np.polynomial.legendre.leggauss(6)
    start, step = chords[:-1], np.diff(chords)
    speed = np.linalg.norm(spline(start[:, None] + step[:, None] * (nodes + 1) / 2, 1), axis=-1)
    return np.append(0.0, np.cumsum(speed @ weights * step / 2))


def _levelled(piece: Piece) -> Piece:
    """Turned so that the chord of the first edge lies along +x."""
    start, end = piece.edges[0].points[[0, -1]]
    c, s = (end - start) / max(float(np.linalg.norm(end - start)), 1e-12)
    return piece.map(lambda points: (points - start) @ np.array([[c, -s], [s, c]]))


def self_crossings(outline: Float[ndarray, "n 2"]) -> Float[ndarray, "k 2"]:
    """Crossings of a closed polygon's segments, those that share a corner apart.

    A corner that lies exactly on a segment counts as lying to its left, so that a crossing through a corner is found.
    """
    if LinearRing(outline).is_simple:
        return np.zeros((0, 2))
    a, b = outline, np.roll(outline, -1, axis=0)
    n = len(outline)

    def left(p: ndarray) -> ndarray:
        """(n, n): whether point p_j is not to the right of segment i."""
        d, e = (b - a)[:, None], p[None] - a[:, None]
        return d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0] >= 0

    splits = left(a) != left(b)
    i, j = np.nonzero(np.triu(splits & splits.T, 2))
    apart = (j - i) % n != n - 1
    i, j = i[apart], j[apart]
    d, e = b[i] - a[i], b[j] - a[j]
    across = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    offset = a[j] - a[i]
    parameter = (offset[:, 0] * e[:, 1] - offset[:, 1] * e[:, 0]) / np.where(across == 0, 1.0, across)
    return a[i] + np.clip(parameter, 0, 1)[:, None] * d
