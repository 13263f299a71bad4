"""Patterns as DXF for apparel systems: release 12, layers and texts of ASTM D6673, a block for each piece and size."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ezdxf.addons import gerber_D6673
from ezdxf.document import Drawing
from ezdxf.layouts.blocklayout import BlockLayout
from jaxtyping import Float
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.pattern.finish import CutPiece, Pattern
from brafit.pattern.label import LINE
from brafit.pattern.options import UNITS
from brafit.pattern.piece import layout_columns

TOLERANCE = 0.01
"""How far (mm) the polylines may lie from the curves."""
LAYERS = {
    "cut": "1", "turn": "2", "curve": "3", "notch": "4", "grain": "7", "drill": "13", "sew": "14", "annotation": "15",
}  # fmt: skip
"""Numbers of the layers that are used, by what they hold; the texts of pieces and style are on the cut line's."""
COLOURS = {"cut": 7, "turn": 1, "curve": 3, "notch": 1, "grain": 5, "drill": 6, "sew": 4, "annotation": 8}
CONTROL, GAP = 100.0, 10.0


def write_dxf(path: str | Path, patterns: Sequence[Pattern], style: str) -> None:
    """Write patterns, sizes or scans, side by side in one file, with a control square of 100 mm as a piece of its own.

    The unit is that of the first pattern's options (`Units: METRIC` is mm, `ENGLISH` inches). Names are made fit for
    DXF: block names of capitals, digits, `-` and `_`, not longer than 31 characters.

    Args:
        style: name of the style, usually the scan's or the run's.
    """
    unit = patterns[0].options.units
    scale = 1 / UNITS[unit]
    logging.getLogger("ezdxf").setLevel(logging.WARNING)  # it tells of every table that it makes
    document = Drawing.new("AC1009")
    for layer, number in LAYERS.items():
        document.layers.add(number, color=COLOURS[layer])
    model = document.modelspace()
    taken: set[str] = set()
    columns = [(pattern, column) for pattern in patterns for column in pattern.drawn]
    sheet = layout_columns([column for _, column in columns], GAP)
    owners = [pattern for pattern, column in columns for _ in column]
    for pattern, piece in zip(owners, sheet.pieces, strict=True):
        sides = f"{piece.name} {piece.side}" if len(pattern.drawn) > 1 else piece.name
        name = block_name(f"{sides}_{pattern.size}", taken)
        block = document.blocks.new(name)
        _piece(block, piece, pattern, sides, scale)
        model.add_blockref(name, (0, 0), dxfattribs={"layer": LAYERS["cut"]})
    name = block_name("CONTROL_SQUARE_100MM", taken)
    _control_square(document.blocks.new(name), scale, sheet.height)
    model.add_blockref(name, (0, 0), dxfattribs={"layer": LAYERS["cut"]})
    first = patterns[0]
    about = [
        f"Style Name: {style}",
        "Author: brafit",
        f"Creation Date: {first.date}",
        f"Sample Size: {first.size}",
        "Grading Rule Table: none",
        f"Units: {'METRIC' if unit == 'mm' else 'ENGLISH'}",
    ]
    for row, words in enumerate(about):
        at = (0, scale * (sheet.height + CONTROL + GAP + 30 - 5 * row))
        model.add_text(_plain(words), height=3 * scale, dxfattribs={"layer": LAYERS["cut"], "insert": at})
    # The plain exporter writes block definitions for the layouts too, which some apparel systems refuse.
    text = io.StringIO()
    gerber_D6673.export_stream(document, text)
    write_bytes(path, text.getvalue().encode("ascii", errors="dxfreplace"))


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


