"""Web pages of the results that need no server and no network: one of a scan, and one over all scans of a run."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import KDTree

from brafit import __version__
from brafit.atomic import write_text
from brafit.cup.shape import CupShape
from brafit.pattern.finish import Pattern
from brafit.pattern.piece import Piece, Side
from brafit.report.band import Deviation, band_svg, magnification
from brafit.report.colour import DIVERGING, PANELS, distance_colours, distance_limit
from brafit.report.dimensions import Dimension
from brafit.report.paper import PaperPanel

DOTS = 6000
"""Points of a cloud that the 3D view shows at most."""
_STRIPS, _FOLDS = 6, 9

MEANINGS: dict[str, tuple[str, str]] = {
    "points": ("points of the fit", ""),
    "rms_mm": ("distance of the points from the cup: root mean square", "mm"),
    "mean_mm": ("mean", "mm"),
    "p95_mm": ("95th percentile", "mm"),
    "max_mm": ("largest", "mm"),
    "upper_edge_mm": ("upper edge and neckline apart", "mm"),
    "neckline_smoothing_mm": ("given neckline off the smooth one that the cup follows, at most", "mm"),
    "outline_sd_mm": ("standard deviation of the sewing lines' place if the breast were scanned again, at most", "mm"),
    "tightest_radius_mm": ("tightest bend of a flat edge (radius), the strap's corner apart", "mm"),
    "wire_length_mm": ("length of the wire line", "mm"),
    "wire_smoothing_mm": ("given wire points off the smooth wire line, at most", "mm"),
    "wire_drift_mm": ("wire edge of the cup off the smooth wire line, at most", "mm"),
    "twist_deg_max": ("twist along a ruling, at most (0: truly developable)", "degrees"),
    "regularity_min": ("smallest regularity margin (above 0: rulings do not cross)", ""),
    "isometry_mm": ("lengths in the cup and in the flat pattern differ by, at most", "mm"),
    "seam_mismatch_mm": ("the two sides of a seam differ in length by, at most", "mm"),
    "iterations": ("evaluations of the objective", ""),
    "seconds": ("time of the fit", "s"),
}
"""Figures of a fit that the pages show: what they mean, and their unit."""


def write_report(
    path: str | Path,
    *,
    row: Mapping[str, Any],
    side: Side,
    shape: CupShape,
    papers: Sequence[PaperPanel],
    gap: float,
    points: Float[ndarray, "n 3"],
    distances: Float[ndarray, " n"],
    pattern: Pattern,
    drawing: bytes,
    dimensions: Sequence[Dimension],
    sources: Mapping[str, str],
    files: Sequence[str],
    band: tuple[Sequence[Piece], Deviation] | None = None,
    warnings: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> None:
    """Write one scan's page: the cup in 3D, its pieces, finished dimensions, fit figures, warnings, given and guessed.

    Args:
        row: the scan's row of summary.csv.
        side: right cups, which are fitted as left ones, are shown as they are worn.
        shape: the cup, cup frame, mm.
        papers, gap: from `paper_panels` and `paper_gap`, for the view of the folding paper cup.
        points, distances: of the fit, cup frame, mm; positive outside the cup.
        drawing: the pattern as SVG.
        sources: for each input what was given, or what was taken in its place.
        files: other results in the same folder, to link to.
        band: sewing lines of the pieces and how uncertain each of their edges is, where that is known.
        warnings: of the fit; those of the pattern are shown with them.
        notes: what was found out about the scan, such as its unit.
    """
    name = str(row.get("scan", pattern.name))
    limit = distance_limit(distances)
    about = [str(row[key]) for key in ("side", "cup", "solver") if row.get(key)]
    about += [f"{len(papers)} panel{'s' * (len(papers) > 1)}"]
    data = _data(side, shape, papers, points, distances, limit)
    body = [
        f"<h1>{_text(name)}</h1>",
        f'<p class="soft">{_text(", ".join(about))}; {_text(row.get("reason") or "")}</p>',
        _facts(row, dimensions),
        _warnings([*warnings, *pattern.warnings]),
        "<h2>Cup and cloud</h2>",
        _stage(limit, gap),
        "<h2>Pieces</h2>",
        _picture(drawing),
        "" if band is None else _certainty(*band),
        '<div class="columns"><section><h2>Finished dimensions</h2>',
        _dimension_table(dimensions, pattern),
        "</section><section><h2>Fit</h2>",
        _figure_table(row),
        "<h2>Given and guessed</h2>",
        _pairs_table(sources),
        "".join(f"<p>{_text(note)}</p>" for note in notes),
        "<h2>Files</h2><p>" + ", ".join(f'<a href="{_link(file)}">{_text(file)}</a>' for file in files) + "</p>",
        "</section></div>",
        f'<script type="application/json" id="cup-data">{data}</script>',
        f"<script>{_asset('viewer.js')}</script>",
    ]
    write_text(path, _page(f"{name}: bra cup", "\n".join(body)))


def write_index(
    path: str | Path, rows: Sequence[Mapping[str, Any]], thumbnail: str = "thumbnail.png", report: str = "report.html"
) -> None:
    """Write the page over a run: a line a scan with its picture and warnings, sortable by any figure.

    Args:
        rows: of summary.csv.
        thumbnail, report: names of the files in each scan's folder beside this page; the warnings are in its fit.json.
    """
    keys = [key for key in MEANINGS if any(row.get(key) is not None for row in rows)]
    heads = ["cup", "scan", "status", "warnings", "side", *(key.removesuffix("_mm") for key in keys)]
    about = ["", "", "", "of the fit and of the pieces; open them to read", ""]
    titles = [*about, *(f"{MEANINGS[key][0]} {MEANINGS[key][1]}".strip() for key in keys)]
    plain = len(about)
    head = "".join(
        f'<th class="{"number" if i >= plain else ""}" title="{_text(title)}">{_text(words.replace("_", " "))}</th>'
        for i, (words, title) in enumerate(zip(heads, titles, strict=True))
    )
    warnings = [_told(Path(path).parent / str(row["scan"])) for row in rows]
    lines = "\n".join(_index_line(row, told, keys, thumbnail, report) for row, told in zip(rows, warnings, strict=True))
    good, warned = sum(row.get("status") == "ok" for row in rows), sum(bool(told) for told in warnings)
    body = (
        f"<h1>bra cups</h1><p>{good} of {len(rows)} scans ok, {warned} with warnings. "
        "Lengths in mm, angles in degrees. Click a heading to sort, a scan for its report.</p>"
        f'<div class="scroll"><table class="sortable"><thead><tr>{head}</tr></thead>'
        f"<tbody>\n{lines}\n</tbody></table></div>"
        f"<script>{_asset('table.js')}</script>"
    )
    write_text(path, _page("bra cups", body, wide=True))


def _told(folder: Path) -> list[str]:
    """The warnings in a scan's fit.json, of the fit and of the pattern."""
    file = folder / "fit.json"
    if not file.is_file():
        return []
    content = json.loads(file.read_text(encoding="utf-8"))
    return [*content.get("warnings", []), *content.get("pattern", {}).get("warnings", [])]


