"""Texts on pieces: where they collide with no line, no mark and no other text, as large as fits."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from shapely import Polygon, unary_union
from shapely.affinity import rotate
from shapely.geometry.base import BaseGeometry
from shapely.ops import polylabel
from shapely.prepared import prep

from brafit.pattern.curve import Curve

Move = Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]

LINE = 1.3
"""Distance of the lines of a label, in heights of its letters."""
_LETTER, _BOLD_LETTER = 0.62, 0.7
"""Width of a letter of a sans-serif face at most on average, in its height."""
_LARGEST, _READABLE, _SMALLEST = 5.0, 2.5, 1.7
_CAPTIONS = (2.2, 1.8)
"""Heights of letters in mm that captions are tried in."""
_CLEAR = 0.8
"""Distance in mm that texts keep from lines."""


def text_width(words: str, size: float, bold: bool = False) -> float:
    """About the width in mm of a line of text in any sans-serif face, its letters `size` mm high; rather too much."""
    letters = sum(2 if unicodedata.east_asian_width(c) in "WF" else 1 for c in words)
    return (_BOLD_LETTER if bold else _LETTER) * size * letters


@dataclass(frozen=True)
class Caption:
    """A short text.

    Attributes:
        at: its middle.
        along: direction of the line, to the right.
        size: height of the letters, mm.
        leader: a line from it to what it names, where it does not stand beside that.
    """

    words: str
    at: Float[ndarray, "2"]
    along: Float[ndarray, "2"]
    size: float
    leader: Float[ndarray, "2 2"] | None = None

    @property
    def corners(self) -> Float[ndarray, "4 2"]:
        """Of the box around it."""
        return _box(self.at, self.along, text_width(self.words, self.size), self.size)

    @property
    def angle(self) -> float:
        """Of the line, in degrees, from -90 to 90."""
        return float(np.degrees(np.arctan2(self.along[1], self.along[0])))

    def map(self, move: Move) -> Caption:
        """The caption under an isometry, still readable."""
        at, along = _moved(self.at, self.along, move)
        return replace(self, at=at, along=along, leader=None if self.leader is None else move(self.leader))


@dataclass(frozen=True)
class Label:
    """What a piece says about itself.

    Attributes:
        lines: the first is the piece's name.
        notice: further lines below them: warnings.
        at, along, size: middle of the text, direction of its lines (to the right) and height of its letters, mm.
    """

    lines: tuple[str, ...]
    notice: tuple[str, ...]
    at: Float[ndarray, "2"]
    along: Float[ndarray, "2"]
    size: float

    @property
    def all_lines(self) -> tuple[str, ...]:
        return (*self.lines, *self.notice)

    def is_bold(self, row: int) -> bool:
        return row == 0 or row >= len(self.lines)

    @property
    def corners(self) -> Float[ndarray, "4 2"]:
        """Of the box around it."""
        return _box(self.at, self.along, *_extent(self.lines, self.notice, self.size))

    @property
    def angle(self) -> float:
        """Of the lines, in degrees, from -90 to 90."""
        return float(np.degrees(np.arctan2(self.along[1], self.along[0])))

    def middle(self, row: int, upwards: bool = True) -> Float[ndarray, "2"]:
        """The middle of a line of text; `upwards`: the way y runs."""
        down = np.array((self.along[1], -self.along[0])) * (1 if upwards else -1)
        return self.at + LINE * self.size * (row - (len(self.all_lines) - 1) / 2) * down

    def map(self, move: Move) -> Label:
        """The label under an isometry, still readable."""
        at, along = _moved(self.at, self.along, move)
        return replace(self, at=at, along=along)


class Sight:
    """What is free on a piece.

    Args:
        inside: within the sewing lines.
        cut: within the cut line.
        marks: lines that are drawn there, such as notches.
    """

    def __init__(self, inside: Polygon, cut: Polygon, marks: Sequence[BaseGeometry] = ()):
        self.inside, self.cut = inside, cut
        self._lines = unary_union([inside.exterior, cut.exterior, *marks]).buffer(_CLEAR)
        self._taken: BaseGeometry = Polygon()
        self._kept: BaseGeometry = Polygon()

    def take(self, shape: BaseGeometry) -> None:
        """What is drawn there leaves no room for texts."""
        self._taken = self._taken.union(shape)

    def keep(self, shape: BaseGeometry) -> None:
        """Room that a label leaves for captions."""
        self._kept = self._kept.union(shape)

    def room(self) -> BaseGeometry:
        """Where a label may be."""
        return self.inside.buffer(-1.5).difference(self._taken).difference(self._kept)

    def holds(self, box: Polygon, where: BaseGeometry | None = None) -> bool:
        """Whether a text's box meets no line and no other text; `where`: what it has to lie in, if anything."""
        if box.intersects(self._taken) or box.intersects(self._lines):
            return False
        return where is None or where.contains(box)


