"""Orthographic pictures of triangles, dots and lines, painted from back to front into flat matplotlib axes.

Matplotlib's own 3D axes sort whole collections, so that a cloud lies either wholly before or wholly behind a surface;
here every triangle, dot and piece of line takes its own place in depth, and flat axes keep one scale.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy import ndarray

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
        """Coordinates in the picture."""
        return np.stack((points @ self.right, points @ self.up), axis=-1)


@dataclass
class Picture:
    """Things to be painted in one view. Colours are RGB from 0 to 1; lengths are those of the points."""

    view: View
    _shapes: list[ndarray] = field(default_factory=list)
    _depths: list[float] = field(default_factory=list)
    _colours: list[tuple[float, ...]] = field(default_factory=list)
    _outlined: list[float] = field(default_factory=list)

    def triangles(
        self,
        vertices: Float[ndarray, "v 3"],
        normals: Float[ndarray, "v 3"],
        faces: Int[ndarray, "f 3"],
        colours: Float[ndarray, "v 3"],
    ) -> None:
        """A shaded surface; where its back is seen it is darker."""
        normal, colour = normals[faces].mean(1), colours[faces].mean(1)
        facing = normal @ self.view.viewer
        light = LIGHT @ np.stack((self.view.right, self.view.up, self.view.viewer))
        shade = 0.7 + 0.36 * np.clip(normal * np.sign(facing)[:, None] @ light, 0, 1)
        shade = np.where(facing < 0, 0.75 * shade, shade)
        corners = vertices[faces]
        self._add(self.view.flat(corners), (corners @ self.view.viewer).mean(1), colour * shade[:, None], 0.4)

    def dots(self, points: Float[ndarray, "n 3"], colours: Float[ndarray, "n 3"], radius: float, lift: float) -> None:
        """Round dots, as if `lift` nearer to the viewer than they are."""
        angle = np.arange(8) * np.pi / 4
        ring = radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
        self._add(self.view.flat(points)[:, None] + ring, points @ self.view.viewer + lift, colours, 0.0)

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
        boxes = np.stack((a - aside, b - aside, b + aside, a + aside), axis=1)
        depth = (points[:-1] + points[1:]) @ self.view.viewer / 2 + lift
        self._add(boxes, depth, np.tile(colour, (len(boxes), 1)), 0.2)

    @property
    def bounds(self) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]]:
        """Lower left and upper right corner of everything."""
        corners = np.concatenate(self._shapes)
        return corners.min(0), corners.max(0)

    def paint(self, axes: Axes, shift: Float[ndarray, "2"]) -> None:
        """Draw everything, the farthest first, moved by `shift`. Limits and scale of the axes are the caller's."""
        order = np.argsort(self._depths, kind="stable")
        colours = np.clip(np.array(self._colours)[order], 0, 1)
        # outlines in the faces' own colours close the hairlines that anti-aliasing leaves between triangles
        widths = np.array(self._outlined)[order]
        shapes = [self._shapes[i] + shift for i in order]
        painted = PolyCollection(shapes, facecolors=colours, edgecolors=colours, linewidths=widths)
        axes.add_collection(painted, autolim=False)

    def _add(self, shapes: ndarray, depths: ndarray, colours: ndarray, outlined: float) -> None:
        self._shapes.extend(shapes)
        self._depths.extend(depths)
        self._colours.extend(map(tuple, colours))
        self._outlined.extend([outlined] * len(shapes))
