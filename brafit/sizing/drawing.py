"""A nest as files at true size: SVG, DXF (release 12) and PDF, each size in its own colour, and its own layer where the
format has layers.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.atomic import replacing, write_bytes
from brafit.pattern.curve import Curve
from brafit.pattern.dxf import block_name
from brafit.pattern.svg import INKSCAPE, SVG
from brafit.sizing.nest import Layer, Nest, Stroke, Words

MARGIN, GAP, CONTROL, LINE = 12.0, 12.0, 100.0, 6.0
"""Border, distance of the drawing from what is below it, side of the control square, height of a legend's line; mm."""
TOLERANCE = 0.01
"""How far (mm) DXF's polylines may lie from the curves."""
WIDTHS = {"cut": 0.35, "sew": 0.25, "notch": 0.35, "drill": 0.35, "grain": 0.2, "text": 0.2}
DASHES = {"sew": (4.0, 1.5), "grain": (8.0, 1.5, 1.5, 1.5)}
"""Widths and dashes of lines, mm."""
ABOUT = ("units: mm, true size (1:1)", "solid: cut line; dashed: sewing line", "right side of the cloth up")
FILES = ("patterns.svg", "patterns.dxf", "patterns.pdf")


def write_nest(folder: Path, nest: Nest, title: str, note: str = "") -> list[Path]:
    """Write a nest in every format into a folder, which is made if it is missing; gives the files.

    Args:
        folder: of FILES.
        nest: the drawing.
        title: of the drawing, any text.
        note: a second line.
    """
    files = [folder / name for name in FILES]
    write_bytes(files[0], nest_svg(nest, title, note))
    write_bytes(files[1], nest_dxf(nest))
    write_nest_pdf(files[2], nest, title, note)
    return files


def _frame(nest: Nest) -> tuple[float, float, float]:
    """Width and height of the sheet, and height of the foot, where control square and legend are."""
    foot = max(CONTROL, LINE * (len(nest.layers) + len(ABOUT) + 1))
    width = max(nest.width, CONTROL + GAP + 90.0) + 2 * MARGIN
    return width, 20.0 + nest.height + GAP + foot + 2 * MARGIN, foot


def _legend(nest: Nest, foot: float) -> list[tuple[Layer | None, str, Float[ndarray, "2"]]]:
    """Lines of the legend and where they begin, y up: with a layer, its line is drawn before its name."""
    lines = [*((None, words) for words in ABOUT), *((layer, layer.name) for layer in nest.layers)]
    left, top = MARGIN + CONTROL + GAP, MARGIN + foot - LINE
    return [(layer, words, np.array((left, top - LINE * row))) for row, (layer, words) in enumerate(lines)]


# SVG


def nest_svg(nest: Nest, title: str, note: str = "") -> bytes:
    """A nest as SVG: a user unit is one millimetre, a layer (as Inkscape shows them) a size, a group in it a piece."""
    ET.register_namespace("", SVG)
    ET.register_namespace("inkscape", INKSCAPE)
    width, height, foot = _frame(nest)
    size = {"width": f"{width:.4f}mm", "height": f"{height:.4f}mm", "viewBox": f"0 0 {width:.4f} {height:.4f}"}
    root = ET.Element(f"{{{SVG}}}svg", size)
    _child(root, "title").text = _line(title)
    low = np.array(((width - nest.width) / 2, MARGIN + foot + GAP))

    def place(points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        return (points + low) * (1, -1) + (0, height)

    taken: set[str] = set()
    for layer in nest.layers:
        group = _child(root, "g", id=_identifier(f"size {layer.name}", taken))
        group.set(f"{{{INKSCAPE}}}label", _line(layer.name))
        group.set(f"{{{INKSCAPE}}}groupmode", "layer")
        for name, strokes in layer.pieces:
            piece = _child(group, "g", **{"class": "piece"})
            piece.set(f"{{{INKSCAPE}}}label", name)
            for stroke in strokes:
                path = _path([Curve(place(curve.controls)) for curve in stroke.curves], stroke.closed)
                _child(piece, "path", **{"class": stroke.kind}, d=path, **_style(stroke.kind, layer.colour))
        for words in layer.words:
            _text(group, words.text, place(words.at), words.height, layer.colour, "middle")
    info = _child(root, "g", id="info")
    _text(info, title, np.array((MARGIN, MARGIN + 6)), 6.0)
    _text(info, note, np.array((MARGIN, MARGIN + 13)), 3.6)
    corner = height - MARGIN - foot
    square = {"x": f"{MARGIN:.4f}", "y": f"{corner:.4f}", "width": f"{CONTROL:g}", "height": f"{CONTROL:g}"}
    _child(info, "rect", id="control-square", **square, fill="none", stroke="#000000", **{"stroke-width": "0.2"})
    _text(info, "control square 100 mm", np.array((MARGIN + 50, corner + 50)), 4.0, anchor="middle")
    for layer, words, at in _legend(nest, foot):
        x, y = at[0], height - at[1]
        if layer is not None:
            _child(info, "path", d=f"M{x:.4f},{y - 1.2:.4f} h18", **_style("cut", layer.colour))
        _text(info, words, np.array((x + 22 * (layer is not None), y)), 3.6)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _child(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{SVG}}}{tag}", attributes)