def place_label(sight: Sight, lines: tuple[str, ...], notice: tuple[str, ...]) -> Label:
    """The label where its letters are largest: inside the piece or, where they would be too small to read, below it.

    On a narrow piece lines are joined and turned.
    """
    room, inside = sight.room(), sight.inside
    level = np.array((1.0, 0.0))
    at, size = _roomiest(room, inside, lines, notice)
    best = Label(lines, notice, at, level, size)
    if best.size < _READABLE:
        for count in (3, 8):
            joined = tuple(", ".join(lines[i : i + count]) for i in range(0, len(lines), count))
            for angle in (0, 90, 30, -30, 60, -60, 15, -15):
                along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
                turned = rotate(room, -angle, origin=(0, 0)), rotate(inside, -angle, origin=(0, 0))
                at, size = _roomiest(*turned, joined, notice)
                if size > 1.02 * best.size:
                    at = at[0] * along + at[1] * np.array((-along[1], along[0]))
                    best = Label(joined, notice, at, along, size)
    if best.size == 0:
        low, high = np.array(sight.cut.bounds[:2]), np.array(sight.cut.bounds[2:])
        _, height = _extent(lines, notice, _READABLE)
        best = Label(lines, notice, np.array(((low[0] + high[0]) / 2, low[1] - 2 - height / 2)), level, _READABLE)
    sight.take(Polygon(best.corners))
    return best


def place_captions(
    sight: Sight, edges: Sequence[Curve], marks: Sequence[tuple[str, Float[ndarray, "2"], Float[ndarray, "2"]]]
) -> tuple[Caption, ...]:
    """Captions of the two ends and of marks on the sewing lines.

    Args:
        sight: where there is room; takes what is placed.
        edges: the sewing lines, the first from the inner to the outer end.
        marks: name, foot on a sewing line, and unit vector from there into the piece.
    """
    captions = []
    for name, foot, inward in marks:
        captions.append(_first(sight, name, _beside(foot, inward), foot, -inward))
    lower, upper = edges[0], edges[-1].reversed()
    for name, a, b in (("inner end", lower, upper), ("outer end", lower.reversed(), upper.reversed())):
        tip, away = a.start, (_along(a, np.array([12.0])) + _along(b, np.array([12.0])))[0] - 2 * a.start
        outward = -away / max(float(np.linalg.norm(away)), 1e-9)
        captions.append(_first(sight, name, _from_tip(tip, a, b, outward, sight), tip, outward))
    return tuple(captions)


Place = tuple[Float[ndarray, "2"], Float[ndarray, "2"], BaseGeometry | None]
"""Middle and direction of a text, and what it has to lie in."""


def _first(
    sight: Sight, words: str, places: Callable[[str, float], Iterator[Place]], foot: ndarray, outward: ndarray
) -> Caption:
    """The caption at the first place that is free, else outside the piece with a leader."""
    for size in _CAPTIONS:
        for at, along, where in places(words, size):
            along = along if along[0] >= -1e-9 else -along
            caption = Caption(words, at, along, size)
            if sight.holds(Polygon(caption.corners), where):
                sight.take(Polygon(caption.corners).buffer(0.4))
                return caption
    level, size = np.array((1.0, 0.0)), _CAPTIONS[-1]
    caption = Caption(words, foot, level, size)
    for distance in np.arange(6.0, 60.0, 1.0):
        caption = Caption(words, foot + distance * outward, level, size)
        if sight.holds(Polygon(caption.corners)) and not sight.cut.intersects(Polygon(caption.corners)):
            break
    sight.take(Polygon(caption.corners).buffer(0.4))
    near = min((*caption.corners, *((caption.corners + np.roll(caption.corners, 1, 0)) / 2)),
               key=lambda corner: float(np.linalg.norm(corner - foot)))  # fmt: skip
    return replace(caption, leader=np.stack((near, foot)))


