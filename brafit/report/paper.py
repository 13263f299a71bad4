"""The paper cup: flat panels creased along their rulings, as designers fold them by hand.

A panel is taken as a strip of flat facets between neighbouring rulings. Turning every facet about its ruling by the
same share of the crease angles that the cup has leads from the flat pattern to the cup, and no length in any facet
changes on the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel


@dataclass(frozen=True)
class PaperPanel:
    """One panel and how it is creased.

    Attributes:
        lower, upper: its edges, flat, mm.
        creases: angle in radians by which the facet after each ruling turns against the one before it; 0 at both ends.
        frame: columns are the flat panel's x, y and normal where the cup has them, at the middle facet.
        origin: where the cup has the lower edge's sample that begins that facet.
    """

    lower: Float[ndarray, "n 2"]
    upper: Float[ndarray, "n 2"]
    creases: Float[ndarray, " n"]
    frame: Float[ndarray, "3 3"]
    origin: Float[ndarray, "3"]

    @property
    def middle(self) -> int:
        """The facet that stays where it is."""
        return (len(self.lower) - 1) // 2

    def folded(self, share: float) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3"]]:
        """Lower and upper edge in space when every crease is folded by `share` of its angle: 0 flat, 1 the cup."""
        flat = np.zeros((2, len(self.lower), 3))
        flat[0, :, :2], flat[1, :, :2] = self.lower, self.upper
        placed = np.empty_like(flat)
        start = self.middle
        turn, shift = self.frame, self.origin - self.frame @ flat[0, start]
        placed[:, start : start + 2] = flat[:, start : start + 2] @ turn.T + shift
        for step in (1, -1):
            rotation, translation = turn, shift
            rulings = range(start + 1, len(self.lower) - 1) if step > 0 else range(start, 0, -1)
            for k in rulings:
                axis = flat[1, k] - flat[0, k]
                crease = _rotation(axis, step * share * self.creases[k])
                # about the ruling k of the flat panel, then as the facet before it
                translation = translation + rotation @ (flat[0, k] - crease @ flat[0, k])
                rotation = rotation @ crease
                placed[:, k + step] = flat[:, k + step] @ rotation.T + translation
        return placed[0], placed[1]


def paper_panels(shape: CupShape, panels: list[FlatPanel]) -> list[PaperPanel]:
    """The panels of one cup (no batch dimension, mm) with their creases."""
    edges = shape.edges.detach().cpu().double().numpy()
    papers = []
    for i, panel in enumerate(panels):
        flat_lower, flat_upper = (curve.detach().cpu().double().numpy() for curve in (panel.lower, panel.upper))
        lower, upper = edges[i], edges[i + 1]
        ruling = upper - lower
        along = np.diff((lower + upper) / 2, axis=0)
        normal = np.cross(along, (ruling[:-1] + ruling[1:]) / 2)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        axis = ruling / np.maximum(np.linalg.norm(ruling, axis=1, keepdims=True), 1e-12)
        creases = np.zeros(len(lower))
        sine = (np.cross(normal[:-1], normal[1:]) * axis[1:-1]).sum(1)
        creases[1:-1] = np.arctan2(sine, (normal[:-1] * normal[1:]).sum(1))
        k = (len(lower) - 1) // 2
        frame = _frame(lower[k : k + 2], upper[k : k + 2], flat_lower[k : k + 2], flat_upper[k : k + 2])
        papers.append(PaperPanel(flat_lower, flat_upper, creases, frame, lower[k]))
    return papers


def paper_gap(shape: CupShape, papers: list[PaperPanel]) -> float:
    """How far (mm) the edges of the folded paper cup lie from the cup's at most."""
    edges = shape.edges.detach().cpu().double().numpy()
    gaps = []
    for i, paper in enumerate(papers):
        for folded, edge in zip(paper.folded(1.0), edges[i : i + 2], strict=True):
            gaps.append(float(np.linalg.norm(folded - edge, axis=1).max()))
    return max(gaps)


def _frame(lower: ndarray, upper: ndarray, flat_lower: ndarray, flat_upper: ndarray) -> Float[ndarray, "3 3"]:
    """The rotation that brings a flat facet to its place in space."""
    flat = np.zeros((3, 3))
    flat[0, :2], flat[1, :2] = (
        flat_upper[0] - flat_lower[0],
        (flat_lower + flat_upper)[1] - (flat_lower + flat_upper)[0],
    )
    space = np.stack((upper[0] - lower[0], (lower + upper)[1] - (lower + upper)[0], np.zeros(3)))
    return _basis(space) @ _basis(flat).T


def _basis(vectors: ndarray) -> Float[ndarray, "3 3"]:
    """Right-handed orthonormal columns: along the first vector, towards the second, their normal."""
    a = vectors[0] / np.linalg.norm(vectors[0])
    b = vectors[1] - (vectors[1] @ a) * a
    b /= np.linalg.norm(b)
    return np.stack((a, b, np.cross(a, b)), axis=1)


def _rotation(axis: Float[ndarray, "3"], angle: float) -> Float[ndarray, "3 3"]:
    """About an axis through the origin."""
    x, y, z = axis / max(float(np.linalg.norm(axis)), 1e-12)
    cross = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
