"""The web page of one scan's result, which needs no server and no network; `index` is the page over all scans."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import KDTree

from brafit.atomic import write_text
from brafit.cup.shape import CupShape
from brafit.fitting.result import EdgeDeviations
from brafit.pattern.finish import Pattern
from brafit.pattern.piece import Piece, Side
from brafit.report.band import band_svg, magnification
from brafit.report.colour import DIVERGING, PANELS, STEPS, distance_colours
from brafit.report.dimensions import DEPTH, Dimension, measured_on
from brafit.report.html import MEANINGS, asset, figure, fixed, link, number, page, text, warned
from brafit.report.paper import PaperPanel

DOTS = 6000
"""Points of a cloud that the 3D view shows at most."""
EXACT = "Wire, neckline, marks, and the surface that is assumed where the scan has no points, are taken as exact"
"""What the standard deviations do not know of."""
_CALLED = {"apex": "bust point"}
"""What inputs are called whose key says it otherwise."""
_STRIPS, _FOLDS = 6, 9


@dataclass(frozen=True, eq=False)
class ScanPage:
    """What one scan's page shows: the cup in 3D, its pieces, finished dimensions, fit figures, warnings, given and
    guessed.

    Attributes:
        row: the scan's row of summary.csv.
        side: right cups, which are fitted as left ones, are shown as they are worn.
        shape: the cup, cup frame, mm.
        papers, gap: from `paper_panels` and `paper_gap` (mm), for the view of the folding paper cup.
        points, distances: of the fit, cup frame, mm; positive outside the cup.
        pattern: the finished pieces.
        drawing: the pattern as SVG.
        dimensions: finished dimensions, for their table.
        sources: for each input what was given, or what was taken in its place.
        files: other results in the same folder, to link to.
        band: sewing lines of the pieces and how uncertain each of their edges is, where that is known.
        warnings: of the fit and the pattern, in words.
        notes: what was found out about the scan, such as its unit.
    """

    row: Mapping[str, Any]
    side: Side
    shape: CupShape
    papers: Sequence[PaperPanel]
    gap: float
    points: Float[ndarray, "seen 3"]
    distances: Float[ndarray, " seen"]
    pattern: Pattern
    drawing: bytes
    dimensions: Sequence[Dimension]
    sources: Mapping[str, str]
    files: Sequence[str]
    band: tuple[Sequence[Piece], Sequence[EdgeDeviations]] | None = None
    warnings: Sequence[str] = ()
    notes: Sequence[str] = ()

    @property
    def name(self) -> str:
        """Of the scan."""
        return str(self.row.get("scan", self.pattern.name))

    @property
    def about(self) -> str:
        """Side, model, solver and panels, and how the fit ended."""
        words = [str(self.row[key]) for key in ("side", "cup", "solver") if self.row.get(key)]
        words += [f"{len(self.papers)} panel{'s' * (len(self.papers) > 1)}"]
        return f"{text(', '.join(words))}; {text(self.row.get('reason') or '')}"


def write_report(path: str | Path, content: ScanPage) -> None:
    """Write one scan's page.

    Args:
        path: the page; missing folders are made, and it is never there in part.
        content: what it shows.
    """
    one = content
    data = _data(one.side, one.shape, one.papers, one.points, one.distances)
    body = [
        f"<h1>{text(one.name)}</h1>",
        f'<p class="soft">{one.about}</p>',
        _facts(one.row, one.dimensions, one.pattern),
        _warnings(one.warnings),
        "<h2>Cup and cloud</h2>",
        _stage(one.gap),
        "<h2>Pieces</h2>",
        _picture(one.drawing),
        "" if one.band is None else _certainty(*one.band),
        '<div class="columns"><section><h2>Finished dimensions</h2>',
        _dimension_table(one.dimensions, one.pattern),
        _nearest_wire(one.row, one.pattern),
        "</section><section><h2>Fit</h2>",
        _figure_table(one.row, one.pattern),
        "<h2>Given and guessed</h2>",
        _pairs_table(one.sources),
        "".join(f"<p>{text(note)}</p>" for note in one.notes),
        "<h2>Files</h2><p>" + ", ".join(f'<a href="{link(file)}">{text(file)}</a>' for file in one.files) + "</p>",
        "</section></div>",
        f'<script type="application/json" id="cup-data">{data}</script>',
        f"<script>{asset('viewer.js')}</script>",
    ]
    write_text(path, page(f"{one.name}: bra cup", "\n".join(body)))


def _facts(row: Mapping[str, Any], dimensions: Sequence[Dimension], pattern: Pattern) -> str:
    def told(key: str, unit: str, places: int) -> str | None:
        value = number(row.get(key))
        return None if value is None else f"{fixed(value, places)} {unit}"

    wire, depth = number(row.get("wire_length_mm")), next((d.value for d in dimensions if d.name == DEPTH), None)
    seams = {"seam sides differ by": told("seam_mismatch_mm", "mm", 2)}
    if pattern.reshaped:
        seams = {"seam sides differ by, as cut": f"{fixed(pattern.seam_difference, 2)} mm"}
    facts = {
        "RMS distance": told("rms_mm", "mm", 2),
        "95 % of the points within": told("p95_mm", "mm", 2),
        "seam to bust point": told("seam_to_apex_mm", "mm", 1),
        "wire": None if wire is None else pattern.options.length(wire, 1),
        "depth of the cup": None if depth is None else pattern.options.length(depth, 1),
        "twist at most": told("twist_deg_max", "degrees", 2),
        **seams,
    }
    cells = [
        f"<div><b>{text(value)}</b><span>{name}</span></div>" for name, value in facts.items() if value is not None
    ]
    return f'<div class="facts">{"".join(cells)}</div>'


def _warnings(warnings: Sequence[str]) -> str:
    return warned(warnings) or '<p class="fine">All checks of fit and pieces passed.</p>'


def _stage(gap: float) -> str:
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
        f"{_scale()}</div>"
        '<p class="soft">Drag to turn, wheel to zoom. Points are coloured by their distance from the cup, in the same '
        f"steps for every scan: grey within {STEPS[0]:g} mm, blue inside, red outside. Folded from flat facets, the "
        f"paper cup stays within {max(math.ceil(100 * gap), 1) / 100:.2f} mm of the cup.</p>"
    )


def _scale() -> str:
    """The colours, with the distances at which they change below."""
    bounds = [*-STEPS[::-1], *STEPS]
    boxes = "".join(f'<div style="background:rgb({r},{g},{b})"></div>' for r, g, b in DIVERGING.tolist())
    words = "".join(f"<span>{bound:+g}</span>" for bound in bounds).replace("-", "−")
    return (
        f'<div class="scale"><p><span>inside the cup</span><span>mm</span><span>outside</span></p>'
        f'<div class="steps">{boxes}</div><div class="bounds">{words}</div></div>'
    )


def _picture(drawing: bytes) -> str:
    data = base64.b64encode(drawing).decode()
    return f'<img class="pieces" alt="pattern pieces" src="data:image/svg+xml;base64,{data}">'


def _certainty(pieces: Sequence[Piece], deviation: Sequence[EdgeDeviations]) -> str:
    largest = max(float(edge.max()) for pair in deviation for edge in pair)
    return (
        "<details open><summary>How certain the outlines are</summary><figure>"
        f"{band_svg(pieces, deviation)}<figcaption>Black: the sewing lines. Orange: how far those of another scan of "
        f"this breast would lie beside them, one standard deviation to either side: {largest:.2f} mm where the band is "
        f"widest. It is drawn {magnification(deviation)} times wider than it is. {EXACT}."
        "</figcaption></figure></details>"
    )


def _dimension_table(dimensions: Sequence[Dimension], pattern: Pattern) -> str:
    lines, part = [], ""
    for d in dimensions:
        first = _named_part(d.part, pattern) if d.part != part else ""
        part = d.part
        own = measured_on(d.part, d.name)
        cut = f", {own}" * (pattern.reshaped and own != measured_on(d.part, ""))
        value = (pattern.options.length if d.unit == "mm" else pattern.options.area)(d.value)
        doubt = "" if d.sd is None else text(_doubt(d, pattern))
        cells = f'<td>{text(d.name)}{cut}</td><td class="number">{value}</td><td class="number soft">{doubt}</td>'
        lines.append(f"<tr><th>{text(first)}</th>{cells}</tr>")
    known = any(d.sd is not None for d in dimensions)
    words = f"±: one standard deviation, if the breast were scanned again. {EXACT}."
    note = f'<p class="soft">{words}</p>' if known else ""
    return f"<table>{''.join(lines)}</table>{note}"


def _named_part(part: str, pattern: Pattern) -> str:
    """A part's name and, where ease or stretch makes the two differ, whether its measures are as cut or as worn."""
    if not pattern.reshaped:
        return part
    return f"{part} ({measured_on(part, '')})"