def _piece(block: BlockLayout, piece: CutPiece, pattern: Pattern, name: str, scale: float) -> None:
    outline = np.concatenate([curve.polyline(TOLERANCE) for curve in piece.cut])
    outline = outline[np.append(True, np.linalg.norm(np.diff(outline, axis=0), axis=1) > 1e-6)]
    if np.linalg.norm(outline[-1] - outline[0]) < 1e-6:
        outline = outline[:-1]
    _polyline(block, np.vstack((outline, outline[:1])) * scale, "cut")
    for point, corner in zip(outline, _is_corner(outline), strict=True):
        block.add_point(tuple(point * scale), dxfattribs={"layer": LAYERS["turn" if corner else "curve"]})
    for line in piece.sew:
        _polyline(block, line.curve.polyline(TOLERANCE) * scale, "sew")
    for notch in piece.notches:
        for root, inner in notch.ticks:
            angle = float(np.degrees(np.arctan2(*(inner - root)[::-1])))
            block.add_point(tuple(root * scale), dxfattribs={"layer": LAYERS["notch"], "angle": angle})
    for hole in piece.holes:
        block.add_point(tuple(hole.point * scale), dxfattribs={"layer": LAYERS["drill"]})
    start, end = piece.grain * scale
    block.add_line(tuple(start), tuple(end), dxfattribs={"layer": LAYERS["grain"]})
    about = [f"Piece Name: {name}", f"Size: {pattern.size}", f"Quantity: {pattern.options.quantity}"]
    about += [
        f"Annotation: {words}"
        for words in (*piece.label.lines[1:], *piece.label.notice)
        if not words.startswith("size")
    ]
    size, along, angle = piece.label.size, piece.label.along, piece.label.angle
    down = np.array((along[1], -along[0]))
    for row, words in enumerate(about):
        layer = LAYERS["annotation" if words.startswith("Annotation") else "cut"]
        at = piece.label.at - 0.28 * size * len(words) * along + LINE * size * (row + 1 - len(about) / 2) * down
        text = {"layer": layer, "insert": tuple(scale * at), "rotation": angle}
        block.add_text(_plain(words), height=0.7 * size * scale, dxfattribs=text)
    for caption in piece.captions:
        size = caption.size
        at = caption.at - 0.28 * size * len(caption.words) * caption.along
        text = {"layer": LAYERS["annotation"], "insert": tuple(scale * at), "rotation": caption.angle}
        block.add_text(_plain(caption.words), height=0.7 * size * scale, dxfattribs=text)


def _control_square(block: BlockLayout, scale: float, bottom: float) -> None:
    corners = np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))) * CONTROL + (0, bottom + GAP)
    _polyline(block, corners * scale, "cut")
    for corner in corners[:4] * scale:
        block.add_point(tuple(corner), dxfattribs={"layer": LAYERS["turn"]})
    middle = (corners[0] + corners[2]) / 2
    grain = (middle + np.array(((0, -40), (0, 40)))) * scale
    block.add_line(tuple(grain[0]), tuple(grain[1]), dxfattribs={"layer": LAYERS["grain"]})
    words = ("Piece Name: CONTROL SQUARE", "Size: 100 mm", "Quantity: 0", "Annotation: each side measures 100 mm")
    for row, text in enumerate(words):
        layer = LAYERS["annotation" if row == 3 else "cut"]
        at = ((middle[0] - 45) * scale, (middle[1] + 8 - 6 * row) * scale)
        block.add_text(text, height=3.5 * scale, dxfattribs={"layer": layer, "insert": at})


def _polyline(block: BlockLayout, points: Float[ndarray, "n 2"], layer: str) -> None:
    block.add_polyline2d([tuple(point) for point in points], dxfattribs={"layer": LAYERS[layer]})


def _is_corner(outline: Float[ndarray, "n 2"]) -> list[bool]:
    """Whether a closed polygon turns by more than 12 degrees at a point."""
    go = np.roll(outline, -1, axis=0) - outline
    come = np.roll(go, 1, axis=0)
    turn = np.abs(np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], (come * go).sum(1)))
    return (turn > np.radians(12)).tolist()


def _plain(words: str) -> str:
    """Text that fits into one line of a DXF file."""
    return " ".join("".join(c if c.isprintable() else " " for c in words).split())
