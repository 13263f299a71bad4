"""Patterns as SVG in true millimetres: a user unit is one millimetre.

Each kind of line is a layer (a group that Inkscape shows as one): `cut`, `sew`, `notch`, `drill`, `grain`, `text`; and
in each of them every piece has a group of its name. What belongs to no piece is in the layer `info`.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.atomic import write_bytes
from brafit.pattern.curve import Curve
from brafit.pattern.finish import CutPiece, Pattern, warnings_of
from brafit.pattern.label import text_width
from brafit.pattern.piece import Kind, layout_columns

SVG, INKSCAPE = "http://www.w3.org/2000/svg", "http://www.inkscape.org/namespaces/inkscape"
MARGIN, GAP, CONTROL = 12.0, 10.0, 100.0
LAYERS = ("cut", "sew", "notch", "drill", "grain", "text")

# Told apart by colour, width and dashes, so that a black-and-white print shows them too. Attributes, not a style sheet:
# cutting software often ignores style sheets.
STROKES: dict[Kind, dict[str, str]] = {
    "wire": {"stroke": "#0b5394", "stroke-width": "0.7"},
    "ridge": {"stroke": "#b4460f", "stroke-width": "0.4", "stroke-dasharray": "6 1.5"},
    "upper": {"stroke": "#2e6b34", "stroke-width": "0.4", "stroke-dasharray": "1.2 1.2"},
}
CUT = {"stroke": "#000000", "stroke-width": "0.3"}
FINE = {"stroke": "#000000", "stroke-width": "0.35"}
UNIT_WORDS = {"mm": "units: mm, true size (1:1)", "inch": "lengths in inches, true size (1:1)"}
LEGEND: dict[Kind, str] = {"wire": "wire edge", "ridge": "ridge (seam between panels)", "upper": "upper edge"}


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
    sheet = layout_columns([column for pattern in patterns for column in pattern.drawn], GAP)
    kinds = {line.kind for piece in sheet.pieces for line in piece.sew}
    warnings = warnings_of(patterns)
    head = 12.0 + 6.0 * bool(note)
    inner = max(sheet.width, CONTROL + GAP + 92.0)
    foot = max(CONTROL, 42.0 + 5.5 * len(warnings))
    width, height = inner + 2 * MARGIN, head + sheet.height + GAP + foot + 2 * MARGIN
    root = _document(width, height, title)

    offset = np.array([(width - sheet.width) / 2, MARGIN + GAP + foot])
    placed = [piece.map(lambda points: (points + offset) * (1, -1) + (0, height)) for piece in sheet.pieces]
    taken: set[str] = set()
    draw = {"cut": _cut, "sew": _sew, "notch": _notches, "drill": _holes, "grain": _grain, "text": _label}
    several = len({pattern.name for pattern in patterns}) > 1 or any(pattern.options.pair for pattern in patterns)
    for layer in LAYERS:
        group = _layer(root, layer)
        taken.add(layer)
        for piece in placed:
            name = " ".join((*piece.label.lines[1:3], piece.name)) if several else piece.name
            attributes = {f"{{{INKSCAPE}}}label": _legal(name), "class": "piece"}
            own = _child(group, "g", id=_identifier(f"{layer} {name}", taken), **attributes)
            draw[layer](own, piece)

    info = _layer(root, "info")
    _text(info, _one_line(title), MARGIN, MARGIN + 6, 6.0, room=inner, weight="bold", id="title")
    if note:
        _text(info, _one_line(note), MARGIN, MARGIN + 12, 3.6, room=inner, id="note")
    top = height - MARGIN - foot
    _control_square(info, MARGIN, top)
    about = (UNIT_WORDS[patterns[0].options.units], f"{len(placed)} piece{'s' * (len(placed) > 1)}")
    _legend(info, MARGIN + CONTROL + GAP, top, kinds, about, warnings, inner - CONTROL - GAP)

    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _document(width: float, height: float, title: str) -> ET.Element:
    ET.register_namespace("", SVG)
    ET.register_namespace("inkscape", INKSCAPE)
    size = {"width": f"{_number(width)}mm", "height": f"{_number(height)}mm"}
    root = ET.Element(f"{{{SVG}}}svg", {**size, "viewBox": f"0 0 {_number(width)} {_number(height)}", "version": "1.1"})
    _child(root, "title").text = _one_line(title)
    _child(root, "desc").text = "Bra cup patterns. Units: mm, true size. Layers: cut, sew, notch, drill, grain, text."
    return root


def _layer(root: ET.Element, name: str) -> ET.Element:
    return _child(root, "g", id=name, **{f"{{{INKSCAPE}}}label": name, f"{{{INKSCAPE}}}groupmode": "layer"})


def _cut(group: ET.Element, piece: CutPiece) -> None:
    path = " ".join([_path(piece.cut[0]), *(_path(curve, first=False) for curve in piece.cut[1:]), "Z"])
    _child(group, "path", **{"class": "cut"}, d=path, fill="none", **{"stroke-linejoin": "miter"}, **CUT)


def _sew(group: ET.Element, piece: CutPiece) -> None:
    for line in piece.sew:
        path = _line(group, line.kind, _path(line.curve))
        path.set(f"{{{INKSCAPE}}}label", _legal(line.name))
        path.set("data-length-mm", f"{line.length:.3f}")
        path.set("data-allowance-mm", f"{line.allowance:g}")


def _notches(group: ET.Element, piece: CutPiece) -> None:
    for notch in piece.notches:
        ticks = " ".join(f"M{_pair(a)} L{_pair(b)}" for a, b in notch.ticks)
        path = _child(group, "path", **{"class": "notch"}, d=ticks, fill="none", **FINE)
        path.set(f"{{{INKSCAPE}}}label", _legal(notch.name or f"{notch.edge} notch"))
        path.set("data-edge", _legal(notch.edge))
        path.set("data-distance-mm", f"{notch.distance:.3f}")


def _holes(group: ET.Element, piece: CutPiece) -> None:
    for hole in piece.holes:
        x, y = hole.point
        circle = _child(group, "circle", cx=_number(x), cy=_number(y), r="1.5", fill="none", **FINE)
        circle.set(f"{{{INKSCAPE}}}label", _legal(hole.name))
        _child(group, "path", d=f"M{_number(x - 3)},{_number(y)} h6 m-3,-3 v6", fill="none", **FINE)


def _grain(group: ET.Element, piece: CutPiece) -> None:
    a, b = piece.grain
    size = float(np.linalg.norm(b - a))
    if size == 0:
        return
    heads = [arrow_head(a, b, min(3.0, size / 4)), arrow_head(b, a, min(3.0, size / 4))]
    strokes = [f"M{_pair(a)} L{_pair(b)}", *(f"M{_pair(p)} L{_pair(tip)} L{_pair(q)}" for p, tip, q in heads)]
    _child(group, "path", **{"class": "grain"}, d=" ".join(strokes), fill="none", **FINE)


def arrow_head(tip: Float[ndarray, "2"], tail: Float[ndarray, "2"], size: float) -> Float[ndarray, "3 2"]:
    """The two strokes of an arrow's head: one barb, the tip, the other barb."""
    back = (tail - tip) / max(float(np.linalg.norm(tail - tip)), 1e-9) * size
    aside = np.array((-back[1], back[0])) * 0.4
    return np.stack((tip + back + aside, tip, tip + back - aside))


