"""Wires of given sizes as planar curves.

A wire is known by its diameter and its length (`brafit.underwires.charts`). Regular wires are 8 to 13 % longer than the
half circle of their diameter. As an arc of that circle such a wire would curl inwards at its ends, and be narrower
there than its diameter; a real one is a U: tighter at the bottom, with arms that are nearly straight. So a wire longer
than its half circle is half an ellipse, as wide as the diameter and as deep as the length needs: its ends are parallel,
and exactly the diameter apart. A shorter wire is an arc of the circle. Both are the half circle where they meet. Inner
and outer arm are taken alike, and a wire as it lies: one that is worn is pulled open a little.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.errors import ConfigError
from brafit.geometry.polyline import running_length
from brafit.underwires.charts import CHARTS, REGULAR, SHORT, Chart, chart_of, diameter, sold, usual_length

LENGTHS, RADII = (80.0, 600.0), (30.0, 200.0)
_FINE = 20_001
"""Points by which half an ellipse is measured: within 1e-8 of its length."""


@dataclass(frozen=True)
class WireSize:
    """A planar wire, mm: `radius` is half its diameter."""

    name: str
    radius: float
    length: float

    @property
    def _angle(self) -> float:
        """Half the angle of the arc; a right one for half an ellipse."""
        return min(self.length / self.radius, np.pi) / 2

    @property
    def span(self) -> float:
        """From end to end."""
        return 2 * self.radius * float(np.sin(self._angle))

    def line(self, count: int) -> Float[np.ndarray, "count 2"]:
        """Points at equal steps along it: depth below the chord, place along the chord from the first end."""
        deep = self.radius
        if self.length > np.pi * self.radius:
            deep = _depth(self.radius, self.length)
        angle = np.linspace(-self._angle, self._angle, _FINE)
        fine = np.stack([deep * np.cos(angle), self.radius * np.sin(angle)], axis=1)
        steps = running_length(fine)
        angle = np.interp(np.linspace(0, steps[-1], count), steps, angle)
        across = self.radius * (np.sin(angle) + np.sin(self._angle))
        return np.stack([deep * (np.cos(angle) - np.cos(self._angle)), across], axis=1)


def _depth(radius: float, length: float) -> float:
    """Depth of half an ellipse of this half width and length."""
    from scipy.optimize import root_scalar  # takes a moment, and only these wires need it
    from scipy.special import ellipe

    def too_long(depth: float) -> float:
        return 2 * depth * ellipe(1 - (radius / depth) ** 2) - length

    return float(root_scalar(too_long, bracket=(radius, length)).root)


def _of_chart(chart: Chart, size: int) -> WireSize:
    return WireSize(chart.name_of(size), diameter(size) / 2, chart.length_of(size))


CATALOGUE = tuple(_of_chart(chart, size) for chart in CHARTS for size in chart.sizes)
"""Every wire that a maker sells."""


def wire_size(text: str) -> WireSize:
    """The wire that a text means.

    Args:
        text: `36` or `36/short`: a size in the median length of the makers that sell it, regular or short; `harriet:36`
            or `france:36/short`: a maker's; `65x204`: half its diameter and its length, mm.

    Raises:
        ConfigError: it is none of these, nobody sells it, or no wire can be like that.
    """
    if match := re.fullmatch(r"(?:(\w+):)?(\d\d)(/short)?", text):
        maker, size = match[1], int(match[2])
        try:
            if maker is None:
                return WireSize(text, diameter(size) / 2, usual_length(size, SHORT if match[3] else REGULAR))
            return _of_chart(chart_of(maker.casefold(), SHORT if match[3] else None, size), size)
        except ConfigError as error:
            raise ConfigError(f"scan.wire={text}: {error}") from None
    if match := re.fullmatch(r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", text):
        return _by_hand(text, float(match[1]), float(match[2]))
    forms = "null, detect, a size (36, 36/short), a maker's size (harriet:36) or RADIUSxLENGTH in mm (65x204)"
    raise ConfigError(f"scan.wire={text}: must be {forms}; known are {sold()}")


def _by_hand(text: str, radius: float, length: float) -> WireSize:
    if not (RADII[0] <= radius <= RADII[1] and LENGTHS[0] <= length <= LENGTHS[1] and length <= 1.4 * np.pi * radius):
        limits = f"radius {RADII[0]:g} to {RADII[1]:g}, length {LENGTHS[0]:g} to {LENGTHS[1]:g}, below 1.4 half circles"
        raise ConfigError(f"scan.wire={text}: must be of {limits}")
    return WireSize(text, radius, length)
