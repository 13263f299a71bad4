"""Patterns as DXF for apparel systems: release 12, layers and texts of ASTM D6673, a block for each piece and size.

A file of release 12 is pairs of lines, a code and a value, and patterns need but seven kinds of entities, so they are
written as text. As in the files of apparel systems the header is empty and there are no tables: some of those systems
refuse what they do not know, such as blocks that are no pieces.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.pattern.curve import Curve
from brafit.pattern.drawing import Stroke, drawn
from brafit.pattern.finish import CutPiece, Pattern, notice
from brafit.pattern.label import LINE
from brafit.pattern.options import UNITS
from brafit.pattern.piece import layout_columns

TOLERANCE = 0.01
"""How far (mm) the polylines may lie from the curves."""
LAYERS = {
    "cut": "1", "turn": "2", "curve": "3", "notch": "4", "grain": "7", "tick": "8", "drill": "13", "sew": "14",
    "annotation": "15", "T-notch": "80",
}  # fmt: skip
"""Numbers of the layers that are used, by what they hold; the texts of pieces and style are on the cut line's."""
CONTROL, GAP = 100.0, 10.0
_LETTERS = 100
"""Most letters of a line of a warning of the fit; release 12 has at most 255."""


def write_dxf(path: str | Path, patterns: Sequence[Pattern], style: str) -> None:
    """Write patterns, sizes or scans, side by side in one file, with a control square of 100 mm as a piece of its own.

    The unit is that of the first pattern's options (`Units: METRIC` is mm, `ENGLISH` inches). Names are made fit for
    DXF: block names of capitals, digits, `-` and `_`, not longer than 31 characters.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        patterns: one or more, of any sizes; options are those of each.
        style: name of the style, usually the scan's or the run's.
    """
    unit = patterns[0].options.units
    scale = 1 / UNITS[unit]
    taken: set[str] = set()
    columns = [(pattern, column) for pattern in patterns for column in pattern.drawn]
    sheet = layout_columns([column for _, column in columns], GAP)
    owners = [pattern for pattern, column in columns for _ in column]
    blocks: dict[str, str] = {}
    for pattern, piece in zip(owners, sheet.pieces, strict=True):
        sides = f"{piece.name} {piece.side}" if len(pattern.drawn) > 1 else piece.name
        blocks[block_name(f"{sides}_{pattern.size}", taken)] = _piece(piece, pattern, sides, scale)
    blocks[block_name("CONTROL_SQUARE_100MM", taken)] = _control_square(scale, sheet.height)
    first = patterns[0]
    about = [
        f"Style Name: {style}",
        "Author: brafit",
        f"Creation Date: {first.date}",
        f"Sample Size: {first.size}",
        "Grading Rule Table: none",
        f"Units: {'METRIC' if unit == 'mm' else 'ENGLISH'}",
    ]
    top = sheet.height + CONTROL + GAP + 30
    model = [tags((0, "INSERT"), (8, LAYERS["cut"]), (2, name), *_at((0.0, 0.0))) for name in blocks]
    model += [_text(words, "cut", scale * np.array((0, top - 5 * row)), 3 * scale) for row, words in enumerate(about)]
    sections = [
        ("HEADER", ""),
        ("BLOCKS", "".join(_block(name, entities) for name, entities in blocks.items())),
        ("ENTITIES", "".join(model)),
    ]
    text = "".join(tags((0, "SECTION"), (2, name)) + body + tags((0, "ENDSEC")) for name, body in sections)
    write_bytes(path, (text + tags((0, "EOF"))).encode("ascii"))


def block_name(text: str, taken: set[str]) -> str:
    """A new block name for release 12 that resembles the text."""
    base = re.sub(r"[^A-Z0-9_-]+", "_", text.upper()).strip("_") or "PIECE"
    name, count = base[:31], 1
    while name in taken:
        count += 1
        tail = f"_{count}"
        name = base[: 31 - len(tail)] + tail
    taken.add(name)
    return name


def _piece(piece: CutPiece, pattern: Pattern, name: str, scale: float) -> str:
    entities: list[str] = []
    for item in drawn(piece, name):
        if isinstance(item, Stroke):
            entities += _stroke(item, scale)
        elif item.name == "caption":
            at = item.at - 0.28 * item.size * len(item.text) * item.along
            entities.append(_text(item.text, "annotation", scale * at, 0.7 * item.size * scale, item.angle))
    about = [f"Piece Name: {name}", f"Size: {pattern.size}", f"Quantity: {pattern.options.quantity}"]
    # whatever the room, and with the fit's warnings: there is neither legend nor cover that would have the rest
    told = (*piece.label.whole[1:], *notice(pattern.fit_warnings, _LETTERS))
    about += [f"Annotation: {words}" for words in told if words != f"size {pattern.size}"]
    size, along, angle = piece.label.size, piece.label.along, piece.label.angle
    down = np.array((along[1], -along[0]))
    for row, words in enumerate(about):
        layer = "annotation" if words.startswith("Annotation") else "cut"
        at = piece.label.at - 0.28 * size * len(words) * along + LINE * size * (row + 1 - len(about) / 2) * down
        entities.append(_text(words, layer, scale * at, 0.7 * size * scale, angle))
    return "".join(entities)


