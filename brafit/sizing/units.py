"""The unit of a drawing of several fits, which may have been labelled in different ones, and what it says of a cup."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from brafit.cup.shape import CupShape
from brafit.geometry.polyline import running_length
from brafit.pattern import PatternOptions
from brafit.pattern.options import UNITS
from brafit.sizing.stored import StoredFit, options_of

_NAMES = {"mm": "mm", "inch": "inches"}


def unit_of(fits: Sequence[StoredFit], wanted: str | None = None) -> tuple[str, list[str]]:
    """The unit that is wanted, else that of most of the fits; and what to say where fits have another than that.

    Args:
        fits: one or more, whose cups can be made again.
        wanted: one of `brafit.pattern.options.UNITS`; None: the fits' own.
    """
    found = Counter(options_of(fit).units for fit in fits)
    unit = wanted or found.most_common(1)[0][0]
    if wanted or len(found) < 2:
        return unit, []
    told = " and ".join(f"{count} in {_NAMES[name]}" for name, count in found.most_common())
    return unit, [f"fits were labelled in different units ({told}): here all are in {_NAMES[unit]} (--units)"]


def cup_words(shape: CupShape, options: PatternOptions) -> str:
    """What tells a cup from others: how long its wire line is and how deep it is, with their unit."""
    edges = shape.edges.numpy()
    wire, depth = float(running_length(edges[0])[-1]), float(edges[..., 2].max())
    return f"wire {options.length(wire)}, depth of cup {options.length(depth)}"


def in_unit(value: float, unit: str, wanted: str) -> tuple[float, str]:
    """A finished dimension and its unit (`mm` or `cm2`, as fit.json has them) in the wanted unit of lengths."""
    if wanted == "mm":
        return value, unit
    return (value / UNITS[wanted], "in") if unit == "mm" else (value / (UNITS[wanted] / 10) ** 2, "in2")
