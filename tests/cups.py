"""Cups for tests: the half-circle wire in solver units, and cups near something sensible."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from brafit.cup import Cup, FramesCup, StripsCup, Wire


def half_circle(count: int = 1) -> Wire:
    return Wire.stack([Wire.from_arc(1.0, math.pi)] * count)


def lune_start(cup: FramesCup) -> FramesCup:
    """Edges are half circles, turned up to the plane x = 0: all panels are cylinders, edges meet at both
    ends.
    """
    share = torch.arange(1, cup.panels + 1, dtype=torch.float64) / cup.panels
    angles = (share * math.pi / 2).expand(cup.batch, -1)
    cup.start(angles.to(cup.reference), torch.ones_like(angles).to(cup.reference))
    return cup


def lune_frames(batch: int = 1, panels: int = 2, terms: int = 4, stations: int = 41) -> FramesCup:
    return lune_start(FramesCup(half_circle(batch), panels, terms, stations))


def near(cup: Cup, amount: float = 0.05, seed: int = 0) -> Tensor:
    """Parameters beside the cup's own, the same for every seed."""
    noise = torch.randn(cup.batch, cup.size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    flat = cup.flatten().detach()
    return flat + amount * noise.to(flat)


def cloud(count: int, seed: int = 0) -> Tensor:
    """Points inside, on and outside the quarter ball around the lune cups, beyond their rim too."""
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    direction = direction / direction.norm(dim=-1, keepdim=True)
    direction[:, 0] = direction[:, 0].abs()
    radius = 0.5 + torch.rand(count, 1, generator=generator, dtype=torch.float64)
    return radius * direction + torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)


SERIES = {
    "first": {"rib": (0.0, 0.2, 0.0), "length": (-0.1, 0.08)},
    "middle": {"rib": (-0.0, -0.3, 0.0), "length": (-0.2, 0.05)},
    "last": {"rib": (0.08, -1.6, 0.08), "length": (0.0, 0.05)},
}
"""Coefficients of the series, of lengths from order 1 on: no test depends on what cups are drawn to."""


def fixed(cup: StripsCup) -> StripsCup:
    """A cup that has started, with the series of SERIES; the middle of each panel stays where it is."""
    with torch.no_grad():
        for i in range(cup.panels):
            own = SERIES["last" if i == cup.panels - 1 else "first" if i == 0 else "middle"]
            length = cup.length[:, i]
            middle = length[:, 0] - (length[:, 2] if cup.terms > 2 else 0) + (length[:, 4] if cup.terms > 4 else 0)
            cup.rib[:, i], length[:, 1:] = 0.0, 0.0
            for k, value in enumerate(own["rib"][: cup.terms]):
                cup.rib[:, i, k] = value
            for k, value in enumerate(own["length"][: cup.terms - 1], 1):
                length[:, k] = value
            length[:, 0] = middle + (length[:, 2] if cup.terms > 2 else 0)
    return cup


def plain_strips(batch: int = 1, panels: int = 2, terms: int = 5) -> StripsCup:
    """Cups at a plain start, on a wire that is not planar."""
    wire = Wire.from_omega((0.15, 0.9, 0.1), math.pi)
    cup = StripsCup(wire.select(torch.zeros(batch, dtype=torch.long)), panels, terms, nodes=40)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(batch, -1), torch.ones(batch, panels, dtype=torch.float64))
    return fixed(cup)


def varied(cup: Cup, amount: float = 0.05) -> Tensor:
    """Parameters of strips beside the start, without corner, the higher terms the smaller."""
    start = cup.flatten().detach()
    change = near(cup, amount, seed=4) - start
    order = torch.arange(cup.terms, dtype=start.dtype).repeat(2 * cup.panels)
    change = change / (1 + torch.cat((start.new_zeros(cup.panels), order, start.new_zeros(3))) ** 2)
    change[:, -3:] = 0
    return start + change
