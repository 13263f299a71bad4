"""Orthographic pictures of surfaces, dots and lines, painted from back to front.

Every facet, dot and piece of line takes its own place in depth.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.report.canvas import Canvas

LIGHT = np.array((-0.35, 0.55, 0.76))
"""Direction to the light: from the viewer's left, above and behind."""


@dataclass(frozen=True)
class View:
    """A direction to look from: unit vectors to the picture's right, to its top and to the viewer."""

    right: Float[ndarray, "3"]
    up: Float[ndarray, "3"]
    viewer: Float[ndarray, "3"]

    @classmethod
    def of(cls, viewer: tuple[float, float, float], up: tuple[float, float, float]) -> View:
        """From a direction to the viewer and one that shall be upwards as far as possible."""
        w = np.asarray(viewer, float) / np.linalg.norm(viewer)
        right = np.cross(up, w)
        right /= np.linalg.norm(right)
        return cls(right, np.cross(w, right), w)

    def flat(self, points: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 2"]:
        """Coordinates in the picture, y up."""
        return np.stack((points @ self.right, points @ self.up), axis=-1)


@dataclass
class Picture:
    """Things to be painted in one view. Colours are RGB from 0 to 255; lengths are those of the points.

    Attributes:
        radius: of all dots.
    """

    view: View
    radius: float = 0.0
    _boxes: list[ndarray] = field(default_factory=list)
    _box_depths: list[ndarray] = field(default_factory=list)
    _box_colours: list[ndarray] = field(default_factory=list)
    _dots: list[ndarray] = field(default_factory=list)
    _dot_depths: list[ndarray] = field(default_factory=list)
    _dot_colours: list[ndarray] = field(default_factory=list)

    def facets(
        self,
        corners: Float[ndarray, "n 4 3"],
        normals: Float[ndarray, "n 3"],
        colour: Float[ndarray, "3"],
    ) -> None:
        """A shaded surface of quadrangles; where its back is seen it is darker."""
        facing = normals @ self.view.viewer
        light = LIGHT @ np.stack((self.view.right, self.view.up, self.view.viewer))
        shade = 0.7 + 0.36 * np.clip(normals * np.sign(facing)[:, None] @ light, 0, 1)
        shade = np.where(facing < 0, 0.75 * shade, shade)
        self._boxes.append(self.view.flat(corners))
        self._box_depths.append((corners @ self.view.viewer).mean(1))
        self._box_colours.append(colour * shade[:, None])

    def dots(self, points: Float[ndarray, "n 3"], colours: Float[ndarray, "n 3"], lift: float) -> None:
        """Round dots, as if `lift` nearer to the viewer than they are."""
        self._dots.append(self.view.flat(points))
        self._dot_depths.append(points @ self.view.viewer + lift)
        self._dot_colours.append(colours)

    def line(
        self, points: Float[ndarray, "n 3"], colour: tuple[float, float, float], width: float, lift: float
    ) -> None:
        """A polyline of the given width, lifted likewise."""
        flat = self.view.flat(points)
        along = np.diff(flat, axis=0)
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = width / 2 * along / np.where(size > 0, size, 1.0)
        aside = along[:, ::-1] * (-1, 1)
        a, b = flat[:-1] - along / 2, flat[1:] + along / 2
        self._boxes.append(np.stack((a - aside, b - aside, b + aside, a + aside), axis=1))
        self._box_depths.append((points[:-1] + points[1:]) @ self.view.viewer / 2 + lift)
        self._box_colours.append(np.tile(colour, (len(a), 1)))

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Lower left and upper right corner of everything."""
        dots = np.concatenate([np.zeros((0, 2)), *self._dots])
        corners = np.concatenate(
            [*(boxes.reshape(-1, 2) for boxes in self._boxes), dots - self.radius, dots + self.radius]
        )
        return corners.min(0), corners.max(0)

    def paint(self, canvas: Canvas, corner: tuple[float, float], scale: float) -> None:
        """Draw everything, the farthest first.

        Args:
            canvas: to draw on.
            corner: where the upper left corner of everything is to lie, pixels.
            scale: pixels to one unit of length.
        """
        low, high = self.bounds
        origin = np.array((low[0], high[1]))

        def place(flat: ndarray) -> ndarray:
            return np.asarray(corner) + (flat - origin) * (scale, -scale)

        depths = np.concatenate((*self._box_depths, *self._dot_depths))
        colours = np.clip(np.rint(np.concatenate((*self._box_colours, *self._dot_colours))), 0, 255).astype(int)
        dots = np.concatenate([np.zeros((0, 2)), *self._dots])
        order = np.argsort(depths, kind="stable")
        canvas.shapes(place(np.concatenate(self._boxes)), place(dots), scale * self.radius, colours, order)
