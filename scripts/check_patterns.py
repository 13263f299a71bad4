"""Measure the files of finished runs with readers that brafit does not write with: true size, lengths, shapes.

    python scripts/check_patterns.py RESULTS [RESULTS ...]

Of every scan in these folders the pattern files, the cup in 3D and the report are read back: DXF by ezdxf, GDAL and
trimesh, SVG by svgelements and librsvg, PDF by poppler, the panels flattened again by libigl, the report shown in
Chromium. What is not installed is said. Prints the largest value of each figure beside its limit; status 1 if one is
over it.
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
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import CubicSpline
from shapely import LineString, Point, Polygon

SVG = "{http://www.w3.org/2000/svg}"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
POINT = 25.4 / 72
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
    "report: size": (2.0, "MB"),
    "report: shown after": (2.0, "s"),
}
"""Figures in the order in which they are printed, and the most that each may be."""
OTHERS = (
    "pattern against cup: edges of triangles, mm",
    "pattern against cup: their strain",
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


class MissingReaderError(Exception):
    """A reader that is not installed."""


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


def path_points(path: Any, count: int = 60) -> np.ndarray:
    """Points of a path of lines and Bezier arcs, `count` an arc."""
    share = np.linspace(0, 1, count)[:, None]
    points = []
    for arc in path:
        known = [getattr(arc, key, None) for key in ("start", "control1", "control2", "end")]
        c = np.array([(p.x, p.y) for p in known if p is not None])
        if type(arc).__name__ == "CubicBezier":
            points.append((1 - share) ** 3 * c[0] + 3 * share * (1 - share) ** 2 * c[1]
                          + 3 * share**2 * (1 - share) * c[2] + share**3 * c[3])  # fmt: skip
        elif type(arc).__name__ in ("Line", "Close") and len(c) > 1:
            points.append(c)
    line = np.vstack(points)
    return line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-7)]


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


# The cup in 3D


@dataclass(frozen=True)
class PanelFile:
    """A panel of an OBJ file: places in space and in the flat pattern, triangles."""

    name: str
    vertices: np.ndarray
    flat: np.ndarray
    faces: np.ndarray

    @property
    def strips(self) -> int:
        """Rows of triangles from edge to edge: the first tip's fan."""
        return int((self.faces == 0).any(1).sum())

    def edge(self, values: np.ndarray, upper: bool) -> np.ndarray:
        """The lower or upper edge's values, from the inner end."""
        rows = values[1:-1].reshape(-1, self.strips + 1, values.shape[1])
        return np.vstack((values[:1], rows[:, -1 if upper else 0], values[-1:]))


def read_obj(path: Path) -> list[PanelFile]:
    """The objects of an OBJ file whose vertices have texture coordinates of the same number."""
    columns: dict[str, list[list[float]]] = {"v": [], "vt": []}
    objects: list[tuple[str, list[list[int]]]] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        word, *rest = line.split()
        if word in columns:
            columns[word].append([float(number) for number in rest])
        elif word == "o":
            objects.append((rest[0], []))
        elif word == "f":
            objects[-1][1].append([int(corner.split("/")[0]) - 1 for corner in rest])
    vertices, flat = np.array(columns["v"]), np.array(columns["vt"])
    panels = []
    for name, triangles in objects:
        faces = np.array(triangles)
        first, last = faces.min(), faces.max() + 1
        panels.append(PanelFile(name, vertices[first:last], flat[first:last], faces - first))
    return panels


