"""A breast seen from a place within it: each direction has a radius, and directions are drawn on a flat chart
(azimuthal equidistant).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

INWARDS = 0.25
"""Where it is seen from: the middle of the bounding lines, moved by this share towards the middle of the points."""


@dataclass(frozen=True)
class Chart:
    """Directions from a centre, by angle from an axis and azimuth about it.

    Attributes:
        centre: where the breast is seen from, mm.
        axes: unit vectors, the last one out of the chest: the middle of the chart.
    """

    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]

    @staticmethod
    def about(points: np.ndarray, curve: np.ndarray) -> Chart:
        """The chart of a breast.

        Args:
            points: (n, 3) on the breast, mm.
            curve: (k, 3) the closed curve that bounds it.
        """
        middle, bound = points.mean(axis=0), curve.mean(axis=0)
        out = (middle - bound) / np.linalg.norm(middle - bound)
        across = np.eye(3)[np.abs(out).argmin()]
        first = across - (across @ out) * out
        first /= np.linalg.norm(first)
        return Chart(bound + INWARDS * (middle - bound), np.stack([first, np.cross(out, first), out]))

    def flat(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 2) on the chart, in radians, and radii (n,) in mm of points (n, 3)."""
        offset = (points - self.centre) @ self.axes.T
        radius = np.maximum(np.linalg.norm(offset, axis=1), 1e-6)
        angle = np.arccos(np.clip(offset[:, 2] / radius, -1, 1))
        across = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-12)
        return (angle / across)[:, None] * offset[:, :2], radius

    def space(self, places: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Points (n, 3) at places (n, 2) of the chart and radii (n,): the inverse of `flat`."""
        angle = np.linalg.norm(places, axis=1)
        sine = np.sinc(angle / np.pi)[:, None] * places
        return self.centre + radius[:, None] * (np.column_stack([sine, np.cos(angle)]) @ self.axes)

    def area(self, places: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Of the surface about places of an even grid, up to a factor."""
        return radius**2 * np.sinc(np.linalg.norm(places, axis=1) / np.pi)
