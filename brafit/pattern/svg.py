"""Patterns as SVG in true millimetres: a user unit is one millimetre, a piece is a named group (an Inkscape layer)."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np

from brafit.atomic import write_bytes
from brafit.pattern.piece import Edge, Kind, Piece, layout

SVG, INKSCAPE = "http://www.w3.org/2000/svg", "http://www.inkscape.org/namespaces/inkscape"
MARGIN, GAP, CONTROL = 12.0, 10.0, 100.0

# Told apart by colour, width and dashes, so that a black-and-white print shows them too. Attributes, not a style sheet:
# cutting software often ignores style sheets.
STROKES: dict[Kind, dict[str, str]] = {
    "wire": {"stroke": "#0b5394", "stroke-width": "0.7"},
    "ridge": {"stroke": "#b4460f", "stroke-width": "0.4", "stroke-dasharray": "6 1.5"},
    "upper": {"stroke": "#2e6b34", "stroke-width": "0.4", "stroke-dasharray": "1.2 1.2"},
}
LEGEND: dict[Kind, str] = {"wire": "wire edge", "ridge": "ridge (seam between panels)", "upper": "upper edge"}


def write_svg(path: str | Path, pieces: Sequence[Piece], title: str, note: str = "") -> None:
    """Write pieces at true size, with a legend and a control square of 100 mm.

    Every edge is a path of its own with the classes `edge` and its kind, in the group of its piece; the name of that
    group stands in `inkscape:label` and, made fit for XML, in `id`. Coordinates are exact to 1e-4 mm.

    Args:
        pieces: one cup's pieces in mm.
        title: usually the scan's name; any text.
        note: a second line, such as the cup's side and model.
    """
    sheet = layout(pieces, GAP)
    head = 18.0 if note else 12.0
    legend_width = 78.0
    inner = max(sheet.width, CONTROL + GAP + legend_width)
    width, height = inner + 2 * MARGIN, head + sheet.height + GAP + CONTROL + 2 * MARGIN
    root = _document(width, height, title)
    _text(root, _one_line(title), MARGIN, MARGIN + 6, 6.0, room=inner, weight="bold", id="title")
    if note:
        _text(root, _one_line(note), MARGIN, MARGIN + 12, 3.6, room=inner, id="note")

    offset = np.array([(width - sheet.width) / 2, MARGIN + GAP + CONTROL])
    taken: set[str] = set()
    for piece in sheet.pieces:
        _piece(root, piece.map(lambda points: (points + offset) * (1, -1) + (0, height)), taken)
    _control_square(root, MARGIN, height - MARGIN - CONTROL)
    present = {edge.kind for piece in pieces for edge in piece.edges}
    _legend(root, MARGIN + CONTROL + GAP, height - MARGIN - CONTROL, present, pieces)

    ET.indent(root)
    write_bytes(path, ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _document(width: float, height: float, title: str) -> ET.Element:
    ET.register_namespace("", SVG)
    ET.register_namespace("inkscape", INKSCAPE)
    size = {"width": f"{_number(width)}mm", "height": f"{_number(height)}mm"}
    root = ET.Element(f"{{{SVG}}}svg", {**size, "viewBox": f"0 0 {_number(width)} {_number(height)}", "version": "1.1"})
    _child(root, "title").text = _one_line(title)
    _child(root, "desc").text = "Bra cup patterns. Units: mm, true size. Sewing lines, without seam allowance."
    return root


def _piece(root: ET.Element, piece: Piece, taken: set[str]) -> None:
    name = _identifier(piece.name, taken)
    layer = {f"{{{INKSCAPE}}}label": _legal(piece.name), f"{{{INKSCAPE}}}groupmode": "layer"}
    group = _child(root, "g", id=name, **{"class": "piece"}, **layer)
    for edge in piece.edges:
        path = _line(group, edge.kind, _path(edge), id=_identifier(f"{name} {edge.name}", taken))
        path.set(f"{{{INKSCAPE}}}label", _legal(edge.name))
        path.set("data-length-mm", f"{edge.length:.3f}")
    x, y = piece.middle
    thickness = float(np.linalg.norm(piece.edges[0].at(0.5) - piece.edges[1].at(0.5)))
    size = min(5.0, thickness / 5)
    lengths = ", ".join(f"{edge.name}: {edge.length:.1f} mm" for edge in piece.edges)
    _text(group, piece.name, x, y - 0.2 * size, size, anchor="middle", weight="bold")
    _text(group, lengths, x, y + 1.0 * size, 0.6 * size, anchor="middle")
    for words, fraction in (("inner end", 0.0), ("outer end", 1.0)):
        _end_label(group, words, piece, fraction, 0.5 * size)


def _end_label(group: ET.Element, words: str, piece: Piece, fraction: float, size: float) -> None:
    """A small upright text just outside the tip."""
    x, y = piece.edges[0].at(fraction)
    x += -0.6 * size if x < piece.middle[0] else 1.4 * size
    turn = f"rotate(-90 {_number(x)} {_number(y)})"
    _text(group, words, x, y, size, anchor="middle", transform=turn)


def _control_square(root: ET.Element, x: float, y: float) -> None:
    group = _child(root, "g", id="control-square")
    _child(group, "rect", x=_number(x), y=_number(y), width=_number(CONTROL), height=_number(CONTROL), fill="none",
           stroke="#000000", **{"stroke-width": "0.2"})  # fmt: skip
    _text(group, "control square 100 mm x 100 mm", x + CONTROL / 2, y + CONTROL / 2, 4.0, anchor="middle")
    _text(group, "measure it on the print before cutting", x + CONTROL / 2, y + CONTROL / 2 + 5.5, 3.2, anchor="middle")


def _legend(root: ET.Element, x: float, y: float, present: Container[str], pieces: Sequence[Piece]) -> None:
    group = _child(root, "g", id="legend")
    _text(group, "units: mm, true size (1:1)", x, y + 4, 3.6, weight="bold")
    kinds: list[Kind] = [kind for kind in LEGEND if kind in present]
    for row, kind in enumerate(kinds):
        level = y + 12 + 7 * row
        _line(group, kind, f"M{_number(x)},{_number(level)} H{_number(x + 20)}", role="key")
        _text(group, LEGEND[kind], x + 23, level + 1.2, 3.6)
    y += 12 + 7 * len(kinds)
    count = f"{len(pieces)} piece{'s' * (len(pieces) > 1)}"
    for row, words in enumerate(("sewing lines, no seam allowance", "right side of the cloth up", count)):
        _text(group, words, x, y + 1.2 + 5.5 * row, 3.6)


def _path(edge: Edge) -> str:
    return "M" + " L".join(f"{x:.4f},{y:.4f}" for x, y in edge.points)


def _line(parent: ET.Element, kind: Kind, path: str, role: str = "edge", **attributes: str) -> ET.Element:
    style = {"fill": "none", "stroke-linejoin": "round", **STROKES[kind]}
    return _child(parent, "path", **attributes, **{"class": f"{role} {kind}"}, d=path, **style)


def _text(
    parent: ET.Element,
    words: str,
    x: float,
    y: float,
    size: float,
    *,
    room: float | None = None,
    anchor: str = "start",
    weight: str = "normal",
    **attributes: str,
) -> None:
    """A line of text, its letters `size` mm high; smaller where it would be longer than `room`."""
    words = _legal(words)
    if room is not None:  # letters of a sans-serif face are about 0.6 of its size wide
        size = min(size, room / (0.62 * max(len(words), 1)))
    style = {"font-family": "sans-serif", "font-size": _number(size), "font-weight": weight, "text-anchor": anchor}
    _child(parent, "text", x=_number(x), y=_number(y), fill="#000000", **style, **attributes).text = words


def _child(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{SVG}}}{tag}", attributes)


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")


def _one_line(text: str) -> str:
    return " ".join(_legal(text).split())


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
