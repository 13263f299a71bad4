"""How the flat edges of a pattern bend: how often to and fro, and how deep what is needless of that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from scipy.integrate import cumulative_trapezoid

from brafit.fitting import CupFit, Target
from brafit.fitting.objective import Conditions
from brafit.geometry.fairness import STRAIGHT, EdgeCurvature

SEAM_INFLECTIONS = 2
"""Inflections that a wire edge or a ridge may have without being called needless."""
UPPER_INFLECTIONS = 1
"""As many more than the neckline has on that side of the strap point may the upper edge have."""


@dataclass(frozen=True)
class Stretch:
    """A stretch of an edge that bends to one side.

    Attributes:
        sign: 1 to the left, -1 to the right.
        start, end: mm along the edge.
        depth: how far it bulges from its chord, mm: as much would be cut off or filled by drawing it straight.
    """

    sign: int
    start: float
    end: float
    depth: float


@dataclass(frozen=True)
class Needless:
    """An edge with more inflections than are asked.

    Attributes:
        edge: its name.
        count, asked: inflections.
        where: the deepest of the stretches that are too many, mm along the edge.
        depth: how far that bulges, mm.
    """

    edge: str
    count: int
    asked: int
    where: tuple[float, float]
    depth: float

    def __str__(self) -> str:
        place = f"{self.where[0]:.0f} to {self.where[1]:.0f} mm from its inner end"
        return f"{self.edge}: {self.count} inflections, asked {self.asked}; needless {self.depth:.2f} mm deep, {place}"


@dataclass(frozen=True)
class Edges:
    """How the flat edges of a pattern bend.

    Attributes:
        counts: inflections of every edge by piece and name, those of the upper edge on either side of the strap corner.
        needless: the edges with too many.
        pieces: how many pieces.
        neckline: inflections of the smooth neckline, on either side.
        radius: the tightest of any edge, away from the corner, mm.
    """

    counts: dict[tuple[int, str], int]
    needless: list[Needless]
    pieces: int
    neckline: list[int]
    radius: float

    def of(self, name: str) -> list[int]:
        """Inflections of the edges whose names begin so."""
        return [count for (_, edge), count in self.counts.items() if edge.startswith(name)]

    @property
    def wire(self) -> int:
        return self.of("wire")[0]

    @property
    def ridges(self) -> int:
        """Most of any ridge edge."""
        return max(self.of("ridge"), default=0)

    @property
    def upper_excess(self) -> int:
        """Most by which the upper edge has more than the neckline on that side; in all, if not both are parted."""
        upper = self.of("upper")
        if len(upper) != len(self.neckline):
            return sum(upper) - sum(self.neckline)
        return max(a - b for a, b in zip(upper, self.neckline, strict=True))

    def __str__(self) -> str:
        own = [[(edge, n) for (piece, edge), n in self.counts.items() if piece == k] for k in range(self.pieces)]
        sums = [
            [_sum([n for _, n in part]) for _, part in groupby(edges, lambda edge: edge[0].split(",")[0])]
            for edges in own
        ]
        return f"{' | '.join(','.join(part) for part in sums)} (neckline {_sum(self.neckline) or 'none'})"


def _sum(counts: Sequence[int]) -> str:
    return "+".join(map(str, counts))


def stretches(bend: EdgeCurvature, run: np.ndarray) -> list[Stretch]:
    """The stretches of a run that bend to one side; what is as good as straight belongs to none."""
    inside = np.flatnonzero(run)
    k, arc = bend.curvature[inside], bend.arc[inside]
    bent = np.flatnonzero(np.abs(k) > STRAIGHT)
    found = []
    for sign, group in groupby(bent, lambda j: int(np.sign(k[j]))):
        part = [*group]
        first, last = part[0], part[-1]
        while first > 0 and k[first - 1] * sign > 0:
            first -= 1
        while last < len(k) - 1 and k[last + 1] * sign > 0:
            last += 1
        own = slice(first, last + 1)
        found.append(Stretch(sign, float(arc[first]), float(arc[last]), _bulge(k[own], arc[own])))
    return found


def _bulge(curvature: np.ndarray, arc: np.ndarray) -> float:
    """Largest distance (mm) of a curve from its chord."""
    if len(arc) < 2:
        return 0.0
    turn = cumulative_trapezoid(curvature, arc, initial=0)
    place = cumulative_trapezoid(np.exp(1j * turn), arc, initial=0)
    return float(np.abs((place * np.conj(place[-1])).imag).max() / abs(place[-1]))


def needless(edge: str, found: Sequence[Stretch], asked: int) -> Needless | None:
    """What an edge has too many of: the shallowest stretches, one after the other, until no more inflections are left
    than are asked. None: it has not more.
    """
    left, taken = [*found], []
    while len(left) - 1 > asked:
        k = min(range(len(left)), key=lambda i: left[i].depth)
        taken.append(left.pop(k))
        if 0 < k < len(left):  # its neighbours bend to the same side and become one
            left[k - 1 : k + 1] = [max(left[k - 1 : k + 1], key=lambda one: one.depth)]
    if not taken:
        return None
    worst = max(taken, key=lambda one: one.depth)
    return Needless(edge, len(found) - 1, asked, (worst.start, worst.end), worst.depth)


def edges_of(target: Target, fit: CupFit, condition: Conditions) -> Edges:
    """How the edges of a fit's pattern bend."""
    line = target.smooth_neckline(condition.neckline_wave)
    neckline = _neckline_inflections(() if line is None else line.sides)
    place = None
    if target.strap_point is not None:
        place = int(np.linalg.norm(fit.shape.edges[-1].numpy() - target.strap_point, axis=1).argmin())
    last, counts, radii, excess = len(fit.panels) - 1, {}, [], []
    for k, panel in enumerate(fit.panels):
        for number, curve in ((k, panel.lower.numpy()), (k + 1, panel.upper.numpy())):
            upper = number == last + 1
            bend = EdgeCurvature.of(curve, curve[place] if upper and place is not None else None)
            radii.append(bend.tightest()[0])
            for side, run in enumerate(bend.runs):
                name = f"upper edge, side {side + 1}" if upper else f"ridge {number}" if number else "wire edge"
                found = stretches(bend, run)
                counts[k, name] = max(len(found) - 1, 0)
                own = neckline[side] if len(neckline) == len(bend.runs) else sum(neckline)
                asked = own + UPPER_INFLECTIONS if upper else SEAM_INFLECTIONS
                excess.append(needless(f"piece {k + 1}, {name}", found, asked))
    return Edges(counts, [one for one in excess if one is not None], last + 1, neckline, min(radii))


def _neckline_inflections(sides: Sequence[np.ndarray]) -> list[int]:
    """Of each side, laid into its best plane; as far from the corner as those of an upper edge."""
    flat = [_in_best_plane(side) for side in sides]
    corners = [flat[0][-1], flat[1][0]] if len(flat) == 2 else [None] * len(flat)
    bends = (EdgeCurvature.of(side, corner) for side, corner in zip(flat, corners, strict=True))
    return [sum(bend.inflections()) for bend in bends]


def _in_best_plane(line: np.ndarray) -> np.ndarray:
    centred = line - line.mean(axis=0)
    return centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
