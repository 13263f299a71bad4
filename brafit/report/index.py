"""The page over all scans of a run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from brafit.atomic import write_text
from brafit.report.html import MEANINGS, asset, figure, head, number, page, text

MAIN = frozenset(
    {
        "rms_mm", "p95_mm", "max_mm", "upper_edge_mm", "seam_to_apex_mm", "outline_sd_mm", "tightest_radius_mm",
        "wire_length_mm", "twist_deg_max", "seam_mismatch_mm",
    }
)  # fmt: skip
"""Figures that the page shows at first, as many as a window has room for; a tick shows the others too."""


def write_index(
    path: str | Path,
    rows: Sequence[Mapping[str, Any]],
    warnings: Sequence[Sequence[str]],
    folders: Sequence[str] | None = None,
) -> None:
    """Write the page over a run: a line a scan with its picture and warnings, sortable by any figure.

    Args:
        path: the page, in the run's folder.
        rows: of summary.csv.
        warnings: of each scan, of its fit and its pieces.
        folders: where each scan's files are, seen from this page; None: in a folder of its name.
    """
    keys = [key for key in MEANINGS if any(row.get(key) is not None for row in rows)]
    heads = ["cup", "scan", "status", "warnings", "side", "panels", "nearest wire", *map(head, keys)]
    about = ["", "", "", "of the fit and of the pieces; open them to read", "", "", "that is sold"]
    titles = [*about, *(", ".join(filter(None, MEANINGS[key])) for key in keys)]
    classes = [*("" for _ in about), *map(_class, keys)]
    shown = "".join(
        f'<th class="{kind}" title="{text(title)}">{text(words)}</th>'
        for kind, words, title in zip(classes, heads, titles, strict=True)
    )
    places = [str(row["scan"]) for row in rows] if folders is None else folders
    told = zip(rows, warnings, places, strict=True)
    lines = "\n".join(_index_line(row, own, keys, quote(os.fsencode(place))) for row, own, place in told)
    good, warned = sum(row.get("status") == "ok" for row in rows), sum(bool(told) for told in warnings)
    failed = f", {len(rows) - good} failed" if good < len(rows) else ""
    body = (
        f"<h1>bra cups</h1><p>{good} of {len(rows)} scans ok, {warned} with warnings{failed}. "
        "Lengths in mm, angles in degrees. Click a heading to sort, a scan for its report.</p>"
        '<input type="checkbox" id="every"> <label for="every">all figures</label>'
        f'<div class="scroll"><table class="sortable"><thead><tr>{shown}</tr></thead>'
        f"<tbody>\n{lines}\n</tbody></table></div>{_meanings(keys)}"
        f"<script>{asset('table.js')}</script>"
    )
    write_text(path, page("bra cups", body, wide=True))


def _meanings(keys: Sequence[str]) -> str:
    """What the columns say, for screens that show no tooltips."""
    told = "".join(
        f'<dt class="{_class(key)}">{text(head(key))}</dt>'
        f'<dd class="{_class(key)}">{text(", ".join(filter(None, MEANINGS[key])))}</dd>'
        for key in keys
    )
    return f'<dl class="meanings">{told}</dl>' if told else ""


def _class(key: str) -> str:
    """Of a figure's cells."""
    return "number" if key in MAIN else "number more"


def _index_line(row: Mapping[str, Any], told: Sequence[str], keys: Sequence[str], folder: str) -> str:
    name, good = str(row["scan"]), row.get("status") == "ok"
    image = f'<img src="{folder}/thumbnail.png" loading="lazy" alt="">'
    picture = f'<a href="{folder}/report.html">{image}</a>' if good else ""
    title = f'<a href="{folder}/report.html">{text(name)}</a>' if good else text(name)
    state = (
        "ok" if good else f'<span class="failed">failed</span> <div class="soft reason">{text(row.get("reason"))}</div>'
    )
    words = "".join(f"<li>{text(line)}</li>" for line in told)
    warned = f'<details><summary class="failed">{len(told)}</summary><ul>{words}</ul></details>' if told else "0"
    cells = [
        f'<td data-value="{text(name)}">{picture}</td>',
        f"<td>{title}</td>",
        f'<td data-value="{"ok" if good else "failed"}">{state}</td>',
        f'<td data-value="{len(told) if good else ""}">{warned if good else ""}</td>',
        *(f"<td>{text(row.get(key) or '')}</td>" for key in ("side", "panels", "nearest_wire")),
    ]
    for key in keys:
        value = number(row.get(key))
        shown = "" if value is None else text(figure(key, value))
        cells.append(f'<td class="{_class(key)}" data-value="{"" if value is None else repr(value)}">{shown}</td>')
    return f"<tr>{''.join(cells)}</tr>"