def _label(group: ET.Element, piece: CutPiece) -> None:
    label = piece.label
    for row, words in enumerate(label.all_lines):
        colour = "#c00000" if row >= len(label.lines) else "#000000"
        weight = "bold" if label.is_bold(row) else "normal"
        _centred(group, words, label.middle(row, upwards=False), label.along, label.size, weight=weight, colour=colour)
    for caption in piece.captions:
        if caption.leader is not None:
            _child(group, "path", d=" L".join(("M" + _pair(caption.leader[0]), _pair(caption.leader[1]))), fill="none",
                   stroke="#000000", **{"stroke-width": "0.15"})  # fmt: skip
        _centred(group, caption.words, caption.at, caption.along, caption.size)


def _centred(
    group: ET.Element,
    words: str,
    at: Float[ndarray, "2"],
    along: Float[ndarray, "2"],
    size: float,
    weight: str = "normal",
    colour: str = "#000000",
) -> None:
    """A line of text about a point; y runs downwards."""
    x, y = at
    angle = float(np.degrees(np.arctan2(along[1], along[0])))
    line = _text(group, words, x, y + 0.35 * size, size, anchor="middle", weight=weight, colour=colour)
    if abs(angle) > 1e-6:
        line.set("transform", f"rotate({_number(angle)} {_number(x)} {_number(y)})")