def _beside(foot: ndarray, inward: ndarray) -> Callable[[str, float], Iterator[Place]]:
    """Places inside a sewing line, the nearest first: level, then along the line."""
    edge = np.array((-inward[1], inward[0]))

    def places(words: str, size: float) -> Iterator[Place]:
        width = text_width(words, size)
        for distance in (1.0, 2.0, 3.5, 5.0, 7.0, 9.0, 12.0):
            for along in (np.array((1.0, 0.0)), edge):
                across = np.array((-along[1], along[0]))
                half = (abs(inward @ along) * width + abs(inward @ across) * size) / 2
                for shift in (0.0, 3.0, -3.0, 6.0, -6.0, 10.0, -10.0):
                    yield foot + (distance + half) * inward + shift * edge, along, None

    return places


def _from_tip(
    tip: ndarray, a: Curve, b: Curve, outward: ndarray, sight: Sight
) -> Callable[[str, float], Iterator[Place]]:
    """Places between two edges, from their common end on; last in the allowance beyond it.

    A sharp tip is narrow: there the text follows its middle line.
    """
    reach = np.arange(2.0, 0.45 * min(a.length, b.length, 150.0), 1.5)
    middles = (_along(a, reach) + _along(b, reach)) / 2

    def places(words: str, size: float) -> Iterator[Place]:
        for k, at in enumerate(middles[:-2]):
            beyond = middles[min(k + 3, len(middles) - 1)] - middles[max(k - 3, 0)]
            along = beyond / max(float(np.linalg.norm(beyond)), 1e-9)
            if np.linalg.norm(at - tip) < 30:
                for direction in (np.array((1.0, 0.0)), along):
                    yield at, direction, sight.inside
        across = np.array((-outward[1], outward[0]))
        for distance in (size / 2 + 1.2, size / 2 + 2.0, size / 2 + 3.0):
            yield tip + distance * outward, across, sight.cut

    return places


def _along(curve: Curve, distances: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
    """About the points at arc lengths from a curve's start."""
    points = curve.polyline(0.05)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.stack([np.interp(distances, lengths, points[:, i]) for i in range(2)], axis=-1)


def _roomiest(
    free: BaseGeometry, inside: Polygon, lines: Sequence[str], notice: Sequence[str]
) -> tuple[Float[ndarray, "2"], float]:
    """Middle and height of the letters of level lines of text, as large as fits; height 0: too small to read."""
    wide, high = _extent(lines, notice, 1.0)
    prepared = prep(free)
    parts = [part for part in getattr(free, "geoms", [free]) if part.area > 0] or [inside]
    low, high_corner = np.array(inside.bounds[:2]), np.array(inside.bounds[2:])
    grid = [low + (high_corner - low) * (x, y) for x in np.linspace(0.1, 0.9, 17) for y in np.linspace(0.15, 0.85, 11)]
    centres = [np.array(polylabel(part, 1.0).coords[0]) for part in parts if part.area > 0] + grid
    best, size, larger = centres[0], 0.0, _SMALLEST
    for centre in centres:
        while larger <= _LARGEST:
            half = np.array((wide, high)) * larger / 2
            corners = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * half + centre
            if not prepared.contains(Polygon(corners)):
                break
            best, size = centre, larger
            larger *= 1.05
    return best, size


def _extent(lines: Sequence[str], notice: Sequence[str], size: float) -> tuple[float, float]:
    """Width and height of lines of text."""
    widths = [text_width(words, size, bold=row == 0) for row, words in enumerate(lines)]
    widths += [text_width(words, size, bold=True) for words in notice]
    return max(widths), LINE * size * len(widths)


def _box(at: ndarray, along: ndarray, width: float, height: float) -> Float[ndarray, "4 2"]:
    across = np.array((-along[1], along[0]))
    a, b = width / 2 * along, height / 2 * across
    return np.stack((at - a - b, at + a - b, at + a + b, at - a + b))


def _moved(at: ndarray, along: ndarray, move: Move) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
    start, end = move(np.stack((at, at + along)))
    along = end - start
    return start, along if along[0] >= -1e-9 else -along
