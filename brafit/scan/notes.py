"""What the user should know of a scan that was loaded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from brafit.landmarks.file import SIDES
from brafit.landmarks.units import NAMES, Units
from brafit.remarks import Remark
from brafit.scan.framed import Framed
from brafit.scan.marked import Marked
from brafit.scan.region import Gathered
from brafit.scan.wiring import size_laid
from brafit.surface.cleaning import Cleaning
from brafit.underwires.nearest import chosen_wire

GAP = 0.01
"""Share of a cup without points that is said."""
NOISY = 1.0
"""Scatter (mm) of the cleaned points that is said."""


def notes_on(
    marked: Marked,
    breast: Framed,
    gathered: Gathered,
    upper_line: str,
    steps: Cleaning,
    assumed: float,
    *,
    chosen: bool,
) -> tuple[Remark, ...]:
    """The notes on a scan, each about the cloud's file.

    Args:
        marked: the cloud with its marks.
        breast: of the side.
        gathered: the points about it.
        upper_line: where that is from: `given`, `proposed`, `built` or `none`.
        steps: what the cleaning took.
        assumed: share of the surface between wire and upper line that is assumed.
        chosen: whether the side was named.
    """
    found = [
        *_on_units(marked.units),
        *_on_symmetry(gathered.alike),
        *_on_upper_line(upper_line, marked.cloud.inside is not None),
        *_on_size(breast),
        *_on_noise(steps.scatter_mm),
        *_on_gaps(assumed),
        *_on_marks(breast),
    ]
    another = len(marked.breasts) > 1 or (breast.marks_origin == "proposed" and marked.whole.has_middle)
    if not chosen and another:
        words = f"the {breast.marks.side} breast alone is fitted: scan.side=both fits both"
        found.append(Remark("one_side", words))
    return tuple(replace(remark, about=marked.cloud.path.name) for remark in found)


def _on_units(units: Units) -> Iterator[Remark]:
    if units.found and (units.cloud, units.marks) != ("mm", "mm"):
        files = f"the cloud is in {NAMES[units.cloud]}, the landmarks in {NAMES[units.marks]}"
        same = f"it is in {NAMES[units.cloud]}"
        yield Remark("units", f"{same if units.cloud == units.marks else files}, found from {units.found}")


def _on_symmetry(alike: float | None) -> Iterator[Remark]:
    if alike is not None:
        yield Remark(
            "both_breasts", f"the breasts are mirror images within {alike:.2f} mm: both are taken for each cup"
        )


def _on_upper_line(origin: str, flagged: bool) -> Iterator[Remark]:
    if origin == "built":
        yield Remark("upper_line_built", "no upper line given: it is built from the wire's ends and the strap point")
    if origin == "none" and not flagged:
        yield Remark("no_upper_line", "no upper line given: only the points say where the cup ends")


def _on_size(breast: Framed) -> Iterator[Remark]:
    if breast.own_wire is not None:
        told, far = chosen_wire(size_laid(breast.wire_origin), breast.own_wire)
        if not far:  # else it is a warning, see `brafit.run.likeness`
            yield Remark("chosen_wire", told)


def _on_noise(scatter: float | None) -> Iterator[Remark]:
    if scatter is not None and scatter > NOISY:
        yield Remark("noisy", f"its points scatter by {scatter:.1f} mm about their surface: edges are less certain")


def _on_gaps(assumed: float) -> Iterator[Remark]:
    if assumed >= GAP:
        words = f"a surface is assumed on {100 * assumed:.0f} % of the cup, where the scan has no points"
        yield Remark("assumed_surface", f"{words}: standard deviations (±) take it as exact")


def _on_marks(breast: Framed) -> Iterator[Remark]:
    if breast.turned:
        ends = {"inner_end", "outer_end"} & breast.marks.points.keys()
        doubt = "" if ends else f"; if that is wrong, so is the side: it says {breast.marks.side}"
        yield Remark("wire_turned", f"the wire is given from its outer end, and is turned{doubt}")
    if breast.lengths:
        lengths = ", ".join(f"{side} {length:.0f} mm long" for side, length in breast.lengths.items())
        yield Remark("own_wires", f"the breasts are no mirror images: each has a wire found on it alone, {lengths}")
    if (breast.marks_origin, breast.wire_origin) == ("given", "given"):
        return
    yield Remark("guessed_marks", f"{_origins(breast)}: look at them, brafit-inspect draws them")


def _origins(breast: Framed) -> str:
    """Where a breast's marks and wire are from, in words."""
    guess = "off the crease" if size_laid(breast.wire_origin) else "guessed, no crease shows there"
    share = "" if breast.guessed is None else f" ({100 * breast.guessed:.0f} % of it {guess})"
    if breast.marks_origin != "mirrored":
        return f"landmarks {breast.marks_origin}, wire {breast.wire_origin}{share}"
    other = SIDES[1 - SIDES.index(breast.marks.side)]
    unmarked = f"the {breast.marks.side} breast is not marked: its landmarks"
    if breast.wire_origin == "mirrored":
        return f"{unmarked} and wire are the {other} one's, mirrored"
    return f"{unmarked} are the {other} one's, mirrored, its wire {breast.wire_origin}{share}"