def _control_square(root: ET.Element, x: float, y: float) -> None:
    group = _child(root, "g", id="control-square")
    _child(group, "rect", x=_number(x), y=_number(y), width=_number(CONTROL), height=_number(CONTROL), fill="none",
           stroke="#000000", **{"stroke-width": "0.2"})  # fmt: skip
    _text(group, "control square 100 mm x 100 mm", x + CONTROL / 2, y + CONTROL / 2, 4.0, anchor="middle")
    _text(group, "measure it on the print before cutting", x + CONTROL / 2, y + CONTROL / 2 + 5.5, 3.2, anchor="middle")


def _legend(
    root: ET.Element,
    x: float,
    y: float,
    present: Container[str],
    about: tuple[str, str],
    warnings: Sequence[str],
    room: float,
) -> None:
    group = _child(root, "g", id="legend")
    _text(group, about[0], x, y + 4, 3.6, weight="bold")
    kinds: list[Kind] = [kind for kind in LEGEND if kind in present]
    _child(group, "path", d=f"M{_number(x)},{_number(y + 11)} H{_number(x + 20)}", fill="none", **CUT)
    _text(group, "cut line", x + 23, y + 12.2, 3.6)
    for row, kind in enumerate(kinds, start=1):
        level = y + 11 + 6 * row
        _line(group, kind, f"M{_number(x)},{_number(level)} H{_number(x + 20)}", role="key")
        _text(group, f"sewing line: {LEGEND[kind]}", x + 23, level + 1.2, 3.6)
    y += 18 + 6 * len(kinds)
    for row, words in enumerate(("right side of the cloth up", about[1])):
        _text(group, words, x, y + 1.2 + 5.5 * row, 3.6)
    for row, words in enumerate(warnings, start=2):
        _text(group, f"WARNING: {words}", x, y + 1.2 + 5.5 * row, 3.6, room=room, weight="bold", colour="#c00000")


def _path(curve: Curve, first: bool = True) -> str:
    """Path data; a curve that is not the first of its path goes on where the one before it ended."""
    arcs = curve.controls
    start, end = arcs[:, 0], arcs[:, 3]
    thirds = np.stack(((2 * start + end) / 3, (start + 2 * end) / 3), axis=1)
    straight = (np.abs(thirds - arcs[:, 1:3]).max((1, 2)) < 1e-9).tolist()
    form = " ".join("L%.4f,%.4f" if line else "C%.4f,%.4f %.4f,%.4f %.4f,%.4f" for line in straight)
    numbers = [v for line, arc in zip(straight, arcs.tolist(), strict=True) for p in arc[3 if line else 1 :] for v in p]
    return f"{'M' if first else 'L'}{_pair(curve.start)} " + form % tuple(numbers)


def _pair(point: Float[ndarray, "2"]) -> str:
    return f"{point[0]:.4f},{point[1]:.4f}"


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
    colour: str = "#000000",
    **attributes: str,
) -> ET.Element:
    """A line of text, its letters `size` mm high; smaller where it would be longer than `room`."""
    words = _legal(words)
    if room is not None:
        size = min(size, room / max(text_width(words, 1.0, bold=weight == "bold"), 0.1))
    style = {"font-family": "sans-serif", "font-size": _number(size), "font-weight": weight, "text-anchor": anchor}
    line = _child(parent, "text", x=_number(x), y=_number(y), fill=colour, **style, **attributes)
    line.text = words
    return line


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