def _index_line(row: Mapping[str, Any], told: Sequence[str], keys: Sequence[str], thumbnail: str, report: str) -> str:
    name, good = str(row["scan"]), row.get("status") == "ok"
    folder = quote(name, safe="")
    picture = f'<a href="{folder}/{report}"><img src="{folder}/{thumbnail}" loading="lazy" alt=""></a>' if good else ""
    title = f'<a href="{folder}/{report}">{_text(name)}</a>' if good else _text(name)
    state = "ok" if good else f'<span class="failed">failed</span> <span class="soft">{_text(row.get("reason"))}</span>'
    words = "".join(f"<li>{_text(line)}</li>" for line in told)
    warned = f'<details><summary class="failed">{len(told)}</summary><ul>{words}</ul></details>' if told else "0"
    cells = [
        f'<td data-value="{_text(name)}">{picture}</td>',
        f"<td>{title}</td>",
        f'<td data-value="{"ok" if good else "failed"}">{state}</td>',
        f'<td data-value="{len(told) if good else ""}">{warned if good else ""}</td>',
        f"<td>{_text(row.get('side') or '')}</td>",
    ]
    for key in keys:
        value = _number(row.get(key))
        shown = "" if value is None else _text(_short(value))
        cells.append(f'<td class="number" data-value="{"" if value is None else repr(value)}">{shown}</td>')
    return f"<tr>{''.join(cells)}</tr>"