def _style(kind: str, colour: str) -> dict[str, str]:
    style = {"fill": "none", "stroke": colour, "stroke-width": f"{WIDTHS[kind]:g}", "stroke-linejoin": "round"}
    return style | ({"stroke-dasharray": " ".join(f"{v:g}" for v in DASHES[kind])} if kind in DASHES else {})


def _path(curves: list[Curve], closed: bool) -> str:
    parts = []
    for k, curve in enumerate(curves):
        parts.append(f"{'L' if k else 'M'}{curve.start[0]:.4f},{curve.start[1]:.4f}")
        parts += ["C" + " ".join(f"{x:.4f},{y:.4f}" for x, y in arc[1:]) for arc in curve.controls]
    return " ".join([*parts, *["Z"] * closed])


def _text(
    parent: ET.Element, words: str, at: Float[ndarray, "2"], size: float, colour: str = "#000000", anchor: str = "start"
) -> None:
    style = {"font-family": "sans-serif", "font-size": f"{size:g}", "text-anchor": anchor, "fill": colour}
    _child(parent, "text", x=f"{at[0]:.4f}", y=f"{at[1] + 0.35 * size:.4f}", **style).text = _line(words)


def _identifier(text: str, taken: set[str]) -> str:
    base = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
    name = next(n for k in range(len(taken) + 1) if (n := f"{base}-{k + 1}" if k else base) not in taken)
    taken.add(name)
    return name


def _line(words: str) -> str:
    """One line of letters that XML can hold."""
    return " ".join("".join(c if c.isprintable() else " " for c in words).split())


# DXF


def nest_dxf(nest: Nest) -> bytes:
    """A nest as DXF of release 12, mm: for each size the layers S_NAME (cut), S_NAME_SEW, _NOTCH, _DRILL, _GRAIN and
    _TEXT in its colour; the control square is on the layer CONTROL.
    """
    taken: set[str] = set()
    names = {id(layer): block_name(f"S_{layer.name}"[:25], taken) for layer in nest.layers}
    kinds = ("", "_SEW", "_NOTCH", "_DRILL", "_GRAIN", "_TEXT")
    table = [(f"{names[id(layer)]}{kind}", layer.colour_index) for layer in nest.layers for kind in kinds]
    rows = "".join(
        _tags((0, "LAYER"), (2, n), (70, 0), (62, c), (6, "CONTINUOUS")) for n, c in [*table, ("CONTROL", 7)]
    )
    layers = _tags((0, "TABLE"), (2, "LAYER"), (70, len(table) + 1)) + rows + _tags((0, "ENDTAB"))
    entities = []
    for layer in nest.layers:
        own = names[id(layer)]
        for _, strokes in layer.pieces:
            entities += [
                _drawn(stroke, own if stroke.kind == "cut" else f"{own}_{stroke.kind.upper()}") for stroke in strokes
            ]
        entities += [_words(words, f"{own}_TEXT") for words in layer.words]
    bottom = nest.height + GAP
    square = np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))) * CONTROL + (0, bottom)
    entities.append(_polyline(square, "CONTROL"))
    entities.append(_words(Words("control square 100 mm", np.array((50.0, bottom + 50)), 4.0), "CONTROL"))
    for row, layer in enumerate(nest.layers):
        at = np.array((CONTROL + GAP + 20.0, bottom + CONTROL - LINE * (row + 1)))
        entities.append(_words(Words(layer.name, at, 3.6), f"{names[id(layer)]}_TEXT"))
    header = _tags((9, "$ACADVER"), (1, "AC1009"), (9, "$INSUNITS"), (70, 4))
    sections = (("HEADER", header), ("TABLES", layers), ("ENTITIES", "".join(entities)))
    text = "".join(_tags((0, "SECTION"), (2, name)) + body + _tags((0, "ENDSEC")) for name, body in sections)
    return (text + _tags((0, "EOF"))).encode("ascii")


