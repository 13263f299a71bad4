"""Measure the files of finished runs with readers that brafit does not write with: true size, lengths, shapes.

    python scripts/check_patterns.py RESULTS [RESULTS ...]

Of every scan in these folders the pattern files, the cup in 3D and the report are read back: DXF by ezdxf, GDAL and
trimesh, SVG by svgelements and librsvg, PDF by poppler, the panels flattened again by libigl, measures over the surface
taken by trimesh and libigl, the report shown in Chromium. What is not installed is said. Prints the largest value of
each figure beside its limit; status 1 if one is over it.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from check_cup import PLAIN, cup_figures, libigl_figures
from check_measures import measure_figures
from check_pages import page_figures, sheet_figures, stitch_figures
from readers import LABEL, POINT, SVG, MissingReaderError, module, path_points, polyline_length, program, quietly
from shapely import LineString, Point, Polygon

LAYERS = {"1", "2", "3", "4", "7", "14", "15"}
"""Layers that every piece of a DXF file has; 13 too where a hole is drilled."""
INCH = 25.4

LIMITS: dict[str, tuple[float, str]] = {
    "DXF: errors found by ezdxf's audit": (0, ""),
    "DXF: layers or texts missing": (0, ""),
    "DXF: edge lengths, ezdxf": (0.05, "mm"),
    "DXF: edge lengths, GDAL": (0.05, "mm"),
    "DXF: edge lengths, trimesh": (0.05, "mm"),
    "SVG: edge lengths, svgelements": (0.1, "mm"),
    "SVG: control square off 1000 px, librsvg": (1, "px"),
    "PDF: edge lengths, poppler": (0.1, "mm"),
    "PDF: control square off 1000 px, tiles, poppler": (1, "px"),
    "PDF: control square off 1000 px, sheet, poppler": (1, "px"),
    "curves off the fitted outline": (0.01, "mm"),
    "edge lengths, cup in 3D": (0.05, "mm"),
    "libigl: off the pattern, LSCM": (0.02, "mm"),
    "libigl: off the pattern, ARAP": (0.02, "mm"),
    "libigl: edge strain, ARAP against the cup": (1e-4, ""),
    "angle defect of inner vertices": (1e-5, "rad"),
    "notches: pairs at unequal distance": (0.01, "mm"),
    "outlines that cross themselves": (0, ""),
    "seam ends: allowances of the two sides end apart": (0.05, "mm"),
    "sheet: texts or marks that overlap": (0, ""),
    "sheet: texts that meet cut or sewing lines": (0, ""),
    "sheet: labels not on their piece": (0, ""),
    "pages: pieces that fit on a page but are cut": (0, ""),
    "PDF: layers missing": (0, ""),
    "stitches: seams with unequal vertex counts": (0, ""),
    "stitches: sewn vertices apart in the cup": (1e-6, "mm"),
    "stitches: lengths differ": (0.01, "mm"),
    "over the surface: sections, trimesh": (0.2, "mm"),
    "over the surface: geodesic, libigl": (0.2, "mm"),
    "report: size": (2.0, "MB"),
    "report: shown after": (2.0, "s"),
}
"""Figures in the order in which they are printed, and the most that each may be."""
OTHERS = (
    *PLAIN,
    "arcs of an edge",
    "arcs of a cut line",
    "points of an edge in DXF",
)


@dataclass
class Findings:
    """The figures of all scans, and what could not be measured."""

    values: dict[str, dict[str, float]] = field(default_factory=dict)
    missing: dict[str, str] = field(default_factory=dict)

    def note(self, figure: str, scan: str, value: float) -> None:
        row = self.values.setdefault(figure, {})
        row[scan] = max(row.get(scan, 0.0), float(value))


def main() -> int:
    """Measure the runs named on the command line and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("results", type=Path, nargs="+", help="folders that brafit wrote")
    parser.add_argument("--without-browser", action="store_true", help="leave the reports' loading times out")
    options = parser.parse_args()
    found = Findings()
    folders = [file.parent for root in options.results for file in sorted(root.glob("*/fit.json"))]
    scans = {folder: json.loads((folder / "fit.json").read_text(encoding="utf-8")) for folder in folders}
    scans = {folder: fit for folder, fit in scans.items() if fit["status"] == "ok"}
    if not scans:
        print("no finished scan in", *options.results)
        return 2
    for count, (folder, fit) in enumerate(scans.items(), start=1):
        print(f"{count} of {len(scans)}: {folder}", file=sys.stderr)
        check(folder, fit, found, browser=not options.without_browser)
    print(table(found, len(scans)))
    values = found.values.items()
    return int(any(max(row.values()) > LIMITS[figure][0] for figure, row in values if figure in LIMITS))


