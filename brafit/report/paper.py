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
        lower, upper = self.folds(np.array([share]))[0]
        return lower, upper

    def folds(self, shares: Float[ndarray, " s"]) -> Float[ndarray, "s 2 n 3"]:
        """Both edges as `folded` gives them, for several shares."""
        n, start = len(self.lower), self.middle
        flat = np.zeros((2, n, 3))
        flat[0, :, :2], flat[1, :, :2] = self.lower, self.upper
        first = _motion(self.frame, self.origin - self.frame @ flat[0, start])
        moves = np.empty((len(shares), n, 4, 4))
        moves[:, start : start + 2] = first
        # every facet moves as the one before it, after a turn about the flat panel's ruling between them
        turns = _creases(flat[0], flat[1] - flat[0], shares[:, None] * self.creases)
        back = _creases(flat[0], flat[1] - flat[0], -shares[:, None] * self.creases)
        moves[:, start + 2 :] = first @ _products(turns[:, start + 1 : n - 1])
        moves[:, :start] = (first @ _products(back[:, start:0:-1]))[:, ::-1]
        moved = flat[None, :, :, None, :] @ moves[:, None, ..., :3, :3].swapaxes(-1, -2)
        return moved[..., 0, :] + moves[:, None, ..., :3, 3]


def paper_panels(shape: CupShape, panels: list[FlatPanel]) -> list[PaperPanel]:
    """The panels of one cup (no batch dimension, mm) with their creases.

    Args:
        shape: the cup.
        panels: the same panels laid flat, mm.
    """
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
    """How far (mm) the edges of the folded paper cup lie from the cup's at most.

    Args:
        shape: the cup, mm.
        papers: its panels from `paper_panels`.
    """
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


def _motion(turn: Float[ndarray, "*n 3 3"], shift: Float[ndarray, "*n 3"]) -> Float[ndarray, "*n 4 4"]:
    """A rotation and a shift after it."""
    motion = np.zeros((*shift.shape[:-1], 4, 4))
    motion[..., :3, :3], motion[..., :3, 3], motion[..., 3, 3] = turn, shift, 1.0
    return motion


def _creases(
    origins: Float[ndarray, "n 3"], axes: Float[ndarray, "n 3"], angles: Float[ndarray, "s n"]
) -> Float[ndarray, "s n 4 4"]:
    """Rotations about axes through points."""
    x, y, z = (axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)).T
    zero = np.zeros_like(x)
    cross = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    turn = np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)
    return _motion(turn, origins - (turn @ origins[:, :, None])[..., 0])


def _products(motions: Float[ndarray, "s n 4 4"]) -> Float[ndarray, "s n 4 4"]:
    """Of each motion with all before it: of pairs, then of fours, and so on."""
    product, step = motions.copy(), 1
    while step < product.shape[1]:
        product[:, step:] = product[:, :-step] @ product[:, step:]
        step *= 2
    return product
