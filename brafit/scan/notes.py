"""What the user should know of a scan that was loaded, each with a code by which programs know it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from brafit.landmarks.units import NAMES, Units
from brafit.scan.framed import Framed
from brafit.scan.marked import Marked
from brafit.scan.region import Gathered
from brafit.surface.cleaning import Cleaning
from brafit.underwires.nearest import chosen_wire

NOISY = 1.0
"""Scatter (mm) of the cleaned points that is said."""


@dataclass(frozen=True)
class Note:
    """One thing to know of a scan; as a string, a line for people.

    Attributes:
        file: name of the cloud's file.
        code: what it is about: `units`, `both_breasts`, `upper_line_built`, `no_upper_line`, `chosen_wire`, `noisy`,
            `wire_turned`, `guessed_marks` or `one_side`.
        text: a sentence.
    """

    file: str
    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}: {self.text}"


def notes_on(
    marked: Marked, breast: Framed, gathered: Gathered, upper_line: str, steps: Cleaning, *, chosen: bool
) -> tuple[Note, ...]:
    """The notes on a scan.

    Args:
        marked: the cloud with its marks.
        breast: of the side.
        gathered: the points about it.
        upper_line: where that is from: `given`, `proposed`, `built` or `none`.
        steps: what the cleaning took.
        chosen: whether the side was named.
    """
    found = [
        *_on_units(marked.units),
        *_on_symmetry(gathered.alike),
        *_on_upper_line(upper_line, marked.cloud.inside is not None),
        *_on_size(breast),
        *_on_noise(steps.scatter_mm),
        *_on_marks(breast),
    ]
    if not chosen and (breast.marks_origin == "proposed" or len(marked.breasts) > 1):
        found.append(("one_side", f"the {breast.marks.side} breast alone is fitted: scan.side=both fits both"))
    return tuple(Note(marked.cloud.path.name, code, text) for code, text in found)


def _on_units(units: Units) -> Iterator[tuple[str, str]]:
    if units.found and (units.cloud, units.marks) != ("mm", "mm"):
        files = f"the cloud is in {NAMES[units.cloud]}, the landmarks in {NAMES[units.marks]}"
        same = f"it is in {NAMES[units.cloud]}"
        yield "units", f"{same if units.cloud == units.marks else files}, found from {units.found}"


def _on_symmetry(alike: float | None) -> Iterator[tuple[str, str]]:
    if alike is not None:
        yield "both_breasts", f"the breasts are mirror images within {alike:.2f} mm: both are taken for each cup"


def _on_upper_line(origin: str, flagged: bool) -> Iterator[tuple[str, str]]:
    if origin == "built":
        yield "upper_line_built", "no upper line given: it is built from the wire's ends and the strap point"
    if origin == "none" and not flagged:
        yield "no_upper_line", "no upper line given: only the points say where the cup ends"


def _on_size(breast: Framed) -> Iterator[tuple[str, str]]:
    if breast.own_wire is not None:
        told, far = chosen_wire(breast.wire_origin.removeprefix("size "), breast.own_wire)
        if not far:  # else it is a warning, see `brafit.run.likeness`
            yield "chosen_wire", told


def _on_noise(scatter: float | None) -> Iterator[tuple[str, str]]:
    if scatter is not None and scatter > NOISY:
        yield "noisy", f"its points scatter by {scatter:.1f} mm about their surface: edges are less certain"


def _on_marks(breast: Framed) -> Iterator[tuple[str, str]]:
    if breast.turned:
        ends = {"inner_end", "outer_end"} & breast.marks.points.keys()
        doubt = "" if ends else f"; if that is wrong, so is the side: it says {breast.marks.side}"
        yield "wire_turned", f"the wire is given from its outer end, and is turned{doubt}"
    if (breast.marks_origin, breast.wire_origin) == ("given", "given"):
        return
    how = f"landmarks {breast.marks_origin}, wire {breast.wire_origin}"
    guess = "off the crease" if breast.wire_origin.startswith("size") else "guessed, no crease shows there"
    share = "" if breast.guessed is None else f" ({100 * breast.guessed:.0f} % of it {guess})"
    yield "guessed_marks", f"{how}{share}: look at them, brafit-inspect draws them"
