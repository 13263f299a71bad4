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
from brafit.sizing.callouts import callouts

Align = Literal["apex", "wire", "none"]
ALIGNS: tuple[Align, ...] = ("apex", "wire", "none")
GAP, NAME = 12.0, 4.0
"""Between pieces that lie side by side, and height of the letters of their names, mm."""
HUES = 24
"""Colours that are told apart; DXF's wheel of colours has so many hues."""
_DARK = 0.74


@dataclass(frozen=True)
class Layer:
    """All that is drawn of one size.

    Attributes:
        name: of the size.
        hue: number of its colour, 0 to HUES - 1.
        items: its lines, piece by piece (`group`), and its name on each; the pieces' own texts only where pieces lie
            side by side, for otherwise they would lie on one another and have lines to the names of the marks instead.
            All are of the series `name`.
        about: what tells its cup from others, for the list of sizes; may be empty.
    """

    name: str
    hue: int
    items: tuple[Item, ...]
    about: str = ""

    @property
    def colour(self) -> str:
        """RGB, such as `#bd0000`."""
        return _colour(self.hue)

    @property
    def colour_index(self) -> int:
        """The colour of DXF that comes nearest."""
        return 12 + 10 * self.hue


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
        stacks: dict[str, list[tuple[int, CutPiece]]] = {}
        for k, pieces in enumerate(whole):
            for piece in pieces:
                at = anchor(piece, align)
                name = f"{piece.name} {piece.side}"
                stacks.setdefault(name, []).append((k, piece.map(lambda points, at=at: points - at)))
        sheet = layout([_Placed(tuple(stack)) for stack in stacks.values()], GAP)
    placed = [entry for stack in sheet.pieces for entry in stack.pieces]
    named = [] if align == "none" else [_named_stack(stack, patterns, several) for stack in sheet.pieces]
    leaders = [line for _, _, lines in named for line in lines]
    layers = []
    for k, pattern in enumerate(patterns):
        hue, items = _hue(k, len(patterns)), []
        for piece in (piece for owner, piece in placed if owner == k):
            if align == "none":
                items += drawn(piece, _named(piece, several))
            else:
                items += [*_lines(piece, several), _size(piece, pattern.size, k, len(patterns))]
        items += [line for owner, line in leaders if owner == k]
        own = {"series": pattern.size, "colour": _colour(hue)}
        told = about[k] if about else ""
        layers.append(Layer(pattern.size, hue, tuple(replace(item, **own) for item in items), told))
    names = (*(name for name, _, _ in named), *(mark for _, marks, _ in named for mark in marks))
    unlike = () if align == "none" else tuple(_unlike(patterns))
    return Nest(tuple(layers), sheet.width, sheet.height, tuple(patterns), names, unlike)


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


def _colour(hue: int) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in colorsys.hsv_to_rgb(hue / HUES, 1.0, _DARK))


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


def _named_stack(
    stack: _Placed, patterns: Sequence[Pattern], several: bool
) -> tuple[Words, list[Words], list[tuple[int, Stroke]]]:
    """The name of pieces that lie on one another, the names of their marks, and the lines from these to the marks, each
    with the number of its pattern."""
    name = _stack_name(stack, several)
    sizes = [_size(piece, patterns[k].size, k, len(patterns)) for k, piece in stack.pieces]
    called = callouts([piece for _, piece in stack.pieces], [name, *sizes])
    lines = []
    for k, ends in (leader for callout in called for leader in callout.leaders):
        owner, piece = stack.pieces[k]
        lines.append((owner, Stroke("text", "leader", "leader", (line_of(ends),), group=_named(piece, several))))
    return name, [callout.words for callout in called], lines


def _size(piece: CutPiece, name: str, k: int, count: int) -> Words:
    """A size's name inside the upper edge of its piece, each at another place of that."""
    upper = piece.sew[-1].curve
    at, along = upper.at(upper.length * (0.1 + 0.8 * (k + 0.5) / count))
    inward = np.array((-along[1], along[0]))
    if piece.side == "right":
        inward = -inward
    return Words(name, at + 3.0 * inward, 3.0)