def _drawn(stroke: Stroke, layer: str) -> str:
    points = np.concatenate([curve.polyline(TOLERANCE) for curve in stroke.curves])
    if stroke.closed:
        points = np.vstack((points, points[:1]))
    return _polyline(points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6)], layer)


def _polyline(points: Float[ndarray, "n 2"], layer: str) -> str:
    head = _tags((0, "POLYLINE"), (8, layer), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 0))
    body = "".join(_tags((0, "VERTEX"), (8, layer), (10, x), (20, y), (30, 0.0)) for x, y in points.tolist())
    return head + body + _tags((0, "SEQEND"), (8, layer))


def _words(words: Words, layer: str) -> str:
    text = "".join(c if c.isascii() else f"\\U+{ord(c):04X}" if ord(c) < 0x10000 else "?" for c in _line(words.text))
    x, y = words.at.tolist()
    return _tags((0, "TEXT"), (8, layer), (10, x), (20, y), (30, 0.0), (40, words.height), (1, text))


def _tags(*pairs: tuple[int, object]) -> str:
    return "".join(f"{code:3d}\n{f'{v:.6f}' if isinstance(v, float) else v}\n" for code, v in pairs)


# PDF


def write_nest_pdf(path: Path, nest: Nest, title: str, note: str = "") -> None:
    """Write a nest as PDF at true size, on one page as large as it needs, each size in its colour."""
    from reportlab.lib.units import mm
    from reportlab.pdfgen.canvas import Canvas

    from brafit.pattern.font import drawable, face

    width, height, foot = _frame(nest)

    def text(words: str, x: float, y: float, size: float, colour: str = "#000000", centred: bool = False) -> None:
        canvas.setFillColor(colour)
        canvas.setFont(face(), size)
        (canvas.drawCentredString if centred else canvas.drawString)(x, y - 0.35 * size, drawable(_line(words)))

    with replacing(path) as temporary:
        canvas = Canvas(str(temporary), pagesize=(width * mm, height * mm), initialFontName=face())  # type: ignore[arg-type]
        canvas.setTitle(_line(title))
        canvas.setViewerPreference("PrintScaling", "None")
        canvas.scale(mm, mm)
        text(title, MARGIN, height - MARGIN - 6, 6.0)
        text(note, MARGIN, height - MARGIN - 13, 3.6)
        canvas.setLineWidth(0.2)
        canvas.rect(MARGIN, MARGIN + foot - CONTROL, CONTROL, CONTROL)
        text("control square 100 mm", MARGIN + 50, MARGIN + foot - 50, 4.0, centred=True)
        for layer, words, (x, y) in _legend(nest, foot):
            if layer is not None:
                canvas.setStrokeColor(layer.colour)
                canvas.setLineWidth(WIDTHS["cut"])
                canvas.line(x, y, x + 18, y)
            text(words, x + 22 * (layer is not None), y, 3.6)
        canvas.translate((width - nest.width) / 2, MARGIN + foot + GAP)
        for layer in nest.layers:
            for _, strokes in layer.pieces:
                for stroke in strokes:
                    _pdf_stroke(canvas, stroke, layer.colour)
            for words in layer.words:
                text(words.text, float(words.at[0]), float(words.at[1]), words.height, layer.colour, centred=True)
        canvas.showPage()
        canvas.save()


def _pdf_stroke(canvas: Any, stroke: Stroke, colour: str) -> None:
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(WIDTHS[stroke.kind])
    canvas.setDash(*([list(DASHES[stroke.kind])] if stroke.kind in DASHES else []))
    path = canvas.beginPath()
    for k, curve in enumerate(stroke.curves):
        (path.lineTo if k else path.moveTo)(*curve.start)
        for arc in curve.controls:
            path.curveTo(*arc[1:].ravel())
    if stroke.closed:
        path.close()
    canvas.drawPath(path)
