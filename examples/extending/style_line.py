"""A condition: the ridge is a style line that passes so far below the bust point.

    brafit 'condition.extra=[{_target_: style_line.RidgeBelowApex, distance: 15}]'

Its derivatives are automatic. Scans without a bust point, and cups of one panel, are left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from brafit.cup import CupShape
from brafit.fitting import Condition
from brafit.fitting.targets import Targets


@dataclass(frozen=True)
class RidgeBelowApex(Condition):
    """How far the uppermost ridge passes below the bust point, along the body's height, less a wanted distance, mm.

    Attributes:
        distance: wanted, mm; negative: above.
        weight: see `Condition`.
    """

    distance: float
    weight: float = 0.05
    name: str = "ridge below apex"

    def residuals(self, shape: CupShape, targets: Targets) -> Tensor:
        if shape.panels < 2:
            return shape.edges.new_zeros(len(shape.edges), 1)
        found = below(shape.edges[:, -2], targets.apex) - self.distance
        return torch.where(targets.has_apex, found, 0.0)[:, None]


def below(ridge: Tensor, apex: Tensor) -> Tensor:
    """How far a ridge (batch, n, 3) passes below points (batch, 3): down is +x, and y runs along the wire's chord."""
    across, wanted = ridge[..., 1].detach().contiguous(), apex[:, 1:2].detach().contiguous()
    k = torch.searchsorted(across.cummax(dim=1).values, wanted).clamp(1, ridge.shape[1] - 1)[..., None]
    first, second = (ridge.gather(1, index.expand(-1, -1, 3))[:, 0] for index in (k - 1, k))
    share = (apex[:, 1] - first[:, 1]) / (second[:, 1] - first[:, 1])
    return torch.lerp(first[:, 0], second[:, 0], share) - apex[:, 0]
