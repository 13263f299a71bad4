"""Cups for tests: the half-circle wire in solver units, and cups near something sensible."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from brafit.cup import Cup, FramesCup, Wire


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