def _facts(row: Mapping[str, Any], dimensions: Sequence[Dimension]) -> str:
    depth = next((d.value for d in dimensions if d.name.startswith("depth")), None)
    facts = [
        ("RMS distance", row.get("rms_mm"), "mm"),
        ("95 % of the points within", row.get("p95_mm"), "mm"),
        ("wire", row.get("wire_length_mm"), "mm"),
        ("depth", depth, "mm"),
        ("twist at most", row.get("twist_deg_max"), "degrees"),
        ("seam sides differ by", row.get("seam_mismatch_mm"), "mm"),
    ]
    shown = [(name, _number(value), unit) for name, value, unit in facts]
    cells = [
        f"<div><b>{_text(_short(v))} {unit}</b><span>{name}</span></div>" for name, v, unit in shown if v is not None
    ]
    return f'<div class="facts">{"".join(cells)}</div>'


def _warnings(warnings: Sequence[str]) -> str:
    if not warnings:
        return '<p class="fine">All checks of fit and pieces passed.</p>'
    lines = "".join(f"<li>{_text(words)}</li>" for words in warnings)
    return f'<div class="warnings"><b>Warnings</b><ul>{lines}</ul></div>'


def _stage(limit: float, gap: float) -> str:
    colours = ", ".join(f"rgb({r},{g},{b})" for r, g, b in DIVERGING.tolist())
    views = "".join(f'<button data-view="{v}">{v}</button>' for v in ("oblique", "front", "side", "below"))
    boxes = (("show-cup", "cup", 1), ("show-cloud", "cloud", 1), ("show-rulings", "rulings", 0),
             ("tint-cup", "cup in the colours of the nearest points", 0))  # fmt: skip
    checks = "".join(
        f'<label><input type="checkbox" id="{i}"{" checked" * on}> {words}</label>' for i, words, on in boxes
    )
    return (
        '<div class="stage"><canvas id="view" tabindex="0" '
        'aria-label="cup and cloud in 3D: drag or use the arrow keys to turn, the wheel to zoom"></canvas>'
        f'<div class="controls">{views}{checks}'
        '<label>paper cup: flat <input type="range" id="fold" min="0" max="100" value="100"> folded '
        '(<span id="fold-share">cup</span>)</label></div>'
        f'<div class="scale"><div style="background:linear-gradient(to right, {colours})"></div>'
        f"<span>{-limit:g} mm (inside the cup)</span><span>0</span><span>{limit:g} mm (outside)</span></div></div>"
        '<p class="soft">Drag to turn, wheel to zoom. Points are coloured by their distance from the cup. '
        f"Folded from flat facets, the paper cup comes to within {_text(_short(gap))} mm of the cup.</p>"
    )


def _picture(drawing: bytes) -> str:
    data = base64.b64encode(drawing).decode()
    return f'<img class="pieces" alt="pattern pieces" src="data:image/svg+xml;base64,{data}">'


def _certainty(pieces: Sequence[Piece], deviation: Deviation) -> str:
    largest = max(float(edge.max()) for pair in deviation for edge in pair)
    return (
        "<details open><summary>How certain the outlines are</summary>"
        "<p>How far another scan of this breast would move the sewing lines: the band is one standard deviation to "
        f"either side, at most {largest:.2f} mm, drawn {magnification(deviation)} times wider. "
        "Wire, neckline and marks are taken as exact.</p>"
        f"{band_svg(pieces, deviation)}</details>"
    )


def _dimension_table(dimensions: Sequence[Dimension], pattern: Pattern) -> str:
    lines, part = [], ""
    for d in dimensions:
        first = d.part if d.part != part else ""
        part = d.part
        value = pattern.options.length(d.value) if d.unit == "mm" else f"{d.value:.1f} cm²"
        doubt = "" if d.sd is None else _doubt(d, pattern)
        cells = f'<td>{_text(d.name)}</td><td class="number">{value}</td><td class="number soft">{doubt}</td>'
        lines.append(f"<tr><th>{_text(first)}</th>{cells}</tr>")
    known = any(d.sd is not None for d in dimensions)
    words = "±: one standard deviation, if the breast were scanned again; wire, neckline and marks are taken as exact."
    note = f'<p class="soft">{words}</p>' if known else ""
    return f"<table>{''.join(lines)}</table>{note}"


