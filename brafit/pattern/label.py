"""Texts on pieces: where they collide with no line, no mark and no other text, as large as fits."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from jaxtyping import Bool, Float
from numpy import ndarray
from shapely import MultiLineString, Polygon
from shapely.geometry.base import BaseGeometry

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
"""Distance in mm that texts keep from lines, all but a hundredth."""
_LABEL_CLEAR = 1.5
"""Distance in mm that a label keeps from sewing lines."""


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
        inside: within the sewing lines, to 0.02 mm.
        cut: within the cut line.
        marks: lines that are drawn there, such as notches.
    """

    def __init__(self, inside: Polygon, cut: Polygon, marks: Sequence[Float[ndarray, "2 2"]] = ()):
        self.inside, self.cut = inside, cut
        drawn = MultiLineString([self.inside.exterior.coords, self.cut.exterior.coords, *marks])
        self._lines = drawn.buffer(_CLEAR, quad_segs=4)
        for shape in (self.inside, self.cut, self._lines):
            shapely.prepare(shape)
        self._taken: list[BaseGeometry] = []
        self._kept: list[BaseGeometry] = []

    def take(self, shape: BaseGeometry) -> None:
        """What is drawn there leaves no room for texts."""
        self._taken.append(shape)

    def keep(self, shape: BaseGeometry) -> None:
        """Room that a label leaves for captions."""
        self._kept.append(shape)

    def room(self) -> BaseGeometry:
        """Where a label may be."""
        return self.inside.buffer(-_LABEL_CLEAR).difference(shapely.union_all([*self._taken, *self._kept]))

    def free(self, boxes: ndarray) -> Bool[ndarray, " n"]:
        """Which of these polygons, the boxes around texts, meet no line and no other text."""
        free = ~shapely.intersects(self._lines, boxes)
        for shape in self._taken:
            free &= ~shapely.intersects(shape, boxes)
        return free


def place_label(sight: Sight, lines: tuple[str, ...], notice: tuple[str, ...]) -> Label:
    """The label where its letters are largest: inside the piece or, where they would be too small to read, below it.

    On a narrow piece lines are joined and turned.
    """
    room, level = sight.room(), np.array((1.0, 0.0))
    shapely.prepare(room)
    at, size = _roomiest(room, sight.inside, level, lines, notice)
    best = Label(lines, notice, at, level, size)
    if best.size < _READABLE:
        for count in (3, 8):
            joined = tuple(", ".join(lines[i : i + count]) for i in range(0, len(lines), count))
            for angle in (0, 90, 30, -30, 60, -60, 15, -15):
                along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
                at, size = _roomiest(room, sight.inside, along, joined, notice)
                if size > 1.02 * best.size:
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


@dataclass(frozen=True)
class _Places:
    """Where a text may stand, the best first: middles and directions.

    `within`: the polygon that it has to lie in there, if any.
    """

    at: Float[ndarray, "n 2"]
    along: Float[ndarray, "n 2"]
    within: Polygon | None = None


def _first(
    sight: Sight, words: str, places: Callable[[str, float], Sequence[_Places]], foot: ndarray, outward: ndarray
) -> Caption:
    """The caption at the first place that is free, else outside the piece with a leader."""
    level = np.array((1.0, 0.0))
    for size in _CAPTIONS:
        for group in places(words, size):
            along = np.where(group.along[:, :1] >= -1e-9, 1.0, -1.0) * group.along
            boxes = _polygons(_box(group.at, along, text_width(words, size), size))
            free = sight.free(boxes)
            if group.within is not None:
                free &= shapely.contains(group.within, boxes)
            if free.any():
                k = int(free.argmax())
                sight.take(boxes[k].buffer(0.4))
                return Caption(words, group.at[k], along[k], size)
    size = _CAPTIONS[-1]
    at = foot + np.arange(6.0, 60.0)[:, None] * outward
    boxes = _polygons(_box(at, level[None], text_width(words, size), size))
    free = sight.free(boxes) & ~shapely.intersects(sight.cut, boxes)
    k = int(free.argmax()) if free.any() else len(at) - 1
    caption = Caption(words, at[k], level, size)
    sight.take(boxes[k].buffer(0.4))
    near = min((*caption.corners, *((caption.corners + np.roll(caption.corners, 1, 0)) / 2)),
               key=lambda corner: float(np.linalg.norm(corner - foot)))  # fmt: skip
    return replace(caption, leader=np.stack((near, foot)))


def _beside(foot: ndarray, inward: ndarray) -> Callable[[str, float], Sequence[_Places]]:
    """Places inside a sewing line, the nearest first: level, then along the line."""
    edge = np.array((-inward[1], inward[0]))
    distance, way, shift = (
        values.ravel()
        for values in np.meshgrid(
            (1.0, 2.0, 3.5, 5.0, 7.0, 9.0, 12.0), (0, 1), (0.0, 3.0, -3.0, 6.0, -6.0, 10.0, -10.0), indexing="ij"
        )
    )
    along = np.stack((np.array((1.0, 0.0)), edge))
    across = np.stack((-along[:, 1], along[:, 0]), axis=-1)

    def places(words: str, size: float) -> Sequence[_Places]:
        half = (np.abs(along @ inward) * text_width(words, size) + np.abs(across @ inward) * size) / 2
        return [_Places(foot + (distance + half[way])[:, None] * inward + shift[:, None] * edge, along[way])]

    return places