def _nearest_wire(row: Mapping[str, Any], pattern: Pattern) -> str:
    """The wire to buy, and how it differs from the wire line."""
    name = row.get("nearest_wire")
    longer, wider = (number(row.get(f"nearest_wire_{key}_diff_mm")) for key in ("length", "span"))
    if name is None or longer is None or wider is None:
        return ""
    length, span, none = (pattern.options.length(abs(value)) for value in (longer, wider, 0.0))
    more = "as long as" if length == none else f"{length} {'longer' if longer > 0 else 'shorter'} than"
    broad = "as wide" if span == none else f"{span} {'wider' if wider > 0 else 'narrower'}"
    return f"<p>Nearest wire sold: <b>{text(name)}</b>, {more} {_wanted(pattern)} and {broad} from end to end.</p>"


def _wanted(pattern: Pattern) -> str:
    """What a wire is compared with."""
    play, spring = pattern.options.wire["play"], pattern.options.wire["spring"]
    if not (play or spring):
        return "the wire line"
    about = [f"play of {pattern.options.length_set(play)} at each end"] * bool(play)
    about += [f"opened by {pattern.options.length_set(spring)} when worn"] * bool(spring)
    return f"the wire wanted ({', '.join(about)})"


def _doubt(d: Dimension, pattern: Pattern) -> str:
    """Standard deviation of a dimension, with a digit more than its value, whose unit it has."""
    told = pattern.options.length if d.unit == "mm" else pattern.options.area
    shown, least = told(d.sd or 0.0, 2).split()[0], told(0.0, 2).split()[0]
    return f"± < {least[:-1]}1" if d.sd and shown == least else f"± {shown}"


