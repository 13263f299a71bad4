"""Patterns as SVG in true millimetres: a user unit is one millimetre.

Each kind of line is a layer (a group that Inkscape shows as one), see `brafit.pattern.drawing`; and in each of them
every piece has a group of its name. What belongs to no piece is in the layer `info`.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.pattern.curve import Curve
from brafit.pattern.drawing import INFO, LAYERS, PENS, Item, Page, Stroke, Words
from brafit.pattern.finish import Pattern
from brafit.pattern.lettering import one_line
from brafit.pattern.sheet import sheet_page

SVG, INKSCAPE = "http://www.w3.org/2000/svg", "http://www.inkscape.org/namespaces/inkscape"


def write_svg(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write patterns at true size, with a legend and a control square of 100 mm.

    In the layer `sew` every edge is a path of its own with the classes `edge` and its kind, its name in the label
    and its length in `data-length-mm`; in `cut` a piece is one closed path. Coordinates are exact to 1e-4 mm.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        patterns: side by side if there are several.
        title: usually the scan's name; any text.
        note: a second line, such as the cup's side and model.
    """
    write_bytes(path, svg_bytes(patterns, title, note))


def svg_bytes(patterns: Sequence[Pattern], title: str, note: str = "") -> bytes:
    """The file that `write_svg` writes."""
    return page_svg(sheet_page(patterns, title, note), title)


def page_svg(page: Page, title: str) -> bytes:
    """A page as SVG. Where it shows several sizes, each is a layer that holds those of its kinds of lines.

    Args:
        page: what is drawn; all of it is shown, whatever its frame.
        title: of the document, any text.
    """
    root = _document(page.width, page.height, title)
    taken: set[str] = set()
    pieces = dict.fromkeys((item.series, item.group) for item in page.items if item.layer in LAYERS)
    groups: dict[tuple[str, str, str], ET.Element] = {}
    for series in dict.fromkeys(series for series, _ in pieces):
        above = _layer(root, series, taken, "size ") if series else root
        layers = {name: _layer(above, name, taken) for name in LAYERS}
        for name in LAYERS:
            for own, piece in pieces:
                if own == series:
                    groups[series, name, piece] = _piece(layers[name], f"{series} {name}", piece, taken)
    info = _layer(root, INFO, taken)
    for item in page.items:
        key = (item.series, item.layer, item.group)
        if key not in groups:
            groups[key] = _child(info, "g", id=item.group) if item.group else info
        flipped = item.map(lambda points: points * (1, -1) + (0, page.height))
        _drawn(groups[key], flipped)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _document(width: float, height: float, title: str) -> ET.Element:
    ET.register_namespace("", SVG)
    ET.register_namespace("inkscape", INKSCAPE)
    size = {"width": f"{_number(width)}mm", "height": f"{_number(height)}mm"}
    root = ET.Element(f"{{{SVG}}}svg", {**size, "viewBox": f"0 0 {_number(width)} {_number(height)}", "version": "1.1"})
    _child(root, "title").text = one_line(_legal(title))
    _child(root, "desc").text = f"Bra cup patterns. Units: mm, true size. Layers: {', '.join(LAYERS)}."
    return root


def _layer(above: ET.Element, name: str, taken: set[str], kind: str = "") -> ET.Element:
    """A layer, in the document or in another layer."""
    label = {f"{{{INKSCAPE}}}label": one_line(_legal(name)), f"{{{INKSCAPE}}}groupmode": "layer"}
    return _child(above, "g", id=_identifier(kind + name, taken), **label)


def _piece(layer: ET.Element, name: str, piece: str, taken: set[str]) -> ET.Element:
    label = {f"{{{INKSCAPE}}}label": _legal(piece), "class": "piece"}
    return _child(layer, "g", id=_identifier(f"{name} {piece}", taken), **label)


def _drawn(group: ET.Element, item: Item) -> None:
    """An item whose y runs downwards. Attributes, not a style sheet: cutting software often ignores style sheets."""
    if isinstance(item, Words):
        _text(group, item)
    else:
        _stroke(group, item)


def _stroke(group: ET.Element, stroke: Stroke) -> None:
    data = " ".join(_path(path, stroke.closed) for path in stroke.paths)
    pen = PENS[stroke.pen]
    style = {"stroke": stroke.ink, "stroke-width": _number(pen.width), "stroke-linejoin": "round"}
    if pen.dashes:
        style["stroke-dasharray"] = " ".join(map(_number, pen.dashes))
    path = _child(group, "path", **{"class": stroke.role}, d=data, fill=stroke.fill or "none", **style)
    if stroke.name:
        path.set(f"{{{INKSCAPE}}}label", _legal(stroke.name))
    for key, value in stroke.about.items():
        path.set(f"data-{key}", _legal(value))


def _text(group: ET.Element, words: Words) -> None:
    x, y = words.at
    style = {
        "font-family": "sans-serif",
        "font-size": _number(words.size),
        "font-weight": "bold" if words.bold else "normal",
        "text-anchor": "middle" if words.centred else "start",
    }
    line = _child(group, "text", x=_number(x), y=_number(y + 0.35 * words.size), fill=words.colour, **style)
    if words.name and words.layer == INFO:
        line.set("id", words.name)
    if abs(words.angle) > 1e-6:
        line.set("transform", f"rotate({_number(words.angle)} {_number(x)} {_number(y)})")
    line.text = _legal(words.text)


def _path(curves: Sequence[Curve], closed: bool) -> str:
    """Path data: curves one after another."""
    parts = [_arcs(curve, first=i == 0) for i, curve in enumerate(curves)]
    return " ".join([*parts, "Z"] if closed else parts)


def _arcs(curve: Curve, first: bool) -> str:
    """A curve that is not the first of its path goes on where the one before it ended."""
    arcs = curve.controls
    start, end = arcs[:, 0], arcs[:, 3]
    thirds = np.stack(((2 * start + end) / 3, (start + 2 * end) / 3), axis=1)
    straight = (np.abs(thirds - arcs[:, 1:3]).max((1, 2)) < 1e-9).tolist()
    form = " ".join("L%.4f,%.4f" if line else "C%.4f,%.4f %.4f,%.4f %.4f,%.4f" for line in straight)
    numbers = [v for line, arc in zip(straight, arcs.tolist(), strict=True) for p in arc[3 if line else 1 :] for v in p]
    return f"{'M' if first else 'L'}{_pair(curve.start)} " + form % tuple(numbers)


def _pair(point: Float[ndarray, "2"]) -> str:
    return f"{point[0]:.4f},{point[1]:.4f}"


def _child(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{SVG}}}{tag}", attributes)


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")


def _legal(text: str) -> str:
    """Text with the characters that XML 1.0 cannot hold replaced."""
    return re.sub("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)


def _identifier(text: str, taken: set[str]) -> str:
    """A new XML identifier that resembles the text."""
    base = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "piece"
    base = base if base[0].isalpha() else f"piece-{base}"
    name, count = base, 1
    while name in taken:
        count += 1
        name = f"{base}-{count}"
    taken.add(name)
    return name