def _from_tip(
    tip: ndarray, a: Curve, b: Curve, outward: ndarray, sight: Sight
) -> Callable[[str, float], Sequence[_Places]]:
    """Places between two edges, from their common end on; last in the allowance beyond it.

    A sharp tip is narrow: there the text follows its middle line.
    """
    reach = np.arange(2.0, 0.45 * min(a.length, b.length, 150.0), 1.5)
    middles = (_along(a, reach) + _along(b, reach)) / 2
    k = np.arange(len(middles))
    beyond = middles[np.minimum(k + 3, len(k) - 1)] - middles[np.maximum(k - 3, 0)]
    follow = beyond / np.maximum(np.linalg.norm(beyond, axis=1, keepdims=True), 1e-9)
    near = (k < len(k) - 2) & (np.linalg.norm(middles - tip, axis=1) < 30)
    directions = np.stack((np.broadcast_to((1.0, 0.0), follow.shape), follow), axis=1)[near]
    across = np.array((-outward[1], outward[0]))

    def places(words: str, size: float) -> Sequence[_Places]:
        between = _Places(np.repeat(middles[near], 2, axis=0), directions.reshape(-1, 2), sight.inside)
        out = tip + (size / 2 + np.array((1.2, 2.0, 3.0)))[:, None] * outward
        return [between, _Places(out, np.broadcast_to(across, out.shape), sight.cut)]

    return places


def _along(curve: Curve, distances: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
    """About the points at arc lengths from a curve's start."""
    points = curve.polyline(0.05)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.stack([np.interp(distances, lengths, points[:, i]) for i in range(2)], axis=-1)


def _roomiest(
    room: BaseGeometry, inside: Polygon, along: Float[ndarray, "2"], lines: Sequence[str], notice: Sequence[str]
) -> tuple[Float[ndarray, "2"], float]:
    """Middle and height of the letters of lines of text, as large as fits; height 0: too small to read.

    Args:
        room: prepared; where the text may be.
        inside: the piece within its sewing lines.
        along: the direction of the lines.
        lines: of the label.
        notice: lines of warnings below them.
    """
    turn = np.stack((along, (-along[1], along[0])))
    outline = shapely.get_coordinates(inside) @ turn.T
    low, high = outline.min(0), outline.max(0)
    shares = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 17), np.linspace(0.15, 0.85, 11), indexing="ij"), axis=-1)
    centres = (low + (high - low) * shares.reshape(-1, 2)) @ turn
    if room.area > 0:
        radius = shapely.maximum_inscribed_circle(room, tolerance=1.0)  # type: ignore[arg-type]
        centres = np.vstack((shapely.get_coordinates(radius)[:1], centres))
    sizes = _SMALLEST * 1.05 ** np.arange(int(np.log(_LARGEST / _SMALLEST) / np.log(1.05)) + 1)
    extent = np.array(_extent(lines, notice, 1.0))

    def fits(size: float) -> Bool[ndarray, " n"]:
        return np.asarray(shapely.contains(room, _polygons(_box(centres, along[None], *(size * extent)))))

    # a text that fits fits smaller as well: the largest size that fits somewhere by bisection
    fit, at, least, most = 0.0, centres[0], 0, len(sizes)
    while least < most:
        k = (least + most) // 2
        found = fits(sizes[k])
        if found.any():
            fit, centres, least = float(sizes[k]), centres[found], k + 1
            at = centres[0]
        else:
            most = k
    return at, fit


def _extent(lines: Sequence[str], notice: Sequence[str], size: float) -> tuple[float, float]:
    """Width and height of lines of text."""
    widths = [text_width(words, size, bold=row == 0) for row, words in enumerate(lines)]
    widths += [text_width(words, size, bold=True) for words in notice]
    return max(widths), LINE * size * len(widths)


def _box(
    at: Float[ndarray, "*n 2"], along: Float[ndarray, "*#n 2"], width: float, height: float
) -> Float[ndarray, "*n 4 2"]:
    across = np.stack((-along[..., 1], along[..., 0]), axis=-1)
    a, b = width / 2 * along, height / 2 * across
    return np.stack((at - a - b, at + a - b, at + a + b, at - a + b), axis=-2)


def _polygons(rings: Float[ndarray, "n k 2"]) -> ndarray:
    return np.asarray(shapely.polygons(rings))


def _moved(at: ndarray, along: ndarray, move: Move) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
    start, end = move(np.stack((at, at + along)))
    along = end - start
    return start, along if along[0] >= -1e-9 else -along
