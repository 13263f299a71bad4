"""The wire that can be bought which comes nearest to a wire line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.geometry.polyline import polyline_length
from brafit.underwires.sizes import CATALOGUE, WireSize, wire_size


@dataclass(frozen=True)
class NearestWire:
    """A wire of the catalogue, and how it differs from a wire line (wire less line), mm: from end to end, `span`."""

    wire: WireSize
    length: float
    span: float

    @property
    def apart(self) -> float:
        """Root of the sum of the squares of both differences, mm."""
        return math.hypot(self.length, self.span)

    @property
    def words(self) -> str:
        """How it differs."""
        longer = f"{abs(self.length):.1f} mm {'longer' if self.length >= 0 else 'shorter'}"
        return f"{longer} and {abs(self.span):.1f} mm {'wider' if self.span >= 0 else 'narrower'}"

    def __str__(self) -> str:
        return f"{self.wire.name}, {self.words}"


FAR = 15.0
"""A wire that differs from a line by so much more (mm) than the nearest one does is a size off: from size to size,
wires are 15 mm longer and 8 mm wider."""


def compared(wire: WireSize, line: Float[np.ndarray, "k 3"]) -> NearestWire:
    """How a wire differs from a wire line (from end to end, mm)."""
    span = float(np.linalg.norm(line[-1] - line[0]))
    return NearestWire(wire, wire.length - polyline_length(line), wire.span - span)


def chosen_wire(name: str, line: Float[np.ndarray, "k 3"]) -> tuple[str, bool]:
    """How a wire that was chosen by its name differs from the scan's own wire line, in words; and whether it is far."""
    chosen, nearest = compared(wire_size(name), line), nearest_wire(line)
    told = f"the wire {name} is {chosen.words} than the scan's own wire line"
    return f"{told}; nearest to that, of those sold, is {nearest}", chosen.apart - nearest.apart > FAR


def nearest_wire(line: Float[np.ndarray, "k 3"]) -> NearestWire:
    """The wire with the least sum of the squares of the differences in length and span.

    Args:
        line: a wire line from end to end, mm.
    """
    return min((compared(wire, line) for wire in CATALOGUE), key=lambda near: near.apart)