def _pairs_table(pairs: Mapping[str, str]) -> str:
    named = ((_CALLED.get(key, key), value) for key, value in pairs.items())
    return f"<table>{''.join(f'<tr><th>{text(key)}</th><td>{text(value)}</td></tr>' for key, value in named)}</table>"


def _figure_table(row: Mapping[str, Any], pattern: Pattern) -> str:
    lines = []
    for key, (meaning, unit) in MEANINGS.items():
        value = number(row.get(key))
        if value is not None:
            lines.append(
                f'<tr><td>{meaning}</td><td class="number">{text(figure(key, value))}</td><td>{unit}</td></tr>'
            )
    if pattern.reshaped:
        meaning = "as the pieces are cut, the two sides of a seam differ in length by, at most"
        value = text(fixed(pattern.seam_difference))
        lines.append(f'<tr><td>{meaning}</td><td class="number">{value}</td><td>mm</td></tr>')
    words = "Fit, checks and warnings are in mm, as scans and settings are; pieces and dimensions in inches."
    note = f'<p class="soft">{words}</p>' if pattern.options.units == "inch" else ""
    return f"<table>{''.join(lines)}</table>{note}"


def _data(
    side: Side,
    shape: CupShape,
    papers: Sequence[PaperPanel],
    points: Float[ndarray, "seen 3"],
    distances: Float[ndarray, " seen"],
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
                "tints": _packed(distance_colours(nearest)),
            }
        )
    everything = np.vstack((edges.reshape(-1, 3), points)) @ upright.T
    low, high = everything.min(0), everything.max(0)
    size = float(np.linalg.norm(high - low))
    data = {
        "points": _packed((points[chosen] @ upright.T).astype("<f4")),
        "colours": _packed(distance_colours(distances[chosen])),
        "panels": panels,
        "strips": _STRIPS,
        "centre": ((low + high) / 2).tolist(),
        "size": size,
        "radius": size * float(np.clip(0.13 / math.sqrt(max(len(chosen), 1)), 0.0015, 0.006)),
        "lift": float(STEPS[-1]) + 0.015 * size,
        "outward": outward,
    }
    return json.dumps(data, separators=(",", ":"))


def _packed(values: ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
