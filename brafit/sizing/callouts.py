"""Names of the marks of pieces that lie on one another: each once, with a line to the mark of every piece."""

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
    taken: list[BaseGeometry] = [line for piece in pieces for line in _lines(piece)]
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


def _lines(piece: CutPiece) -> list[LineString]:
    """All that is drawn of a piece but its texts."""
    strokes = [item for item in drawn(piece, "") if isinstance(item, Stroke) and item.role != "leader"]
    return [LineString(curve.polyline(0.1)) for stroke in strokes for path in stroke.paths for curve in path]
