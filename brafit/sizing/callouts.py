"""Names on pieces that lie on one another: of marks, each once with a line to the mark of every piece, and of sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Point, Polygon, STRtree
from shapely.geometry.base import BaseGeometry

from brafit.pattern import CutPiece
from brafit.pattern.drawing import INFO, Stroke, Words, drawn
from brafit.pattern.label import LEVEL, box_corners, polygons, text_width

HEIGHT = 3.0
"""Of the letters, mm."""
_STEP, _CLEAR = 2.5, 1.0
"""Distance of the places that are tried, and what a text keeps from lines and other texts; mm."""

_SHARES, _DEPTHS = np.linspace(0.05, 0.95, 37), np.array((3.0, 6.5, 10.0))
"""Where along the upper edge a size's name is tried, in shares of its length, and how far inside of it (mm)."""
_ON_ARROW, _ON_LINE, _AWAY = 30.0, 3.0, 0.2
"""How bad it is that a name lies on a grain line's arrow, on another line, or a mm from where it would be best."""


@dataclass(frozen=True)
class Callout:
    """The name of a mark, and for each piece that has the mark its number and a line from the name to the mark."""

    words: Words
    leaders: tuple[tuple[int, Float[ndarray, "2 2"]], ...]


def callouts(pieces: Sequence[CutPiece], texts: Sequence[Words]) -> list[Callout]:
    """Names of the marks, where they meet the fewest lines and are nearest to the marks.

    Args:
        pieces: in place, mm.
        texts: that stand there already.
    """
    marks: dict[str, list[tuple[int, Float[ndarray, "2"]]]] = {}
    for k, piece in enumerate(pieces):
        for name, point in (
            *((n.name, n.foot) for n in piece.notches if n.name),
            *((h.name, h.point) for h in piece.holes),
        ):
            marks.setdefault(name, []).append((k, point))
    bounds = np.concatenate([piece.cut_outline(0.5) for piece in pieces])
    taken: list[BaseGeometry] = [line for piece in pieces for line, _ in _lines(piece)]
    taken += [Polygon(words.corners) for words in texts]
    found = []
    for name, feet in marks.items():
        callout = _placed(name, feet, bounds.min(0), bounds.max(0), taken)
        taken += [Polygon(callout.words.corners), *(LineString(line) for _, line in callout.leaders)]
        found.append(callout)
    return found


def _placed(
    name: str,
    feet: Sequence[tuple[int, Float[ndarray, "2"]]],
    low: Float[ndarray, "2"],
    high: Float[ndarray, "2"],
    taken: Sequence[BaseGeometry],
) -> Callout:
    """A mark's name within bounds."""
    width = text_width(name, HEIGHT)
    half = np.array((width, HEIGHT)) / 2
    axes = [np.arange(a, max(b, a + 1e-6), _STEP) for a, b in zip(low + half, high - half, strict=True)]
    at = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    boxes = polygons(box_corners(at, LEVEL[None], width, HEIGHT))
    hits = STRtree(boxes).query(list(taken), predicate="dwithin", distance=_CLEAR)[1]
    lines = np.bincount(hits, minlength=len(at))
    far = np.sum([shapely.distance(boxes, Point(*foot)) for _, foot in feet], axis=0)
    k = int(np.lexsort((far, lines))[0])
    words = Words(name, at[k], HEIGHT, layer=INFO)
    leaders = [(piece, shapely.get_coordinates(shapely.shortest_line(boxes[k], Point(*foot)))) for piece, foot in feet]
    return Callout(words, tuple(leaders))


def _lines(piece: CutPiece) -> list[tuple[LineString, str]]:
    """All that is drawn of a piece but its texts, each line with its layer."""
    strokes = [item for item in drawn(piece, "") if isinstance(item, Stroke) and item.role != "leader"]
    return [
        (LineString(curve.polyline(0.1)), stroke.layer) for stroke in strokes for path in stroke.paths for curve in path
    ]


def size_names_on(pieces: Sequence[CutPiece], names: Sequence[str], title: Words) -> list[Words]:
    """The sizes' names inside the upper edges of their pieces: clear of each other, of arrows and of lines, as far as
    there is room, each near another place of the edge.

    Args:
        pieces: in place, mm, each of another size.
        names: of the sizes.
        title: what stands there already, the name of the pieces.
    """
    lines = [line for piece in pieces for line in _lines(piece)]
    tree = STRtree([line for line, _ in lines])
    costs = np.array([_ON_ARROW if layer == "grain" else _ON_LINE for _, layer in lines])
    taken, found = [Polygon(title.corners)], []
    for k, (piece, name) in enumerate(zip(pieces, names, strict=True)):
        upper = piece.sew[-1].curve
        middles, along = upper.trace(upper.places(_SHARES * upper.length))
        inward = np.stack((-along[:, 1], along[:, 0]), axis=-1) * (-1 if piece.side == "right" else 1)
        at = (middles[:, None] + _DEPTHS[:, None] * inward[:, None]).reshape(-1, 2)
        boxes = polygons(box_corners(at, LEVEL[None], text_width(name, HEIGHT), HEIGHT))
        overlaps = (shapely.distance(boxes[:, None], np.array(taken)) < _CLEAR / 2).sum(axis=1)
        box, hit = tree.query(boxes, predicate="intersects")
        best = 0.1 + 0.8 * (k + 0.5) / len(pieces)
        away = np.abs(_SHARES - best)[:, None] * upper.length + _DEPTHS
        cost = _AWAY * away.ravel() + np.bincount(box, costs[hit], len(at))
        chosen = int(np.lexsort((cost, overlaps))[0])
        taken.append(boxes[chosen])
        found.append(Words(name, at[chosen], HEIGHT))
    return found