def _doubt(d: Dimension, pattern: Pattern) -> str:
    """Standard deviation of a dimension, with a digit more than its value."""
    sd = d.sd or 0.0
    if d.unit != "mm":
        return f"± {sd:.2f} cm²"
    return f"± {sd / 25.4:.3f}" if pattern.options.units == "inch" else f"± {sd:.2f}"


def _pairs_table(pairs: Mapping[str, str]) -> str:
    lines = "".join(f"<tr><th>{_text(key)}</th><td>{_text(value)}</td></tr>" for key, value in pairs.items())
    return f"<table>{lines}</table>"


def _figure_table(row: Mapping[str, Any]) -> str:
    lines = []
    for key, (meaning, unit) in MEANINGS.items():
        value = _number(row.get(key))
        if value is not None:
            lines.append(f'<tr><td>{meaning}</td><td class="number">{_text(_short(value))}</td><td>{unit}</td></tr>')
    return f"<table>{''.join(lines)}</table>"


def _data(
    side: Side,
    shape: CupShape,
    papers: Sequence[PaperPanel],
    points: Float[ndarray, "n 3"],
    distances: Float[ndarray, " n"],
    limit: float,
) -> str:
    """What the viewer draws, as JSON: the viewer looks along -z with y up."""
    outward = -1.0 if side == "right" else 1.0
    upright = np.array(((0.0, outward, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    edges = shape.edges.detach().cpu().double().numpy()
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), DOTS)).astype(int))
    tree = KDTree(points)
    panels = []
    for i, paper in enumerate(papers):
        folds = [*paper.folds(np.linspace(0, 1, _FOLDS)[:-1]), edges[i : i + 2]]
        share = (np.arange(_STRIPS) + 0.5)[:, None] / _STRIPS
        lower, upper = ((edge[:-1] + edge[1:])[:, None] / 2 for edge in edges[i : i + 2])
        nearest = distances[tree.query(((1 - share) * lower + share * upper).reshape(-1, 3))[1]]
        panels.append(
            {
                "colour": PANELS[i % len(PANELS)].tolist(),
                "stations": edges.shape[1],
                "folds": [_packed((fold.reshape(-1, 3) @ upright.T).astype("<f4")) for fold in folds],
                "tints": _packed(distance_colours(nearest, limit)),
            }
        )
    everything = np.vstack((edges.reshape(-1, 3), points)) @ upright.T
    low, high = everything.min(0), everything.max(0)
    size = float(np.linalg.norm(high - low))
    data = {
        "points": _packed((points[chosen] @ upright.T).astype("<f4")),
        "colours": _packed(distance_colours(distances[chosen], limit)),
        "panels": panels,
        "strips": _STRIPS,
        "centre": ((low + high) / 2).tolist(),
        "size": size,
        "radius": size * float(np.clip(0.13 / math.sqrt(max(len(chosen), 1)), 0.0015, 0.006)),
        "lift": limit + 0.015 * size,
        "outward": outward,
    }
    return json.dumps(data, separators=(",", ":"))


def _page(title: str, body: str, wide: bool = False) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="brafit {__version__}">\n<title>{_text(title)}</title>\n'
        f"<style>\n{_asset('page.css')}</style>\n</head>\n<body{' class=wide' * wide}>\n{body}\n</body>\n</html>\n"
    )


@cache
def _asset(name: str) -> str:
    return resources.files("brafit.report").joinpath(name).read_text(encoding="utf-8")


def _packed(values: ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _number(value: Any) -> float | None:
    """A finite number, or None."""
    if value is None or isinstance(value, str) or not math.isfinite(float(value)):
        return None
    return float(value)


def _short(value: float) -> str:
    """Four digits at most, and no powers of ten for what is as good as nothing."""
    return "< 0.001" if 0 < abs(value) < 0.001 else f"{value:.4g}"


def _text(words: Any) -> str:
    return escape(str("" if words is None else words))


def _link(file: str) -> str:
    return escape(quote(file))
