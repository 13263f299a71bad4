"""Patterns as they look: boxes of texts and marks, labels on their pieces, pages, seams that end together, stitches."""

from __future__ import annotations

import json
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from readers import LABEL, POINT, SVG, module, path_points, program, quietly
from shapely import LineString, Polygon

PAGE_BORDER = 10.0
"""What printers leave white at most, mm."""


@dataclass(frozen=True)
class Box:
    """What a text or a mark covers: an oriented box, mm, y down."""

    name: str
    piece: str
    shape: Polygon
    is_text: bool


def sheet_figures(path: Path) -> dict[str, float]:
    """What overlaps on the sheet, and which labels are not on their pieces."""
    root: Any = ET.parse(path).getroot()
    layers = {group.get(LABEL): group for group in root if group.get(LABEL)}
    boxes = [*_texts(root, layers), *_marks(layers)]
    overlaps = [(a, b) for a, b in combinations(boxes, 2) if a.shape.intersection(b.shape).area > 1e-3]
    cut = {group.get(LABEL): Polygon(_points(group[0])) for group in layers["cut"]}
    drawn = [LineString(_points(line)) for key in ("cut", "sew") for group in layers[key] for line in group]
    words = [box for box in boxes if box.is_text]
    return {
        "sheet: texts or marks that overlap": len(overlaps),
        "sheet: texts that meet cut or sewing lines": sum(
            any(box.shape.intersects(line) for line in drawn) for box in words
        ),
        "sheet: labels not on their piece": sum(bool(b.piece) and not cut[b.piece].contains(b.shape) for b in words),
        "seam ends: allowances of the two sides end apart": _ends_apart(layers),
    }


def _points(path: Any, count: int = 60) -> np.ndarray:
    return path_points(module("svgelements").Path(path.get("d")), count)


def _texts(root: Any, layers: dict[str, Any]) -> Iterator[Box]:
    owners = {id(text): group.get(LABEL) for group in layers["text"] for text in group}
    for text in root.iter(f"{SVG}text"):
        if text.text:
            yield Box(text.text, owners.get(id(text), ""), _text_box(text), True)


def _text_box(text: Any) -> Polygon:
    """The ink of a line of text in DejaVu Sans, which is wider than other faces without serifs."""
    from PIL import ImageFont

    from brafit.typeface import BOLD, PLAIN, typeface

    size, x, y = (float(text.get(key)) for key in ("font-size", "x", "y"))
    face = ImageFont.truetype(str(typeface(BOLD if text.get("font-weight") == "bold" else PLAIN)), 100)
    box = np.array(face.getbbox(text.text, anchor="ls"), float).reshape(2, 2) * size / 100
    left = -face.getlength(text.text) * size / 200 if text.get("text-anchor") == "middle" else 0.0
    (low, top), (high, bottom) = (box + np.array((x + left, y))).tolist()
    shape = shapely.box(low, top, high, bottom)
    turn = re.match(r"rotate\(([-\d.]+) ([-\d.]+) ([-\d.]+)\)", text.get("transform") or "")
    if turn is None:
        return shape
    angle, centre_x, centre_y = (float(number) for number in turn.groups())
    return shapely.affinity.rotate(shape, angle, origin=(centre_x, centre_y))


def _marks(layers: dict[str, Any]) -> Iterator[Box]:
    for layer in ("notch", "drill", "grain"):
        for group in layers[layer]:
            for path in group:
                hull = shapely.MultiPoint(np.vstack(list(_subpaths(path)))).minimum_rotated_rectangle.buffer(0.17)
                yield Box(path.get(LABEL) or layer, group.get(LABEL), hull, False)


def _subpaths(path: Any) -> Iterator[np.ndarray]:
    for part in re.findall(r"M[^M]*", path.get("d")):
        yield path_points(module("svgelements").Path(part))


