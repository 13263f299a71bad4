"""Patterns of several sizes or scans in one drawing: laid on one another as graded nests are, or side by side."""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray
from shapely import Polygon

from brafit.pattern import CutPiece, Pattern, layout, layout_columns
from brafit.pattern.allowance import valid_polygon
from brafit.pattern.drawing import INFO, Item, Stroke, Words, drawn, line_of
from brafit.pattern.finish import warnings_of
from brafit.pattern.label import text_width
from brafit.pattern.marks import BUST_POINT, MATCH_POINT
from brafit.sizing.callouts import callouts, size_names_on

Align = Literal["apex", "wire", "none"]
ALIGNS: tuple[Align, ...] = ("apex", "wire", "none")
GAP, NAME = 12.0, 4.0
"""Between pieces that lie side by side, and height of the letters of their names, mm."""
HUES = 24
"""Colours that are told apart; DXF's wheel of colours has so many hues."""
FEW = 4
"""So many sizes are told apart by hue alone; of more every other one is darker."""
_VALUES = (0.74, 0.41)
"""How light the colours are, of 1: those of DXF's wheel with an index that ends in 2 and in 6."""


@dataclass(frozen=True)
class Layer:
    """All that is drawn of one size.

    Attributes:
        name: of the size.
        hue: number of its colour, 0 to HUES - 1.
        shade: 0, or 1 where the colour is a darker one.
        items: its lines, piece by piece (`group`), and its name on each; the pieces' own texts only where pieces lie
            side by side, for otherwise they would lie on one another and have lines to the names of the marks instead.
            All are of the series `name`.
        about: what tells its cup from others, for the list of sizes; may be empty.
    """

    name: str
    hue: int
    items: tuple[Item, ...]
    about: str = ""
    shade: int = 0

    @property
    def colour(self) -> str:
        """RGB, such as `#bd0000`."""
        return _colour(self.hue, self.shade)

    @property
    def colour_index(self) -> int:
        """The colour of DXF that comes nearest."""
        return 12 + 10 * self.hue + 4 * self.shade


@dataclass(frozen=True)
class Nest:
    """A drawing of several sizes, mm, y up, its origin in the lower left corner.

    Attributes:
        layers: a size each.
        width, height: of all of them.
        patterns: of which it is.
        names: of pieces that lie on one another, beside them; then those of their marks.
        unlike: warnings of pieces that lie on one another though they are no sizes of one piece.
    """

    layers: tuple[Layer, ...]
    width: float
    height: float
    patterns: tuple[Pattern, ...]
    names: tuple[Words, ...] = ()
    unlike: tuple[str, ...] = ()

    @property
    def warnings(self) -> list[str]:
        """Those of the nest and of its patterns."""
        return [*self.unlike, *warnings_of(self.patterns)]


@dataclass(frozen=True)
class _Placed:
    """Pieces that keep their places to each other: what `layout` moves as one."""

    pieces: tuple[tuple[int, CutPiece], ...]

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        outlines = np.concatenate([piece.cut_outline() for _, piece in self.pieces])
        return outlines.min(0), outlines.max(0)

    def map(self, function: Callable[[Any], Any], /) -> _Placed:
        return _Placed(tuple((k, piece.map(function)) for k, piece in self.pieces))


def nested(patterns: Sequence[Pattern], align: Align = "apex", about: Sequence[str] = ()) -> Nest:
    """Patterns in one drawing, each a layer with a colour of its own.

    With `apex` and `wire`, pieces of the same name lie on one another, not turned: all have their lower edge's chord
    level, so grain lines are parallel. What lies on one point is with `wire` the inner end of the lower edge, with
    `apex` the notch where both pieces of a seam meet nearest to the bust point, or the bust point's hole where there is
    no such notch, or else the middle of the lower edge.

    Args:
        patterns: of one side, the smallest first; with `none` of either side.
        align: how they lie to each other; with `none` side by side.
        about: of each pattern what tells its cup from others; empty: nothing is told.

    Raises:
        ValueError: no patterns.
    """
    if not patterns:
        raise ValueError("a nest has at least one pattern")
    whole = [tuple(piece for column in pattern.drawn for piece in column) for pattern in patterns]
    several = any(len({piece.side for piece in pieces}) > 1 for pieces in whole)
    if align == "none":
        sheet = layout_columns([[_Placed(((k, piece),)) for piece in pieces] for k, pieces in enumerate(whole)], GAP)
    else:
        sheet = layout(_stacks(patterns, align), GAP)
    placed = [entry for stack in sheet.pieces for entry in stack.pieces]
    named = [] if align == "none" else [_named_stack(stack, patterns, several) for stack in sheet.pieces]
    own_names = [words for one in named for words in one.sizes]
    leaders = [line for one in named for line in one.leaders]
    layers = []
    for k, pattern in enumerate(patterns):
        hue, shade = _hue(k, len(patterns)), k % 2 * (len(patterns) > FEW)
        items: list[Item] = []
        for place, piece in ((place, piece) for place, (owner, piece) in enumerate(placed) if owner == k):
            if align == "none":
                items += drawn(piece, _named(piece, several))
            else:
                items += [*_lines(piece, several), own_names[place]]
        items += [line for owner, line in leaders if owner == k]
        own = {"series": pattern.size, "colour": _colour(hue, shade)}
        told = about[k] if about else ""
        layers.append(Layer(pattern.size, hue, tuple(replace(item, **own) for item in items), told, shade))
    names = (*(one.name for one in named), *(mark for one in named for mark in one.marks))
    unlike = () if align == "none" else tuple(_unlike(patterns))
    return Nest(tuple(layers), sheet.width, sheet.height, tuple(patterns), names, unlike)


