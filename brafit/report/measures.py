"""Measures over the surface of a cup, as bra makers take them with a tape.

A tape that is held upright or level lies in a plane: its path is the plane's section of the cup. A tape laid taut
between two points lies along the shortest way over the cup, a geodesic; flat panels show it as a straight line wherever
it does not meet an edge. Down is the wire's down: in the wire's plane, at right angles to the line between its ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel
from brafit.geometry.nearest import nearest_feet, surface_points
from brafit.geometry.panels import Feet
from brafit.geometry.spline import between, running_lengths, slopes
from brafit.pattern.marks import nearest_on_curves
from brafit.report.sections import sections
from brafit.report.taut import taut_lengths

WIRE = "wire line"
DOWN, UP = "bust point down to the wire (bottom cup depth)", "bust point up to the upper edge (upper cup depth)"
VERTICAL, HORIZONTAL = "vertical over the bust point", "horizontal over the bust point"
NECKLINE, UNDERARM, UPPER = (
    "neckline (inner end to strap point)",
    "underarm edge (strap point to outer end)",
    "neckline",
)
STRAP = "strap point to bust point"
_ORDER = (WIRE, UPPER, NECKLINE, UNDERARM, STRAP, DOWN, UP, VERTICAL, HORIZONTAL)
_STRIPS = 4
"""Rows of triangles across a panel, for sections: the rulings are straight."""
_X, _Y = 0, 1


def _double(values: Tensor) -> Tensor:
    return values.detach().cpu().double()


class Fitted(Protocol):
    """A cup and its flat panels: a fit or one of its alternatives."""

    @property
    def shape(self) -> CupShape: ...

    @property
    def panels(self) -> Sequence[FlatPanel]: ...


@dataclass(frozen=True, eq=False)
class Cups:
    """Fits and, of each, as many other cups, all with as many panels and stations; cup frame, mm.

    Attributes:
        edges: of every cup; the first of each fit is its own.
        tangents: derivatives of the edges by the stations.
        stations: of the samples, as shares of the wire.
        flat: lower and upper edges of the flat panels.
    """

    edges: Float[Tensor, "fits each edges n 3"]
    tangents: Float[Tensor, "fits each edges n 3"]
    stations: Float[Tensor, " n"]
    flat: Float[Tensor, "fits each panels 2 n 2"]

    @staticmethod
    def of(fits: Sequence[Sequence[Fitted]]) -> Cups:
        """Those of each fit, its own first; no batch dimensions."""
        every = [cup for cups in fits for cup in cups]
        tangents = [_double(cup.shape.tangents) * float(cup.shape.stations[-1]) for cup in every]
        flat = [torch.stack([torch.stack((panel.lower, panel.upper)) for panel in cup.panels]) for cup in every]
        edges, tangents, flat = (
            torch.stack([_double(value) for value in values]).unflatten(0, (len(fits), -1))
            for values in ([cup.shape.edges for cup in every], tangents, flat)
        )
        stations = _double(every[0].shape.stations)
        return Cups(edges, tangents, stations / float(stations[-1]), flat)

    @staticmethod
    def varied(shape: CupShape, flat: FlatPanel) -> Cups:
        """Alternatives, see `brafit.fitting.certainty.shapes_of`."""
        stations = _double(shape.stations)
        length = float(stations[-1])
        edges = torch.stack((_double(flat.lower), _double(flat.upper)), dim=-3)
        return Cups(_double(shape.edges), _double(shape.tangents) * length, stations / length, edges)

    def beside(self, others: Cups) -> Cups:
        """Each fit's cups, then its others."""
        pairs = ((getattr(self, name), getattr(others, name)) for name in ("edges", "tangents", "flat"))
        edges, tangents, flat = (torch.cat(pair, dim=1) for pair in pairs)
        return Cups(edges, tangents, self.stations, flat)


Taped = dict[str, Float[ndarray, " fits"]]
Varied = dict[str, Float[ndarray, "fits each"]]


@dataclass(frozen=True, eq=False)
class BustPoints:
    """The bust points of cups, fit after fit: of each the point nearest to the one that was marked.

    Attributes:
        feet: where on the panels.
        places: cup frame, mm.
    """

    feet: Feet
    places: Float[ndarray, "cups 3"]

    @staticmethod
    def of(cups: Cups, apex: Float[ndarray, "fits 3"]) -> BustPoints:
        """Those of the fits' cups. `apex`: as marked."""
        edges, tangents = cups.edges.flatten(0, 1), cups.tangents.flatten(0, 1)
        marked = torch.from_numpy(_every(cups, apex))[:, None]
        feet = nearest_feet(marked, edges, tangents, cups.stations)
        return BustPoints(feet, surface_points(edges, tangents, cups.stations, feet)[:, 0].numpy())


def _every(cups: Cups, places: Float[ndarray, "fits 3"]) -> Float[ndarray, "cups 3"]:
    return np.repeat(np.asarray(places, float), cups.edges.shape[1], axis=0)


def over_surface(
    cups: Cups, bust: BustPoints, strap_point: Float[ndarray, "fits 3"] | None = None
) -> tuple[Taped, Varied]:
    """Measures of the fits' own cups, and of all, mm; nan where a section does not leave the cup. Between cups of a fit
    they are to be compared: where there are several they are of every other station, of which the sections hardly
    differ.

    Args:
        cups: of the fits.
        bust: where the measures begin.
        strap_point: where the strap is sewn on; it counts as its nearest place on the upper edge.
    """
    fits, each = cups.edges.shape[:2]
    numbers, at = cups.edges.flatten(0, 1).numpy(), bust.places
    coarse = each > 1 and numbers.shape[2] % 2 == 1
    found = _sections(numbers[:, :, :: 2 if coarse else 1], at)
    fine = _sections(numbers[::each], at[::each]) if coarse else {}
    wires, uppers = running_lengths(numbers[:, 0]), running_lengths(numbers[:, -1])
    found[WIRE] = wires[:, -1]
    if strap_point is None:
        found[UPPER] = uppers[:, -1]
    else:
        x, v = numbers[:, -1], cups.tangents.flatten(0, 1)[:, -1].numpy()
        _, straps = nearest_on_curves(x, v, cups.stations.numpy(), _every(cups, strap_point))
        so_far = uppers[..., None]
        before = between(so_far, slopes(so_far), straps)[:, 0]
        found |= {NECKLINE: before, UNDERARM: uppers[:, -1] - before}
        found[STRAP] = taut_lengths(cups.flat.numpy(), straps.reshape(fits, each), bust.feet).ravel()
    varied = {name: found[name].reshape(fits, each) for name in _ORDER if name in found}
    return {name: values[:, 0] if name not in fine else fine[name] for name, values in varied.items()}, varied


def _sections(edges: Float[ndarray, "cups e n 3"], at: Float[ndarray, "cups 3"]) -> dict[str, Float[ndarray, " cups"]]:
    grids = _grids(edges)
    down, up = sections(grids, at, _Y)
    return {DOWN: down, UP: up, VERTICAL: down + up, HORIZONTAL: np.add(*sections(grids, at, _X))}


# Sections


def _grids(edges: Float[ndarray, "cups e n 3"]) -> Float[ndarray, "cups rows n 3"]:
    """Rows of points from the wire to the upper edge; neighbouring panels share a row."""
    share = np.arange(_STRIPS)[None, None, :, None, None] / _STRIPS
    rows = (1 - share) * edges[:, :-1, None] + share * edges[:, 1:, None]
    return np.concatenate((rows.reshape(len(edges), -1, *edges.shape[2:]), edges[:, -1:]), axis=1)
