"""Wires of given sizes: planar arcs by radius and length, with a table of common sizes.

Diameters are those of the table "underwire size" in Wikipedia's article "Bra size" (after B. Johnson, The Bra-makers
Manual): size 30 (32A, 30B, 28C) is 3 5/6 inches across, each further size of two a third of an inch more. The table
has no lengths, which differ by style; a half circle is taken. A wire at hand is given by its own radius and length.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.errors import ConfigError

INCH = 25.4
SMALLEST, LARGEST = 30, 60
DIAMETER, STEP = 3 + 5 / 6, 1 / 6
"""Inches: of size 30, and more for each number above it."""
LENGTHS, RADII = (80.0, 600.0), (30.0, 200.0)


@dataclass(frozen=True)
class WireSize:
    """A planar arc, mm."""

    name: str
    radius: float
    length: float

    def arc(self, count: int) -> Float[np.ndarray, "count 2"]:
        """Points at equal steps of arc length: depth below the chord, place along the chord from the first end."""
        half = self.length / self.radius / 2
        angle = np.linspace(-half, half, count)
        depth = self.radius * (np.cos(angle) - np.cos(half))
        return np.stack([depth, self.radius * (np.sin(angle) + np.sin(half))], axis=1)


SIZES = {
    str(size): WireSize(
        str(size),
        (DIAMETER + STEP * (size - SMALLEST)) * INCH / 2,
        np.pi * (DIAMETER + STEP * (size - SMALLEST)) * INCH / 2,
    )
    for size in range(SMALLEST, LARGEST + 1, 2)
}
"""Common sizes by name."""


def wire_size(text: str) -> WireSize:
    """A size of the table, or RADIUSxLENGTH in millimetres, such as 65x204.

    Raises:
        ConfigError: it is neither, or no wire can be like that.
    """
    if text in SIZES:
        return SIZES[text]
    match = re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", text)
    if not match:
        known = f"{SMALLEST} to {LARGEST} (even)"
        raise ConfigError(f"scan.wire={text}: must be null, detect, a size {known}, or RADIUSxLENGTH in mm: 65x204")
    radius, length = float(match[1]), float(match[2])
    if not (RADII[0] <= radius <= RADII[1] and LENGTHS[0] <= length <= LENGTHS[1] and length <= 1.4 * np.pi * radius):
        limits = f"radius {RADII[0]:g} to {RADII[1]:g}, length {LENGTHS[0]:g} to {LENGTHS[1]:g}, below 1.4 half circles"
        raise ConfigError(f"scan.wire={text}: must be of {limits}")
    return WireSize(text, radius, length)
