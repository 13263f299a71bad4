"""A condition: the upper edge is to be as long as the lace that is sewn to it.

    brafit 'condition.extra=[{_target_: edge_length.UpperEdgeLength, length: 190}]'

run in this folder, or with it on PYTHONPATH. fit.json then tells under `conditions` how long the edge became.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from brafit.cup import CupShape
from brafit.fitting import Condition
from brafit.fitting.condition import SampleSlopes
from brafit.fitting.targets import Targets


@dataclass(frozen=True)
class UpperEdgeLength(Condition):
    """Length of the upper edge less a wanted length, mm.

    Attributes:
        length: wanted, mm.
        weight: see `Condition`.
    """

    length: float
    weight: float = 0.02
    name: str = "upper edge length"

    def __post_init__(self) -> None:
        if not self.length > 0:
            raise ValueError(f"length must be positive, got {self.length}")

    def residuals(self, shape: CupShape, targets: Targets) -> Tensor:
        return (lengths(shape) - self.length)[:, None]

    def derivatives(self, shape: CupShape, targets: Targets) -> SampleSlopes:
        """By the edge's tangents: the length is the integral of their norm."""
        tangents = shape.tangents[:, -1]
        by_tangents = torch.zeros_like(shape.tangents)[:, None]
        by_tangents[:, 0, -1] = weights(shape.stations)[:, None] * torch.nn.functional.normalize(tangents, dim=-1)
        return torch.zeros_like(by_tangents), by_tangents

    def measured(self, shape: CupShape, targets: Targets) -> dict[str, Tensor]:
        return {"length_mm": lengths(shape), "wanted_mm": torch.full_like(lengths(shape), self.length)}


def lengths(shape: CupShape) -> Tensor:
    """Of the upper edges, (batch)."""
    return (shape.tangents[:, -1].norm(dim=-1) * weights(shape.stations)).sum(-1)


def weights(stations: Tensor) -> Tensor:
    """Of the trapezoidal rule."""
    half = stations.diff() / 2
    return torch.nn.functional.pad(half, (0, 1)) + torch.nn.functional.pad(half, (1, 0))
