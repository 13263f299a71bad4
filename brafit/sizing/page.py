"""What is written of sizes: tables, and a page over all of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from brafit.atomic import write_text
from brafit.report.html import asset, fixed, link, page, text, warned
from brafit.report.table import write_table
from brafit.sizing.rows import FAR_WORDS
from brafit.sizing.service import NEAR, Choice, Sizes, Step

Row = Mapping[str, Any]
METHOD = (
    "Cups are compared at the same shares of the wire's length and of the way to the upper edge, after the rigid "
    "motion (any turn and shift, no mirroring; right cups as their mirror images) that brings them together best. "
    "error: root mean square distance of these points, mm; how far they are apart along the surface counts as well. "
    "gap: how far the wearer's own cup is from the nearest points of her size. The wearers whose cups the sizes are "
    "count too, with an error of 0: among few cups they are most of those that are close."
)
_SETS = {"best": "best sizes", "wire_groups": "groups by wire length", "by_wire": "the best sizes, worn by wire length"}
HEADINGS = {
    "scan": "whose cup",
    "members": "wearers",
    "mean_mm": "error, mean, mm",
    "p95_mm": "95 % are below, mm",
    "within_3mm_percent": f"within {NEAR:g} mm, %",
    "gap_mm": "gap, mm",
    "surface_within_3mm_percent": f"of the surface within {NEAR:g} mm, %",
    "wire_mm": "wire line, mm",
    "span_mm": "span, mm",
    "depth_mm": "depth of the cup, mm",
    "members_wire_mm": "wearers' wire lines, mm",
    "members_far_wire": f"wearers with {FAR_WORDS} more or less of wire",
}
"""Columns of the tables, in words; others are their names."""
UNITS = {"cm2": "cm²", "in2": "in²"}
"""Units as people read them, where tables and fit.json spell them otherwise."""


def heading(key: str) -> str:
    """A column's name in words."""
    for name, words in _SETS.items():
        if key.startswith(f"{name}_"):
            return f"{words}: {heading(key.removeprefix(f'{name}_'))}"
    return HEADINGS.get(key, key.replace("_", " "))


def write_tables(out: Path, sizes: Sequence[Row], members: Sequence[Row], graded: Sequence[Row], found: Sizes) -> None:
    """Write sizes.csv, members.csv, graded.csv, curve.csv and sizes.json (all but the members) into a folder.

    Args:
        out: the folder.
        sizes: a row each.
        members: a row each.
        graded: a row for each finished dimension, a column for each size.
        found: the sizes.
    """
    curve = [curve_row(step) for step in found.steps]
    for name, rows in (("sizes", sizes), ("members", members), ("graded", graded), ("curve", curve)):
        write_table(out / f"{name}.csv", list(rows[0]), rows)
    content = {
        "near_mm": NEAR,
        "sizes": [dict(row) for row in sizes],
        "dimensions": [dict(row) for row in graded],
        "curve": curve,
        "nearest_wire_sold": asdict(found.catalogue.served),
    }
    write_text(out / "sizes.json", json.dumps(content, indent=2, ensure_ascii=False, default=float) + "\n")


def curve_row(step: Step) -> dict[str, float]:
    """The figures of one number of sizes: of the best sizes, of the same chosen by wire, of groups by wire length."""

    def own(choice: Choice, name: str) -> dict[str, float]:
        served = choice.served
        near = {f"{name}_within_3mm_percent": 100 * served.near}
        return {f"{name}_mean_mm": served.mean, f"{name}_p95_mm": served.p95, **near}

    count = {"sizes": step.sizes.served.count}
    return count | own(step.sizes, "best") | own(step.wire_groups, "wire_groups") | own(step.by_wire, "by_wire")


def write_page(
    out: Path,
    title: str,
    sizes: Sequence[Row],
    graded: Sequence[Row],
    found: Sizes,
    notes: Sequence[str],
    warnings: Sequence[str] = (),
) -> None:
    """Write index.html: figures, pictures, the table of sizes, finished dimensions and the nest.

    Args:
        out: the folder of the tables and pictures.
        title: of the page.
        sizes: as `write_tables` takes them.
        graded: likewise.
        found: likewise.
        notes: what the user should know of the data.
        warnings: what speaks against using the sizes as they are.
    """
    step = found.steps[len(sizes) - 1]
    facts = [
        (f"{len(found.size)}", "cups"),
        (f"{len(sizes)}", "sizes"),
        (f"{step.sizes.served.mean:.1f} mm", "error, mean"),
        (f"{step.sizes.served.p95:.1f} mm", "95 % are below"),
        (f"{100 * step.sizes.served.near:.0f} %", f"within {NEAR:g} mm"),
        (f"{step.wire_groups.served.mean:.1f} mm", "error, mean, as many groups by wire length"),
    ]
    shown = "".join(f"<div><b>{text(value)}</b><span>{text(words)}</span></div>" for value, words in facts)
    told = warned(warnings) + "".join(f"<p>{text(words)}</p>" for words in notes)
    files = ["patterns.svg", "patterns.dxf", "patterns.pdf", "sizes.csv", "members.csv", "graded.csv", "curve.csv"]
    links = ", ".join(f'<a href="{link(name)}">{text(name)}</a>' for name in [*files, "sizes.json"])
    sold = found.catalogue.served
    catalogue = (
        f"By the nearest wire that is sold ({sold.count} wires): mean {sold.mean:.1f} mm, 95 % below {sold.p95:.1f} mm."
    )
    write_text(
        out / "index.html",
        page(
            title,
            f'<h1>{text(title)}</h1><div class="facts">{shown}</div>{told}<p>{text(METHOD)}</p>'
            f"<h2>The cups</h2>{_picture('cups.svg', 'the cups, size by size')}"
            f"<h2>Sizes</h2>{_table(sizes)}"
            f"<h2>How many sizes</h2>{_picture('served.svg', 'error by number of sizes')}"
            f"<p>{text(catalogue)}</p>{_table([curve_row(step) for step in found.steps])}"
            f"<h2>Finished dimensions</h2>{_table(*_dimensions(graded))}"
            f'<h2>Patterns</h2><p>{links}</p><p><img class="pieces" src="patterns.svg" alt="the nest"></p>'
            f"<script>{asset('table.js')}</script>",
            wide=True,
        ),
    )


def _dimensions(graded: Sequence[Row]) -> tuple[Sequence[Row], int]:
    """Finished dimensions as the page shows them, and with how many decimal places: as many as labels have."""
    units = {str(row["unit"]) for row in graded}
    shown = [dict(row) | {"unit": UNITS.get(str(row["unit"]), row["unit"])} for row in graded]
    return shown, 2 if units & {"in", "in2"} else 1


def _picture(file: str, words: str) -> str:
    return f'<p><img src="{link(file)}" alt="{text(words)}" style="max-width:100%"></p>'


def _table(rows: Sequence[Row], places: int = 2) -> str:
    keys = list(rows[0])
    classes = [' class="number"' * isinstance(rows[0].get(key), float | int) for key in keys]
    head = "".join(f"<th{own}>{text(heading(key))}</th>" for key, own in zip(keys, classes, strict=True))
    body = "".join(f"<tr>{''.join(_cell(row.get(key), places) for key in keys)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table class="sortable"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _cell(value: Any, places: int) -> str:
    if isinstance(value, float | int):
        shown = fixed(float(value), 0 if isinstance(value, int) else places)
        return f'<td class="number" data-value="{value!r}">{text(shown)}</td>'
    return f"<td>{text(value)}</td>"
