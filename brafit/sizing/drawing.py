"""A nest as files at true size: SVG, DXF (release 12) and PDF, each size in its own colour, with a layer for each kind
of its lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.pattern.drawing import BLACK, INFO, Item, Page, Stroke, Words, line_of, shifted
from brafit.pattern.dxf import block_name, plain, tags
from brafit.pattern.label import text_width
from brafit.pattern.lettering import LEAST, one_line, shortened, text
from brafit.pattern.options import UNITS
from brafit.pattern.pdf import write_pages
from brafit.pattern.sheet import (
    CONTROL,
    GAP,
    MARGIN,
    ROOM,
    TEXT,
    control_square,
    heading,
    legend,
    told_below,
    warned_lines,
)
from brafit.pattern.svg import page_svg
from brafit.sizing.nest import Layer, Nest

LINE = 6.0
"""Height of a line of the list of sizes, mm."""
LIST, KEY = 150.0, 22.0
"""Width that the list of sizes takes at most of its own accord, and that of its lines' colours, mm."""
TOLERANCE = 0.01
"""How far (mm) DXF's polylines may lie from the curves."""
FILES = ("patterns.svg", "patterns.dxf", "patterns.pdf")
_OTHERS = (("CONTROL", 7), ("NAMES", 7), ("WARNINGS", 1))
"""DXF's layers that are of no size, and their colour."""


def write_nest(folder: Path, nest: Nest, title: str, note: str = "") -> list[Path]:
    """Write a nest in every format into a folder, which is made if it is missing; gives the files.

    Args:
        folder: of FILES.
        nest: the drawing.
        title: of the drawing, any text.
        note: a second line.
    """
    files, page = [folder / name for name in FILES], nest_page(nest, title, note)
    write_bytes(files[0], page_svg(page, title))
    write_bytes(files[1], nest_dxf(nest))
    write_pages(files[2], [page], title)
    return files


def nest_page(nest: Nest, title: str, note: str = "") -> Page:
    """The sizes on one page as large as they need, above control square, legend, list of sizes and warnings.

    Args:
        nest: the drawing.
        title: of the drawing, any text.
        note: a second line.
    """
    key, height = legend(nest.patterns, np.zeros(2))
    left = CONTROL + GAP + ROOM + GAP
    room = max(nest.width, left + np.clip(_list_width(nest.layers), ROOM, LIST))
    told, told_height = told_below(nest.warnings, room)
    foot = max(CONTROL, height, LINE * len(nest.layers)) + told_height
    width, top = room + 2 * MARGIN, MARGIN + foot
    tall = top + GAP + nest.height + 20.0 + MARGIN
    low = ((width - nest.width) / 2, top + GAP)
    items = shifted([*(item for layer in nest.layers for item in layer.items), *nest.names], low)
    items += heading(title, note, MARGIN, tall - MARGIN, room)
    items += control_square(MARGIN, top - CONTROL, nest.patterns[0].options)
    items += shifted((replace(item, colour=BLACK) for item in key), (MARGIN + CONTROL + GAP, top))
    items += _sizes(nest.layers, MARGIN + left, top, room - left - KEY)
    items += shifted(told, (MARGIN, MARGIN))
    return Page(width, tall, tuple(items))


def _list_width(layers: Sequence[Layer]) -> float:
    """What the list of sizes needs, so that none is shortened or set smaller, mm."""
    return KEY + max(text_width(f"{one_line(layer.name)}{_about(layer)}", TEXT) for layer in layers)


def _about(layer: Layer) -> str:
    return f": {layer.about}" * bool(layer.about)


def listed_names(layers: Sequence[Layer], room: float) -> list[str]:
    """The sizes' names, shortened where they and what is said of them are wider than `room` mm; no two are alike."""
    names = []
    for layer in layers:
        whole, left = one_line(layer.name), room - text_width(_about(layer), LEAST)
        name, count = shortened(whole, LEAST, left), 1
        while name in names:
            count += 1
            told = f" ({count})"
            name = shortened(whole, LEAST, left - text_width(told, LEAST)) + told
        names.append(name)
    return names


def _sizes(layers: Sequence[Layer], x: float, top: float, room: float) -> list[Item]:
    """The sizes' names and what tells their cups apart, each after a line of its colour."""
    items: list[Item] = []
    for row, (layer, name) in enumerate(zip(layers, listed_names(layers, room), strict=True)):
        y = top - 2.0 - LINE * row
        line = line_of(((x, y), (x + 18, y)))
        items.append(Stroke(INFO, "cut", "key size", (line,), colour=layer.colour, group="sizes"))
        items.append(replace(text(f"{name}{_about(layer)}", x + KEY, y, TEXT, room=room), group="sizes"))
    return items


