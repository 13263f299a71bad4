"""Texts on pieces, and the label: where it collides with no line, no mark and no other text, as large as fits."""

from __future__ import annotations

import itertools
import math
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import shapely
from jaxtyping import Bool, Float
from numpy import ndarray
from shapely import MultiLineString, Polygon
from shapely.geometry.base import BaseGeometry

Move = Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]

LINE = 1.3
"""Distance of the lines of a label, in heights of its letters."""
_LETTER, _BOLD_LETTER = 0.62, 0.7
"""Width of a letter of a sans-serif face at most on average, in its height."""
_LARGEST, _READABLE, _SMALL = 5.0, 2.5, 1.7
"""Heights in mm of a label's letters: the largest, one that is read at a glance, and one that needs good light."""
_HEIGHTS = _SMALL * 1.05 ** np.arange(-4, int(np.log(_LARGEST / _SMALL) / np.log(1.05)) + 1)
"""Those that are tried. The least, 1.4 mm or 4 points, is what printers just draw legibly; it is taken before anything
that a cutter needs is left out."""
_ROWS = 6
"""Most lines that those of a narrow piece's label are joined to."""
_CLEAR = 0.8
"""Distance in mm that texts keep from lines, all but a hundredth."""
LEVEL = np.array((1.0, 0.0))
"""Direction of a level line."""
_TRIM = 4.0
"""Length in mm of a leader's last bit, which may lie within the mark that it leads to."""
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
        return box_corners(self.at, self.along, text_width(self.words, self.size), self.size)

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
        whole: all lines and warnings in full, also those that found no room; for files that do not depend on room.
    """

    lines: tuple[str, ...]
    notice: tuple[str, ...]
    at: Float[ndarray, "2"]
    along: Float[ndarray, "2"]
    size: float
    whole: tuple[str, ...] = ()

    @property
    def all_lines(self) -> tuple[str, ...]:
        return (*self.lines, *self.notice)

    def is_bold(self, row: int) -> bool:
        return row == 0 or row >= len(self.lines)

    @property
    def corners(self) -> Float[ndarray, "4 2"]:
        """Of the box around it."""
        return box_corners(self.at, self.along, *_extent(self.lines, self.notice, self.size))

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

    def __init__(self, inside: Polygon, cut: Polygon, marks: Sequence[Float[ndarray, "_ 2"]] = ()):
        self.inside, self.cut = inside, cut
        drawn = MultiLineString([self.inside.exterior.coords, self.cut.exterior.coords, *marks])
        self._lines = drawn.buffer(_CLEAR, quad_segs=4)
        for shape in (self.inside, self.cut, self._lines):
            shapely.prepare(shape)
        self._taken: list[BaseGeometry] = []

    def take(self, shape: BaseGeometry) -> None:
        """What is drawn there leaves no room for texts."""
        self._taken.append(shape)

    def room(self) -> BaseGeometry:
        """Where a label may be."""
        return self.inside.buffer(-_LABEL_CLEAR).difference(shapely.union_all(self._taken))

    def taken(self, box: Polygon) -> bool:
        """Whether a box meets a line, another text or the piece."""
        return not bool(self.free(np.array([box]))[0]) or bool(box.intersects(self.cut))

    def passable(self, starts: Float[ndarray, "n 2"], foot: Float[ndarray, "2"]) -> Bool[ndarray, " n"]:
        """From which of these places a leader meets no text and no mark on its way to a foot, the last bit apart."""
        way = foot - starts
        far = np.linalg.norm(way, axis=1, keepdims=True)
        ends = foot - way / np.maximum(far, 1e-9) * np.minimum(_TRIM, far)
        leaders = np.asarray(shapely.linestrings(np.stack((starts, ends), axis=1)))
        free = np.ones(len(starts), bool)
        for shape in self._taken:
            free &= ~shapely.intersects(shape, leaders)
        return free

    def free(self, boxes: ndarray) -> Bool[ndarray, " n"]:
        """Which of these polygons, the boxes around texts, meet no line and no other text."""
        free = ~shapely.intersects(self._lines, boxes)
        for shape in self._taken:
            free &= ~shapely.intersects(shape, boxes)
        return free


def place_label(sight: Sight, stages: Sequence[tuple[str, ...]], notices: Sequence[tuple[str, ...]]) -> Label:
    """The label where its letters are largest: on the piece or, where not even its first line has room, below it.

    On a narrow piece warnings are shortened and lines are joined and turned. Where that does not do, lines are left
    out; those that a cutter needs only where they do not fit in the smallest letters.

    Args:
        sight: where there is room; takes what is placed.
        stages: the lines in full, those that a cutter needs, and then ever fewer; what is in all of them is never left
            out.
        notices: the warnings below them, in full and then ever shorter; an empty one is for the last two stages.
    """
    room = sight.room()
    shapely.prepare(room)
    told = [notice for notice in notices if notice] or [()]
    lines, fewer = stages[0], [(kept, told[-1]) for kept in stages[1:-2]]
    fewer += [(kept, notice) for kept in stages[1:][-2:] for notice in (told[-1], notices[-1])]
    best = Label(lines, notices[0], np.zeros(2), LEVEL, 0.0)
    whole = (*lines, *notices[0])
    for kept, notice in dict.fromkeys([*((lines, notice) for notice in told), *fewer]):
        least = _READABLE if kept == lines and notice in told[:2] else _SMALL if kept in stages[:2] else _HEIGHTS[0]
        if best.size >= least:
            break
        best = _largest(best, room, sight, kept, notice)
    if best.size == 0:
        low, high = np.array(sight.cut.bounds[:2]), np.array(sight.cut.bounds[2:])
        _, height = _extent(lines, notices[0], _READABLE)
        at = np.array(((low[0] + high[0]) / 2, low[1] - 2 - height / 2))
        best = Label(lines, notices[0], at, LEVEL, _READABLE)
    sight.take(Polygon(best.corners))
    return replace(best, whole=whole)


def _largest(
    best: Label,
    room: BaseGeometry,
    sight: Sight,
    lines: tuple[str, ...],
    notice: tuple[str, ...],
) -> Label:
    """The best label so far or, if that is plainly larger, one of these lines: level or, if that is too small to read,
    joined and turned."""
    best = _larger(best, room, sight, lines, notice, LEVEL)
    for rows in _joined(lines) if best.size < _READABLE else ():
        for angle in (0, 90, 30, -30, 60, -60, 15, -15):
            along = np.array((math.cos(math.radians(angle)), math.sin(math.radians(angle))))
            best = _larger(best, room, sight, rows, notice, along)
    return best


def _larger(
    best: Label,
    room: BaseGeometry,
    sight: Sight,
    lines: tuple[str, ...],
    notice: tuple[str, ...],
    along: Float[ndarray, "2"],
) -> Label:
    """A label where it is largest, or the best so far, unless that is plainly smaller."""
    at, size = _roomiest(room, sight.inside, along, lines, notice, 1.02 * best.size)
    return Label(lines, notice, at, along, size) if size > 0 else best


@lru_cache(maxsize=64)
def _joined(lines: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """The lines joined to one, to two and to more, each time so that the longest is as short as can be."""
    widths = np.array([text_width(f"{words}, ", 1.0) for words in lines])
    ends = np.concatenate(([0.0], widths.cumsum()))
    found = []
    for count in range(1, min(_ROWS, len(lines) - 1) + 1):
        ways = ((0, *cuts, len(lines)) for cuts in itertools.combinations(range(1, len(lines)), count - 1))
        best = min(ways, key=lambda way: max(ends[b] - ends[a] for a, b in itertools.pairwise(way)))
        found.append(tuple(", ".join(lines[a:b]) for a, b in itertools.pairwise(best)))
    return tuple(found)


def _roomiest(
    room: BaseGeometry,
    inside: Polygon,
    along: Float[ndarray, "2"],
    lines: Sequence[str],
    notice: Sequence[str],
    above: float = 0.0,
) -> tuple[Float[ndarray, "2"], float]:
    """Middle and height of the letters of lines of text, as large as fits; height 0: too small.

    Args:
        room: prepared; where the text may be.
        inside: the piece within its sewing lines.
        along: the direction of the lines.
        lines: of the label.
        notice: lines of warnings below them.
        above: what the height must exceed, mm, besides being one that can be read.
    """
    turn = np.stack((along, (-along[1], along[0])))
    outline = shapely.get_coordinates(inside) @ turn.T
    low, high = outline.min(0), outline.max(0)
    shares = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 17), np.linspace(0.15, 0.85, 11), indexing="ij"), axis=-1)
    centres = (low + (high - low) * shares.reshape(-1, 2)) @ turn
    if room.area > 0:
        radius = shapely.maximum_inscribed_circle(room, tolerance=1.0)  # type: ignore[arg-type]
        centres = np.vstack((shapely.get_coordinates(radius)[:1], centres))
    extent = np.array(_extent(lines, notice, 1.0))
    sizes = _HEIGHTS[above < _HEIGHTS]

    def fits(size: float) -> Bool[ndarray, " n"]:
        return np.asarray(shapely.contains(room, polygons(box_corners(centres, along[None], *(size * extent)))))

    # a text that fits fits smaller as well: the largest size that fits somewhere by bisection
    fit, at, least, most = 0.0, centres[0], 0, len(sizes)
    while least < most:
        k = (least + most) // 2 if fit else least
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


def box_corners(
    at: Float[ndarray, "*n 2"], along: Float[ndarray, "*#n 2"], width: float, height: float
) -> Float[ndarray, "*n 4 2"]:
    across = np.stack((-along[..., 1], along[..., 0]), axis=-1)
    a, b = width / 2 * along, height / 2 * across
    return np.stack((at - a - b, at + a - b, at + a + b, at - a + b), axis=-2)


def polygons(rings: Float[ndarray, "n k 2"]) -> ndarray:
    return np.asarray(shapely.polygons(rings))


def _moved(at: ndarray, along: ndarray, move: Move) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
    start, end = move(np.stack((at, at + along)))
    along = end - start
    return start, along if along[0] >= -1e-9 else -along
