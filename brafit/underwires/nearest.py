"""The wire that can be bought which comes nearest to a wire line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.geometry.polyline import polyline_length
from brafit.underwires.sizes import CATALOGUE, WireSize


@dataclass(frozen=True)
class NearestWire:
    """A wire of the catalogue, and how it differs from a wire line (wire less line), mm: from end to end, `span`."""

    wire: WireSize
    length: float
    span: float

    def __str__(self) -> str:
        longer = f"{abs(self.length):.1f} mm {'longer' if self.length >= 0 else 'shorter'}"
        return f"{self.wire.name}, {longer} and {abs(self.span):.1f} mm {'wider' if self.span >= 0 else 'narrower'}"


def nearest_wire(line: Float[np.ndarray, "k 3"]) -> NearestWire:
    """The wire with the least sum of the squares of the differences in length and span.

    Args:
        line: a wire line from end to end, mm.
    """
    length = polyline_length(line)
    span = float(np.linalg.norm(line[-1] - line[0]))
    found = (NearestWire(wire, wire.length - length, wire.span - span) for wire in CATALOGUE)
    return min(found, key=lambda near: math.hypot(near.length, near.span))