# DXF


def nest_dxf(nest: Nest) -> bytes:
    """A nest as DXF of release 12, in the unit of the first pattern's options (`$INSUNITS`): for each size the layers
    S_NAME (cut), S_NAME_SEW, _NOTCH, _DRILL, _GRAIN and _TEXT in its colour; the control square is on the layer
    CONTROL, names of pieces that lie on one another on NAMES, warnings on WARNINGS.
    """
    unit = nest.patterns[0].options.units
    scale, number = 1 / UNITS[unit], {"mm": 4, "inch": 1}[unit]
    taken: set[str] = set()
    names = [block_name(f"S_{layer.name}"[:25], taken) for layer in nest.layers]
    header = tags((9, "$ACADVER"), (1, "AC1009"), (9, "$INSUNITS"), (70, number))
    entities = "".join([*_size_entities(nest, names, scale), *_other_entities(nest, scale)])
    sections = (("HEADER", header), ("TABLES", _layer_table(nest, names)), ("ENTITIES", entities))
    content = "".join(tags((0, "SECTION"), (2, name)) + body + tags((0, "ENDSEC")) for name, body in sections)
    return (content + tags((0, "EOF"))).encode("ascii")


def _layer_table(nest: Nest, names: Sequence[str]) -> str:
    kinds = ("", "_SEW", "_NOTCH", "_DRILL", "_GRAIN", "_TEXT")
    table = [
        (f"{name}{kind}", layer.colour_index) for name, layer in zip(names, nest.layers, strict=True) for kind in kinds
    ]
    rows = "".join(tags((0, "LAYER"), (2, n), (70, 0), (62, c), (6, "CONTINUOUS")) for n, c in [*table, *_OTHERS])
    return tags((0, "TABLE"), (2, "LAYER"), (70, len(table) + len(_OTHERS))) + rows + tags((0, "ENDTAB"))


def _size_entities(nest: Nest, names: Sequence[str], scale: float) -> list[str]:
    """What is drawn of the sizes, and the list of them beside the control square."""
    bottom, entities = nest.height + GAP, []
    for row, (name, layer) in enumerate(zip(names, nest.layers, strict=True)):
        for item in layer.items:
            own = name if item.layer == "cut" else f"{name}_{item.layer.upper()}"
            entities += [_words(item, own, scale)] if isinstance(item, Words) else _drawn(item, own, scale)
        at = np.array((CONTROL + GAP, bottom + CONTROL - LINE * (row + 1)))
        words = f"{layer.name}: {layer.about}" if layer.about else layer.name
        entities.append(_words(Words(words, at, 3.6, centred=False), f"{name}_TEXT", scale))
    return entities


def _other_entities(nest: Nest, scale: float) -> list[str]:
    """Names of pieces and marks, warnings, and the control square."""
    bottom = nest.height + GAP
    square = np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))) * CONTROL + (0, bottom)
    entities = [_words(own, "NAMES", scale) for own in nest.names]
    for row, words in enumerate(reversed(warned_lines(nest.warnings, 4 * CONTROL))):
        at = np.array((0.0, bottom + CONTROL + LINE * (row + 1)))
        entities.append(_words(Words(words, at, 3.6, centred=False), "WARNINGS", scale))
    entities.append(_polyline(square * scale, "CONTROL"))
    entities.append(_words(Words("control square 100 mm", np.array((50.0, bottom + 50)), 4.0), "CONTROL", scale))
    return entities


def _drawn(stroke: Stroke, layer: str, scale: float) -> list[str]:
    lines = []
    for path in stroke.paths:
        points = np.concatenate([curve.polyline(TOLERANCE) for curve in path])
        if stroke.closed:
            points = np.vstack((points, points[:1]))
        points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6)]
        lines.append(_polyline(points * scale, layer))
    return lines


def _polyline(points: Float[ndarray, "n 2"], layer: str) -> str:
    head = tags((0, "POLYLINE"), (8, layer), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 0))
    body = "".join(tags((0, "VERTEX"), (8, layer), (10, x), (20, y), (30, 0.0)) for x, y in points.tolist())
    return head + body + tags((0, "SEQEND"), (8, layer))


def _words(words: Words, layer: str, scale: float) -> str:
    start, *_ = words.corners if words.centred else (words.at,)
    x, y = (scale * start).tolist()
    place = ((10, x), (20, y), (30, 0.0), (40, 0.7 * words.size * scale))
    turn = [(50, words.angle)] if abs(words.angle) > 1e-6 else []
    return tags((0, "TEXT"), (8, layer), *place, (1, plain(words.text)), *turn)