def _ends_apart(layers: dict[str, Any]) -> float:
    """Past both ends of a seam, where its allowance ends on one piece and where on the other: the difference in mm."""
    found: dict[tuple[str, bool], list[float]] = {}
    for cut, sewn in zip(layers["cut"], layers["sew"], strict=True):
        rim, lines = _points(cut[0]), [_points(path, 4000) for path in sewn]
        cloth = Polygon(np.vstack(lines))
        for number, (path, line) in enumerate(zip(sewn, lines, strict=True)):
            width = float(path.get("data-allowance-mm"))
            if "ridge" not in path.get("class") or width == 0:
                continue
            for points, way in ((line, 1.0), (line[::-1], -1.0)):
                side = _across(line, len(line) // 2)
                left = not cloth.contains(shapely.Point(line[len(line) // 2] + 0.5 * side))
                outward = way * (1 if left else -1) * _across(points, 1)
                past = (points[0] - points[1]) / np.linalg.norm(points[0] - points[1])
                along, aside = (rim - points[0]) @ past, (rim - points[0]) @ outward
                reach = along[(np.abs(aside - width) < 0.05) & (along < 5 * width)].max(initial=0.0)
                found.setdefault((path.get(LABEL), (way > 0) == (number == 0)), []).append(float(reach))
    return max((max(both) - min(both) for both in found.values() if len(both) == 2), default=0.0)


def _across(line: np.ndarray, index: int) -> np.ndarray:
    """Unit vector to one side of a polyline."""
    step = line[index] - line[index - 1]
    return np.array((-step[1], step[0])) / np.linalg.norm(step)


def page_figures(folder: Path) -> dict[str, float]:
    """How many pieces that fit on a page are not whole on one, as poppler reads the pages; and missing layers."""
    root: Any = ET.parse(folder / "patterns.svg").getroot()
    layers = {group.get(LABEL): group for group in root if group.get(LABEL)}
    outlines = [_points(group[0]) for group in layers["cut"]]
    whole = list(_whole_paths(folder / "patterns.pdf"))
    missing = 0
    for outline in outlines:
        ring = LineString(np.vstack((outline, outline[:1])))
        missing += fits(outline) and not any(abs(length - ring.length) < 0.2 for length in whole)
    groups = (folder / "patterns_sheet.pdf").read_bytes().count(b"/Type /OCG")
    marked = [
        key
        for key in ("cut", "sew", "notch", "drill", "grain")
        if next(layers[key].iter(f"{SVG}path"), None) is not None
    ]
    return {
        "pages: pieces that fit on a page but are cut": missing,
        "PDF: layers missing": max(0, len([*marked, "text", "info"]) - groups),
    }


def fits(outline: np.ndarray, paper: Sequence[float] = (210.0, 297.0)) -> bool:
    """Whether a piece fits on the paper, turned any way."""
    rooms = [np.array(size) - 2 * PAGE_BORDER for size in (paper, paper[::-1])]
    for angle in np.radians(np.arange(0, 180, 1.0)):
        along = np.array((np.cos(angle), np.sin(angle)))
        size = np.ptp(outline @ np.stack((along, (-along[1], along[0])), axis=1), axis=0)
        if any((size <= room).all() for room in rooms):
            return True
    return False


def _whole_paths(path: Path) -> Iterator[float]:
    """Lengths (mm) of the paths that lie wholly within the white border of a page."""
    elements = module("svgelements")
    count = int(re.search(rb"Pages:\s+(\d+)", quietly(program("pdfinfo", "poppler-utils"), path))[1])  # type: ignore[index]
    with tempfile.TemporaryDirectory() as folder:
        for number in range(2, count + 1):
            out = Path(folder) / "page.svg"
            quietly(program("pdftocairo", "poppler-utils"), "-svg", "-noshrink", "-f", number, "-l", number, path, out)
            root = ET.parse(out).getroot()
            size = np.array([float((root.get(key) or "0").removesuffix("pt")) for key in ("width", "height")]) * POINT
            for element in root.iter(f"{SVG}path"):
                if "clip" in (element.get("clip-path") or ""):
                    continue
                curve = abs(elements.Path(element.get("d")) * elements.Matrix(element.get("transform", "")))
                points = path_points(curve) * POINT if len(curve) > 2 else np.zeros((0, 2))
                if len(points) and (points > PAGE_BORDER - 0.1).all() and (points < size - PAGE_BORDER + 0.1).all():
                    yield float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def stitch_figures(folder: Path) -> dict[str, float]:
    """The cup's seams rebuilt from stitch list and OBJ file alone."""
    listed = json.loads((folder / "stitches.json").read_text(encoding="utf-8"))
    rows = [line.split() for line in (folder / listed["mesh"]).read_text(encoding="utf-8").splitlines()]
    space = np.array([row[1:] for row in rows if row[0] == "v"], float)
    flat = np.array([row[1:] for row in rows if row[0] == "vt"], float)
    edges = {(piece["name"], edge["name"]): edge for piece in listed["pieces"] for edge in piece["edges"]}
    apart, uneven, unequal = 0.0, 0, 0.0
    for seam in listed["seams"]:
        first, second = (edges[side["piece"], side["edge"]] for side in seam["sides"])
        a, b = (np.array(edge["vertices"]) - 1 for edge in (first, second))
        uneven += len(a) != len(b)
        apart = max(apart, float(np.linalg.norm(space[a] - space[b], axis=1).max()))
        unequal = max(unequal, abs(first["length_mm"] - second["length_mm"]))
    for edge in edges.values():
        line = flat[np.array(edge["vertices"]) - 1]
        unequal = max(unequal, abs(smooth_length(line) - edge["length_mm"]))
    return {
        "stitches: seams with unequal vertex counts": uneven,
        "stitches: sewn vertices apart in the cup": apart,
        "stitches: lengths differ": unequal,
    }


def smooth_length(points: np.ndarray) -> float:
    """Length of the smooth curve through points."""
    from scipy.interpolate import CubicSpline

    chords = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.linspace(0, chords[-1], 20001)
    return float(np.linalg.norm(np.diff(CubicSpline(chords, points)(at), axis=0), axis=1).sum())
