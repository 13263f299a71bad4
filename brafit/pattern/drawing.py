"""What is drawn of a piece, in one neutral form: strokes and texts on layers. The writers only translate it.

Millimetres, y up. A layer holds one kind of line: `cut`, `sew`, `notch`, `drill`, `grain`, `text`; what belongs to no
piece is on the layer `info`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.pattern.curve import Curve
from brafit.pattern.finish import CutPiece
from brafit.pattern.label import Caption, box_corners, text_width
from brafit.pattern.notch import Notch
from brafit.pattern.piece import Hole, Kind

Move = Callable[[Float[ndarray, "n 2"]], Float[ndarray, "n 2"]]

LAYERS = ("cut", "sew", "notch", "drill", "grain", "text")
"""Of pieces, in the order in which they are drawn."""
INFO = "info"
BLACK, RED, GREY = "#000000", "#c00000", "#808080"


@dataclass(frozen=True)
class Pen:
    """Colour, width (mm) and dashes (mm drawn, mm left out) of a line."""

    colour: str
    width: float
    dashes: tuple[float, ...] = ()


# Told apart by colour, width and dashes, so that a black-and-white print shows them too.
PENS: Mapping[str, Pen] = {
    "cut": Pen(BLACK, 0.3),
    "wire": Pen("#0b5394", 0.7),
    "ridge": Pen("#b4460f", 0.4, (6.0, 1.5)),
    "upper": Pen("#2e6b34", 0.4, (1.2, 1.2)),
    "mark": Pen(BLACK, 0.35),
    "leader": Pen(BLACK, 0.15),
    "frame": Pen(BLACK, 0.2),
    "glue": Pen(GREY, 0.15),
    "fold": Pen(GREY, 0.15, (2.0, 2.0)),
}
SEWING: Mapping[Kind, str] = {"wire": "wire edge", "ridge": "seam between panels", "upper": "upper edge"}
"""What the sewing lines are called."""


@dataclass(frozen=True)
class Stroke:
    """A line, or several that make one mark.

    Attributes:
        layer: see above.
        pen: one of `PENS`.
        role: what it is, such as `edge wire`, `cut`, `notch`.
        paths: each one curve after another.
        closed: whether each path returns to its start.
        name: of the edge, the notch or the mark; may be empty.
        place: for marks that are points to a cutting machine, the place and the direction into the piece in degrees.
        about: further facts for files that can hold them, by names fit for XML attributes.
        group: what it belongs to: a piece, a part of the legend.
        series: the size that it belongs to, where there are several.
        fill: colour of what a closed path holds; empty: none.
        colour: of the line, where it is not the pen's.
    """

    layer: str
    pen: str
    role: str
    paths: tuple[tuple[Curve, ...], ...]
    closed: bool = False
    name: str = ""
    place: tuple[tuple[Float[ndarray, "2"], float], ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)
    group: str = ""
    series: str = ""
    fill: str = ""
    colour: str = ""

    @property
    def ink(self) -> str:
        """The colour that is seen."""
        return self.colour or PENS[self.pen].colour

    def map(self, move: Move) -> Stroke:
        """Under an isometry."""
        turned = []
        for point, angle in self.place:
            ahead = point + np.array((np.cos(np.radians(angle)), np.sin(np.radians(angle))))
            start, end = move(np.stack((point, ahead)))
            turned.append((start, float(np.degrees(np.arctan2(*(end - start)[::-1])))))
        paths = tuple(tuple(curve.map(move) for curve in path) for path in self.paths)
        return replace(self, paths=paths, place=tuple(turned))


@dataclass(frozen=True)
class Words:
    """A line of text.

    Attributes:
        at: half way up its letters; its middle, or its start where it is not `centred`.
        along: direction of the line.
        size: height of the letters, mm.
    """

    text: str
    at: Float[ndarray, "2"]
    size: float
    along: Float[ndarray, "2"] = field(default_factory=lambda: np.array((1.0, 0.0)))
    bold: bool = False
    colour: str = BLACK
    centred: bool = True
    layer: str = "text"
    name: str = ""
    group: str = ""
    series: str = ""

    @property
    def angle(self) -> float:
        """Of the line, in degrees."""
        return float(np.degrees(np.arctan2(self.along[1], self.along[0])))

    @property
    def corners(self) -> Float[ndarray, "4 2"]:
        """Of the box around it."""
        width = text_width(self.text, self.size, self.bold)
        middle = self.at if self.centred else self.at + width / 2 * self.along
        return box_corners(middle, self.along, width, self.size)

    def map(self, move: Move) -> Words:
        """Under an isometry that keeps texts readable."""
        start, end = move(np.stack((self.at, self.at + self.along)))
        return replace(self, at=start, along=end - start)


Item = Stroke | Words


@dataclass(frozen=True)
class Page:
    """A page, mm, y up.

    Attributes:
        items: all over the page.
        within: what is shown only within `frame` (left, bottom, width, height).
    """

    width: float
    height: float
    items: tuple[Item, ...]
    within: tuple[Item, ...] = ()
    frame: tuple[float, float, float, float] | None = None


def shifted(items: Iterable[Item], by: Float[ndarray, "2"] | tuple[float, float]) -> list[Item]:
    """Items moved."""
    return [item.map(lambda points: points + np.asarray(by)) for item in items]


def line_of(points: Float[ndarray, "n 2"] | Sequence[Sequence[float]]) -> tuple[Curve, ...]:
    """A path that goes straight from point to point."""
    return (Curve.line(*np.asarray(points, float)),)


def circle(centre: Float[ndarray, "2"], radius: float) -> tuple[Curve, ...]:
    """A circle of four arcs, true to 3e-4 of its radius."""
    k = 4 / 3 * (np.sqrt(2) - 1)
    quarter = np.array(((1, 0), (1, k), (k, 1), (0, 1)), float)
    turn = np.array(((0, 1), (-1, 0)), float)
    arcs = [quarter]
    for _ in range(3):
        arcs.append(arcs[-1] @ turn)
    return (Curve(centre + radius * np.stack(arcs)),)


def drawn(piece: CutPiece, group: str, series: str = "") -> list[Item]:
    """All that is drawn of a piece, from the cut line to the texts."""
    items: list[Item] = [Stroke("cut", "cut", "cut", (piece.cut,), closed=True)]
    for line in piece.sew:
        about = {"length-mm": f"{line.length:.3f}", "allowance-mm": f"{line.allowance:g}"}
        items.append(Stroke("sew", line.kind, f"edge {line.kind}", ((line.curve,),), name=line.name, about=about))
    items += [notch_mark(notch) for notch in piece.notches]
    items += [hole_mark(hole) for hole in piece.holes]
    if np.linalg.norm(piece.grain[1] - piece.grain[0]) > 0:
        items.append(arrow(piece.grain, "grain"))
    items += _texts(piece)
    return [replace(item, group=group, series=series) for item in items]


def notch_mark(notch: Notch) -> Stroke:
    """A notch as it is cut; one that is only drawn is on the layer of the texts, which no machine cuts."""
    depth = float(np.linalg.norm(notch.ticks[0, 1] - notch.ticks[0, 0]))
    about = {"edge": notch.edge, "distance-mm": f"{notch.distance:.3f}", "depth-mm": f"{depth:.3f}"}
    about["width-mm"] = f"{notch.width:.3f}"
    places = tuple((root, float(np.degrees(np.arctan2(*(inner - root)[::-1])))) for root, inner in notch.ticks)
    name = notch.name or f"{notch.edge} notch"
    paths = tuple(line_of(points) for points in notch.strokes)
    if not notch.is_cut:
        return Stroke("text", "mark", "tick", paths, name=name, about={"edge": notch.edge})
    return Stroke("notch", "mark", f"notch {notch.form}", paths, name=name, place=places, about=about)


def hole_mark(hole: Hole) -> Stroke:
    """A place to be drilled: a circle and a cross."""
    x, y = hole.point
    cross = (line_of(((x - 3, y), (x + 3, y))), line_of(((x, y - 3), (x, y + 3))))
    paths = (circle(hole.point, 1.5), *cross)
    return Stroke("drill", "mark", "hole", paths, name=hole.name, place=((hole.point, 0.0),))


def arrow(ends: Float[ndarray, "2 2"], layer: str) -> Stroke:
    """A line with a head at both ends."""
    heads = []
    size = min(3.0, float(np.linalg.norm(ends[1] - ends[0])) / 4)
    for tip, tail in (ends, ends[::-1]):
        back = (tail - tip) / max(float(np.linalg.norm(tail - tip)), 1e-9) * size
        aside = np.array((-back[1], back[0])) * 0.4
        heads.append(line_of(np.stack((tip + back + aside, tip, tip + back - aside))))
    return Stroke(layer, "mark", "grain", (line_of(ends), *heads))


def _texts(piece: CutPiece) -> Iterable[Item]:
    label = piece.label
    for row, words in enumerate(label.all_lines):
        colour = RED if row >= len(label.lines) else BLACK
        yield Words(words, label.middle(row), label.size, label.along, bold=label.is_bold(row), colour=colour)
    for caption in piece.captions:
        if caption.leader is not None:
            yield Stroke("text", "leader", "leader", (line_of(caption.leader),))
        yield _caption(caption)


def _caption(caption: Caption) -> Words:
    return Words(caption.words, caption.at, caption.size, caption.along, name="caption")