def _stacks(patterns: Sequence[Pattern], align: Align) -> list[_Placed]:
    """Pieces of one name and side on one another, from the wire up: of cups of different numbers of panels too."""
    stacks: dict[str, list[tuple[int, CutPiece]]] = {}
    heights: dict[str, tuple[int, float]] = {}
    for k, pattern in enumerate(patterns):
        for side, column in enumerate(pattern.drawn):
            for row, piece in enumerate(column):
                at, name = anchor(piece, align), f"{piece.name} {piece.side}"
                stacks.setdefault(name, []).append((k, piece.map(lambda points, at=at: points - at)))
                heights.setdefault(name, (side, row / max(len(column) - 1, 1)))
    return [_Placed(tuple(stacks[name])) for name in sorted(stacks, key=heights.__getitem__)]


def _unlike(patterns: Sequence[Pattern]) -> list[str]:
    """Where cups have different numbers of panels: the lower panel of two is no other size of that of three."""
    by_count: dict[int, list[str]] = {}
    for pattern in patterns:
        by_count.setdefault(len(pattern.pieces), []).append(pattern.name)
    if len(by_count) == 1:
        return []
    told = "; ".join(f"{n} panel{'s' * (n > 1)}: {', '.join(own)}" for n, own in sorted(by_count.items()))
    words = f"the cups have different numbers of panels ({told}), so pieces of one name are different parts of them"
    return [f"{words}; lay them side by side (--align none), or nest cups of one number"]


def anchor(piece: CutPiece, align: Align) -> Float[ndarray, "2"]:
    """The point of a piece that lies on that of the other sizes, see `nested`."""
    lower = piece.sew[0].curve
    if align == "wire":
        return lower.start
    feet = [notch.foot for notch in piece.notches if notch.name in (MATCH_POINT, BUST_POINT)]
    holes = [hole.point for hole in piece.holes if hole.name == BUST_POINT]
    return [*feet, *holes, lower.at(lower.length / 2)[0]][0]


def _hue(k: int, count: int) -> int:
    """Colours as far apart as so many sizes allow; more than there are begin anew."""
    return k * HUES // count if count <= HUES else k % HUES


def _colour(hue: int, shade: int) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in colorsys.hsv_to_rgb(hue / HUES, 1.0, _VALUES[shade]))


def _lines(piece: CutPiece, several: bool) -> list[Item]:
    """What is drawn of a piece but its texts."""
    return [item for item in drawn(piece, _named(piece, several)) if isinstance(item, Stroke) and item.role != "leader"]


def _named(piece: CutPiece, several: bool) -> str:
    return f"{piece.name} {piece.side}" if several else piece.name


def _stack_name(stack: _Placed, several: bool) -> Words:
    """The name of pieces that lie on one another, in a corner that they leave free."""
    name, (low, high) = _named(stack.pieces[0][1], several), stack.bounds
    cloth = shapely.union_all([valid_polygon(piece.cut_outline(0.5)) for _, piece in stack.pieces])
    half = np.array((text_width(name, NAME, bold=True), NAME)) / 2
    corners = ((low[0], high[1]), (high[0], high[1]), low, (high[0], low[1]))
    words = [Words(name, np.clip(corner, low + half, high - half), NAME, bold=True, layer=INFO) for corner in corners]
    return min(words, key=lambda own: cloth.intersection(Polygon(own.corners).buffer(1.0)).area)


@dataclass(frozen=True)
class _Texts:
    """What is written about pieces that lie on one another.

    Attributes:
        name: of the pieces.
        sizes: the name of each piece's size, on the piece.
        marks: names of their marks.
        leaders: lines from these to the marks, each with the number of its pattern.
    """

    name: Words
    sizes: Sequence[Words]
    marks: Sequence[Words]
    leaders: Sequence[tuple[int, Stroke]]


def _named_stack(stack: _Placed, patterns: Sequence[Pattern], several: bool) -> _Texts:
    name = _stack_name(stack, several)
    pieces = [piece for _, piece in stack.pieces]
    sizes = size_names_on(pieces, [patterns[k].size for k, _ in stack.pieces], name)
    called = callouts(pieces, [name, *sizes])
    lines = []
    for k, ends in (leader for callout in called for leader in callout.leaders):
        owner, piece = stack.pieces[k]
        lines.append((owner, Stroke("text", "leader", "leader", (line_of(ends),), group=_named(piece, several))))
    return _Texts(name, sizes, [callout.words for callout in called], lines)