def check(folder: Path, fit: Mapping[str, Any], found: Findings, browser: bool = True) -> None:
    """Measure one scan's folder."""
    scan = f"{fit['scan']}, {fit['panels']} panels"
    lengths = fit["edges_mm"]
    steps = [
        ("DXF: ", lambda: dxf_figures(folder / "patterns.dxf", lengths)),
        ("DXF: edge lengths, GDAL", lambda: gdal_figures(folder / "patterns.dxf", lengths)),
        ("DXF: edge lengths, trimesh", lambda: trimesh_figures(folder / "patterns.dxf", lengths)),
        ("SVG: ", lambda: svg_figures(folder / "patterns.svg", lengths)),
        ("SVG: control square", lambda: librsvg_figures(folder / "patterns.svg")),
        ("PDF: ", lambda: pdf_figures(folder, lengths)),
        ("cup", lambda: cup_figures(folder, lengths)),
        ("libigl", lambda: libigl_figures(folder / "cup.obj")),
        ("sheet", lambda: sheet_figures(folder / "patterns.svg")),
        ("pages", lambda: page_figures(folder)),
        ("stitches", lambda: stitch_figures(folder)),
        ("over the surface", lambda: measure_figures(folder, fit)),
        ("report", lambda: report_figures(folder / "report.html", browser)),
    ]
    for name, step in steps:
        try:
            for figure, value in step().items():
                found.note(figure, scan, value)
        except MissingReaderError as reason:
            found.missing[name] = str(reason)


def table(found: Findings, count: int) -> str:
    """Figures, limits and largest values as lines of a Markdown table."""
    lines = [f"{count} fits", "", "| figure | limit | largest | of |", "| --- | --- | --- | --- |"]
    for figure in (*LIMITS, *OTHERS):
        limit, unit = LIMITS.get(figure, (None, ""))
        shown = "" if limit is None else f"{limit:g} {unit}".strip()
        row = found.values.get(figure)
        if row is None:
            lines.append(f"| {figure} | {shown} | not measured | |")
            continue
        worst = max(row.items(), key=lambda entry: entry[1])[0]
        over = " **over**" if limit is not None and row[worst] > limit else ""
        lines.append(f"| {figure} | {shown} | {row[worst]:.3g} {unit}".rstrip() + f"{over} | {worst} |")
    lines += [f"not measured: {name.strip(': ')}: {reason}" for name, reason in found.missing.items()]
    return "\n".join(lines)


# DXF