def cup_figures(folder: Path, lengths: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """The cup's own edges, strains and angles, and the drawn curves against the flat edges."""
    panels = read_obj(folder / "cup.obj")
    lengths_off, apart, strain, defect = 0.0, 0.0, 0.0, 0.0
    for panel, edges in zip(panels, lengths.values(), strict=True):
        for wanted, upper in zip(edges.values(), (False, True), strict=True):
            lengths_off = max(lengths_off, abs(spline_length(panel.edge(panel.vertices, upper)) - wanted))
        sides = [edge_lengths(values, panel.faces) for values in (panel.flat, panel.vertices)]
        apart = max(apart, float(np.abs(sides[0] - sides[1]).max()))
        strain = max(strain, edge_strain(panel.flat, panel.vertices, panel.faces))
        defect = max(defect, angle_defect(panel.vertices, panel.faces))
    figures = {
        "edge lengths, cup in 3D": lengths_off,
        OTHERS[0]: apart,
        OTHERS[1]: strain,
        "angle defect of inner vertices": defect,
    }
    svg = folder / "patterns.svg"
    return {**figures, "curves off the fitted outline": outline_gap(svg, panels)} if svg.exists() else figures


def outline_gap(path: Path, panels: list[PanelFile]) -> float:
    """How far the flat edges' samples lie from the curves that are drawn, at most; for patterns without ease."""
    elements = module("svgelements")
    root: Any = ET.parse(path).getroot()
    (sew,) = (group for group in root if group.get(LABEL) == "sew")
    worst = 0.0
    for panel, lines in zip(panels, sew, strict=False):
        drawn = [path_points(elements.Path(line.get("d")), 400) * (1, -1) for line in lines]
        moved = drawn[0][0] - panel.edge(panel.flat, False)[0]
        for line, upper in zip(drawn, (False, True), strict=True):
            samples = shapely.points(panel.edge(panel.flat, upper) + moved)
            worst = max(worst, float(shapely.distance(samples, LineString(line)).max()))
    return worst


def libigl_figures(path: Path) -> dict[str, float]:
    """Each panel flattened again, laid onto the pattern and compared with the cup."""
    lscm, arap, strain = 0.0, 0.0, 0.0
    for panel in read_obj(path):
        lscm = max(lscm, misfit(flattened(panel, "lscm"), panel.flat))
        flat = flattened(panel, "arap")
        arap = max(arap, misfit(flat, panel.flat))
        strain = max(strain, edge_strain(flat, panel.vertices, panel.faces))
    return {
        "libigl: off the pattern, LSCM": lscm,
        "libigl: off the pattern, ARAP": arap,
        "libigl: edge strain, ARAP against the cup": strain,
    }


def flattened(mesh: Any, method: str) -> np.ndarray:
    """A mesh flattened by libigl: LSCM with two points held as far apart as the pattern has them; ARAP from there with
    one held.

    Args:
        mesh: has vertices (v, 3), flat (v, 2) and faces (f, 3).
        method: `lscm` or `arap`.
    """
    igl = module("igl", "libigl")
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
    vertices = np.ascontiguousarray(mesh.vertices)
    loop = igl.boundary_loop(faces)
    held = np.array([loop[0], loop[len(loop) // 2]], dtype=np.int64)
    flat, *_ = igl.lscm(vertices, faces, held, np.ascontiguousarray(mesh.flat[held]))
    if method == "lscm":
        return flat
    data = igl.ARAPData()
    data.energy = igl.ARAP_ENERGY_TYPE_DEFAULT
    data.max_iter = 50
    igl.arap_precomputation(vertices, faces, 2, held[:1], data)
    moved = np.ascontiguousarray(flat)
    return igl.arap_solve(np.ascontiguousarray(flat[held[:1]]), data, moved)


def misfit(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance after the best rigid motion of the plane, mirror images allowed."""
    a, b = a - a.mean(0), b - b.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    return float(np.linalg.norm(a @ u @ v - b, axis=1).max())


def edge_strain(flat: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> float:
    """By which share the triangles' edges differ in length at most."""
    return float(np.abs(edge_lengths(flat, faces) / edge_lengths(vertices, faces) - 1).max())


def edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3) of triangles."""
    corners = vertices[faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def angle_defect(vertices: np.ndarray, faces: np.ndarray) -> float:
    """How far the angles about an inner vertex are from a full turn at most, in radians."""
    corners = vertices[faces]
    a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    total = np.bincount(faces.ravel(), angles.ravel(), len(vertices))
    pairs = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    unique, count = np.unique(pairs, axis=0, return_counts=True)
    inner = np.setdiff1d(np.arange(len(vertices)), unique[count == 1])
    return float(np.abs(total[inner] - 2 * np.pi).max())


def polyline_length(points: Any) -> float:
    """Length of a polyline in the plane."""
    line = np.array([tuple(point)[:2] for point in points], float)
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def spline_length(points: np.ndarray) -> float:
    """Length of the cubic spline through points."""
    chords = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    spline, (nodes, weights) = CubicSpline(chords, points), np.polynomial.legendre.leggauss(6)
    spans = [(a, b - a) for a, b in pairwise(chords)]
    return sum(float(np.linalg.norm(spline(a + h * (nodes + 1) / 2, 1), axis=1) @ weights) * h / 2 for a, h in spans)


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


def program(name: str, package: str) -> str:
    """The path of a reader; the Debian package is named where there is none."""
    path = shutil.which(name)
    if path is None:
        raise MissingReaderError(f"the program {name} is not installed (Debian package {package})")
    return path


def module(name: str, package: str = "") -> Any:
    """A reader that is a Python package."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return __import__(name)
    except ImportError:
        raise MissingReaderError(f"the Python package {package or name} is not installed (extra `test`)") from None


def quietly(*command: object) -> bytes:
    """What a program writes to its output."""
    return subprocess.run([str(part) for part in command], check=True, capture_output=True).stdout


if __name__ == "__main__":
    sys.exit(main())