def _stroke(stroke: Stroke, scale: float) -> list[str]:
    """Marks are points; of the grain line only the line itself; lines from texts to what they name are left out."""
    if stroke.role == "tick":  # an internal line: drawn, not cut
        return [_line(np.stack((line.start, line.end)) * scale, "tick") for (line,) in stroke.paths]
    if stroke.layer == "cut":
        return _outline(stroke.paths[0], scale)
    if stroke.layer == "sew":
        return [_polyline(curve.polyline(TOLERANCE) * scale, "sew") for path in stroke.paths for curve in path]
    if stroke.layer == "grain":
        (line,) = stroke.paths[0]
        return [_line(np.stack((line.start, line.end)) * scale, "grain")]
    if stroke.layer == "drill":
        return [_points(point[None] * scale, "drill") for point, _ in stroke.place]
    if stroke.layer == "notch":
        layer = LAYERS["T-notch" if stroke.role.endswith(" t") else "notch"]
        depth, width = (scale * float(stroke.about[key]) for key in ("depth-mm", "width-mm"))
        size = [(30, depth), *[(39, width)] * (width > 0)]  # depth is the point's z, width its thickness
        return [
            tags((0, "POINT"), (8, layer), *_at(root * scale)[:2], *size, (50, angle)) for root, angle in stroke.place
        ]
    return []


def _outline(curves: Sequence[Curve], scale: float) -> list[str]:
    outline = np.concatenate([curve.polyline(TOLERANCE) for curve in curves])
    outline = outline[np.append(True, np.linalg.norm(np.diff(outline, axis=0), axis=1) > 1e-6)]
    if np.linalg.norm(outline[-1] - outline[0]) < 1e-6:
        outline = outline[:-1]
    corner = _is_corner(outline)
    entities = [_polyline(np.vstack((outline, outline[:1])) * scale, "cut")]
    return [*entities, _points(outline[corner] * scale, "turn"), _points(outline[~corner] * scale, "curve")]


def _control_square(scale: float, bottom: float) -> str:
    corners = np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))) * CONTROL + (0, bottom + GAP)
    middle = (corners[0] + corners[2]) / 2
    words = ("Piece Name: CONTROL SQUARE", "Size: 100 mm", "Quantity: 0", "Annotation: each side measures 100 mm")
    texts = [
        _text(text, "annotation" if row == 3 else "cut", (middle + np.array((-45, 8 - 6 * row))) * scale, 3.5 * scale)
        for row, text in enumerate(words)
    ]
    grain = _line((middle + np.array(((0, -40), (0, 40)))) * scale, "grain")
    return "".join([_polyline(corners * scale, "cut"), _points(corners[:4] * scale, "turn"), grain, *texts])


# Entities


def _block(name: str, entities: str) -> str:
    head = tags((0, "BLOCK"), (8, "0"), (2, name), (70, 0), *_at((0.0, 0.0)), (3, name), (1, ""))
    return head + entities + tags((0, "ENDBLK"), (8, "0"))


def _polyline(points: Float[ndarray, "n 2"], layer: str) -> str:
    number = LAYERS[layer]
    head = tags((0, "POLYLINE"), (8, number), (66, 1), *_at((0.0, 0.0)), (70, 0))
    return head + _each("VERTEX", points, number, (70, 0)) + tags((0, "SEQEND"), (8, number))


def _points(points: Float[ndarray, "n 2"], layer: str) -> str:
    return _each("POINT", points, LAYERS[layer])


def _each(kind: str, points: Float[ndarray, "n 2"], number: str, *more: tuple[int, object]) -> str:
    """An entity for each point."""
    one = tags((0, kind), (8, number), (10, "%.6f"), (20, "%.6f"), (30, "0.0"), *more)
    return one * len(points) % tuple(points.ravel().tolist())


def _line(ends: Float[ndarray, "2 2"], layer: str) -> str:
    return tags((0, "LINE"), (8, LAYERS[layer]), *_at(ends[0]), *_at(ends[1], 1))


def _text(words: str, layer: str, at: Float[ndarray, "2"], height: float, angle: float = 0.0) -> str:
    turn = [(50, angle)] if angle else []
    return tags((0, "TEXT"), (8, LAYERS[layer]), *_at(at), (40, height), (1, plain(words)), *turn)


def _at(point: Sequence[float] | Float[ndarray, "2"], which: int = 0) -> list[tuple[int, object]]:
    """The codes of an entity's point, in the plane."""
    x, y = point
    return [(10 + which, float(x)), (20 + which, float(y)), (30 + which, 0.0)]


def tags(*pairs: tuple[int, object]) -> str:
    """Codes and values as a DXF file has them."""
    return "".join(f"{code:3d}\n{f'{v:.6f}' if isinstance(v, float) else v}\n" for code, v in pairs)


def _is_corner(outline: Float[ndarray, "n 2"]) -> Bool[ndarray, " n"]:
    """Whether a closed polygon turns by more than 12 degrees at a point."""
    go = np.roll(outline, -1, axis=0) - outline
    come = np.roll(go, 1, axis=0)
    turn = np.abs(np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], (come * go).sum(1)))
    return turn > np.radians(12)


def plain(words: str) -> str:
    """Text that fits into one line of a DXF file; letters beyond ASCII by their numbers, as release 12 has them."""
    line = " ".join("".join(c if c.isprintable() else " " for c in words).split())
    return "".join(c if c.isascii() else f"\\U+{ord(c):04X}" if ord(c) < 0x10000 else "?" for c in line)