def dxf_figures(path: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Audit, layers, texts and lengths as ezdxf finds them."""
    from ezdxf.filemanagement import readfile

    document = readfile(path)
    audit = document.audit()
    model = document.modelspace()
    texts = [text.dxf.text for text in model.query("TEXT")]
    unit = INCH if "Units: ENGLISH" in texts else 1.0
    blocks = [document.blocks[insert.dxf.name] for insert in model.query("INSERT")]
    lacking = sum(not any(text.startswith(key) for text in texts) for key in ("Style Name:", "Units:", "Sample Size:"))
    worst, points = 0.0, 0
    for block, edges in zip(blocks, lengths.values(), strict=False):
        drilled = {"13"} if block.query('POINT[layer=="13"]') else set()
        lacking += len({entity.dxf.layer for entity in block} ^ (LAYERS | drilled))
        about = [text.dxf.text for text in block.query("TEXT")]
        lacking += sum(not any(t.startswith(key) for t in about) for key in ("Piece Name:", "Size:", "Quantity:"))
        sewn: Any = block.query('POLYLINE[layer=="14"]')
        lines = [[v.dxf.location for v in line.vertices] for line in sewn]
        lacking += abs(len(lines) - len(edges))
        for line, wanted in zip(lines, edges.values(), strict=False):
            worst = max(worst, abs(unit * polyline_length(line) - wanted))
            points = max(points, len(line))
    return {
        "DXF: errors found by ezdxf's audit": len(audit.errors) + len(audit.fixes),
        "DXF: layers or texts missing": lacking,
        "DXF: edge lengths, ezdxf": worst,
        "points of an edge in DXF": points,
    }


def gdal_figures(path: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Lengths in the blocks as GDAL reads them."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "read.json"
        # every block by itself, in the layer `blocks`
        options = ["-f", "GeoJSON", "--config", "DXF_INLINE_BLOCKS", "FALSE", out, path, "blocks"]
        quietly(program("ogr2ogr", "gdal-bin"), *options)
        features = json.loads(out.read_text(encoding="utf-8"))["features"]
    shapes: dict[str, list[float]] = {}
    for feature in features:
        for part in (feature["geometry"] or {}).get("geometries", [feature["geometry"]]):
            if part and part["type"] == "LineString":
                length = polyline_length(part["coordinates"])
                shapes.setdefault(feature["properties"]["Block"], []).append(length)
    seen = [length for block in shapes.values() for length in block]
    return {"DXF: edge lengths, GDAL": farthest(lengths, seen, _unit(path))}


def trimesh_figures(path: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Lengths of the inserted pieces as trimesh's own reader of DXF finds them."""
    trimesh = module("trimesh")
    drawing: Any = trimesh.load(path)
    seen = [float(entity.length(drawing.vertices)) for entity in drawing.entities if hasattr(entity, "length")]
    return {"DXF: edge lengths, trimesh": farthest(lengths, seen, _unit(path))}


def _unit(path: Path) -> float:
    return INCH if "Units: ENGLISH" in path.read_text(encoding="ascii") else 1.0


def farthest(lengths: Mapping[str, Mapping[str, float]], seen: list[float], unit: float = 1.0) -> float:
    """How far an edge's length is at most from the nearest one that was found."""
    values = unit * np.array(seen) if seen else np.array([np.inf])
    return max(float(np.abs(values - wanted).min()) for edges in lengths.values() for wanted in edges.values())


# SVG and PDF


def svg_figures(path: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Lengths, notches and outlines as svgelements reads the paths."""
    elements = module("svgelements")
    root: Any = ET.parse(path).getroot()
    layer = {group.get(LABEL): group for group in root if group.get(LABEL)}
    worst, crossings, arcs, cut_arcs = 0.0, 0, 0, 0
    notches: dict[tuple[str, str], list[float]] = {}
    for edges, sewn, cut, marks in zip(lengths.values(), layer["sew"], layer["cut"], layer["notch"], strict=False):
        paths = {line.get(LABEL): elements.Path(line.get("d")) for line in sewn}
        worst = max(worst, *(abs(paths[name].length(error=1e-6) - wanted) for name, wanted in edges.items()))
        outline = np.vstack([path_points(line) for line in paths.values()])
        border = [path_points(elements.Path(line.get("d"))) for line in cut]
        crossings += sum(not Polygon(ring).is_valid for ring in (outline, *border))
        arcs = max(arcs, *(len(line) - 1 for line in paths.values()))
        cut_arcs = max(cut_arcs, *(len(elements.Path(line.get("d"))) - 2 for line in cut))
        lower = next(iter(paths))
        for mark in marks:
            edge = mark.get("data-edge")
            line = path_points(paths[edge], 4000)
            line = LineString(line if edge == lower else line[::-1])  # from the inner end
            ends = np.array(re.findall(r"L([-\d.]+),([-\d.]+)", mark.get("d")), float)
            place = float(np.mean([line.project(Point(*end)) for end in ends]))
            notches.setdefault((edge, f"{mark.get(LABEL)} {mark.get('data-distance-mm')}"), []).append(place)
    pairs = [max(places) - min(places) for places in notches.values() if len(places) > 1]
    return {
        "SVG: edge lengths, svgelements": worst,
        "notches: pairs at unequal distance": max(pairs, default=0.0),
        "outlines that cross themselves": crossings,
        "arcs of an edge": arcs,
        "arcs of a cut line": cut_arcs,
    }


def librsvg_figures(path: Path) -> dict[str, float]:
    """The control square as librsvg draws it."""
    command = [program("rsvg-convert", "librsvg2-bin"), "-d", "254", "-p", "254", "-b", "white", path]
    return {"SVG: control square off 1000 px, librsvg": square_error(dark(quietly(*command)))}


def pdf_figures(folder: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """The control squares, and the lengths on the large sheet, as poppler finds them."""
    figures = {}
    for name, file in (("tiles", "patterns.pdf"), ("sheet", "patterns_sheet.pdf")):
        command = [program("pdftoppm", "poppler-utils"), "-r", "254", "-gray", "-aa", "no", "-l", "1", folder / file]
        error = square_error(dark(quietly(*command)))
        figures[f"PDF: control square off 1000 px, {name}, poppler"] = error
    seen = [curve.length(error=1e-6) * POINT for curve in pdf_paths(folder / "patterns_sheet.pdf")]
    return {**figures, "PDF: edge lengths, poppler": farthest(lengths, seen)}


def pdf_paths(path: Path) -> Iterator[Any]:
    """The paths of a PDF's first page as svgelements reads what poppler made of them, in points."""
    elements = module("svgelements")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "read.svg"
        quietly(program("pdftocairo", "poppler-utils"), "-svg", "-noshrink", path, out)
        root = ET.parse(out).getroot()
    for element in root.iter(f"{SVG}path"):
        if "stroke" in (element.get("style") or element.get("stroke") or "stroke"):
            curve = elements.Path(element.get("d")) * elements.Matrix(element.get("transform", ""))
            yield abs(curve)  # with the transformation carried out


def dark(picture: bytes) -> np.ndarray:
    """Whether each pixel is dark."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None
    return np.asarray(Image.open(io.BytesIO(picture)).convert("L")) < 140


def square_error(shown: np.ndarray) -> float:
    """How far the control square's sides are from 1000 pixels, both ways; infinite where there is no such square."""
    return max(_lines_apart(shown), _lines_apart(shown.T))


def _lines_apart(shown: np.ndarray) -> float:
    """How far the distance of two level lines of about 1000 pixels is from 1000, at best."""
    rows = []
    for row in np.nonzero(shown.sum(1) >= 990)[0]:
        steps = np.diff(np.concatenate(([0], shown[row].astype(int), [0])))
        runs = np.nonzero(steps == -1)[0] - np.nonzero(steps == 1)[0]
        if ((runs >= 990) & (runs <= 1010)).any():
            rows.append(row)
    groups = np.split(np.array(rows), np.nonzero(np.diff(rows) > 1)[0] + 1) if rows else []
    middles = [float(group.mean()) for group in groups]
    return min((abs(b - a - 1000) for i, a in enumerate(middles) for b in middles[i + 1 :]), default=np.inf)


# The report


def report_figures(path: Path, browser: bool = True) -> dict[str, float]:
    """Size, and time until the cup is drawn in Chromium."""
    figures = {"report: size": path.stat().st_size / 1e6}
    if browser:
        with tempfile.TemporaryDirectory() as folder:
            page = with_title(path, "performance.now()", Path(folder))
            figures["report: shown after"] = float(shown_title(page, Path(folder))) / 1000
    return figures


def with_title(page: Path, script: str, folder: Path) -> Path:
    """A copy of a page whose title becomes what a script gives once all else is loaded and drawn."""
    tried = folder / "tried.html"
    text = page.read_text(encoding="utf-8")
    tried.write_text(text.replace("</body>", f"<script>document.title = String({script})</script></body>"))
    return tried


def shown_title(page: Path, profile: Path) -> str:
    """The title of a page as Chromium has it when the page is loaded."""
    shown = chromium("--dump-dom", "--virtual-time-budget=2000", page.as_uri(), profile=profile / "profile")
    title = re.search(r"<title>(.*?)</title>", shown, re.DOTALL)
    assert title is not None
    return title[1]


def chromium(*arguments: object, profile: Path) -> str:
    """What headless Chromium prints."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        raise MissingReaderError("the browser chromium is not installed")
    quiet = ["--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"]
    flags = ["--headless", "--no-sandbox", "--disable-gpu", *quiet, "--disable-sync", f"--user-data-dir={profile}"]
    command = [path, *flags, "--hide-scrollbars", "--window-size=1200,1000", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


if __name__ == "__main__":
    sys.exit(main())
