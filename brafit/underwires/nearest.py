"""The wire that can be bought which comes nearest to a wire line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.geometry.polyline import running_length
from brafit.underwires.sizes import CATALOGUE, WireSize, wire_size


@dataclass(frozen=True)
class NearestWire:
    """A wire of the catalogue, and how it differs from the wanted one (wire less wanted), mm: in length and from end to
    end, `span`.
    """

    wire: WireSize
    length: float
    span: float

    @property
    def apart(self) -> float:
        """Root of the sum of the squares of both differences, mm."""
        return math.hypot(self.length, self.span)

    @property
    def words(self) -> str:
        """How it differs, to 0.1 mm."""
        longer = _differs(self.length, "as long", "longer", "shorter")
        return f"{longer} and {_differs(self.span, 'as wide', 'wider', 'narrower')}"

    def __str__(self) -> str:
        return f"{self.wire.name}, {self.words}"


def _differs(by: float, alike: str, more: str, less: str) -> str:
    rounded = round(by, 1)
    return f"{abs(rounded):.1f} mm {more if rounded > 0 else less}" if rounded else alike


FAR = 15.0
"""A wire that differs from a line by so much more (mm) than the nearest one does is a size off: from size to size,
wires are 15 mm longer and 8 mm wider."""


def compared(wire: WireSize, line: Float[np.ndarray, "k 3"], play: float = 0.0, spring: float = 0.0) -> NearestWire:
    """How a wire differs from the one that a wire line (from end to end, mm) wants, see `wanted_wire`."""
    return _beside(wire, *wanted_wire(line, play, spring))


def chosen_wire(name: str, line: Float[np.ndarray, "k 3"]) -> tuple[str, bool]:
    """How a wire that was chosen by its name differs from the scan's own wire line, in words; and whether it is far."""
    chosen, nearest = compared(wire_size(name), line), nearest_wire(line)
    told = f"compared with the scan's own wire line, the wire {name} is {chosen.words}"
    return f"{told}; nearest to that, of those sold, is {nearest}", chosen.apart - nearest.apart > FAR


def wanted_wire(line: Float[np.ndarray, "k 3"], play: float = 0.0, spring: float = 0.0) -> tuple[float, float]:
    """Length and span (from end to end, not worn) of the wire that is wanted for a wire line, mm.

    Args:
        line: a wire line from end to end, mm.
        play: by how much the line is longer than the wire at each end.
        spring: by how much the wire is opened from end to end when it is worn.
    """
    arc = running_length(line)
    ends = [np.array([np.interp(at, arc, column) for column in line.T]) for at in (play, arc[-1] - play)]
    return max(float(arc[-1]) - 2 * play, 0.0), max(float(np.linalg.norm(ends[1] - ends[0])) - spring, 0.0)


def nearest_wire(line: Float[np.ndarray, "k 3"], play: float = 0.0, spring: float = 0.0) -> NearestWire:
    """The wire with the least sum of the squares of the differences in length and span from the wire that is wanted.

    Args:
        line: a wire line from end to end, mm.
        play: as for `wanted_wire`.
        spring: as for `wanted_wire`.
    """
    wanted = wanted_wire(line, play, spring)
    return min((_beside(wire, *wanted) for wire in CATALOGUE), key=lambda near: near.apart)


def _beside(wire: WireSize, length: float, span: float) -> NearestWire:
    return NearestWire(wire, wire.length - length, wire.span - span)
