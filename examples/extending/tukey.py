"""A loss of the points' distances: Tukey's biweight, which points further away than its width pull at no more.

brafit 'condition.points={_target_: tukey.Biweight, width: 6}'
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Biweight:
    """rho = w^2/3 (1 - (1 - r^2/w^2)^3) within the width w (mm), and w^2/3 beyond."""

    width: float

    def __call__(self, squared: Tensor) -> tuple[Tensor, Tensor]:
        """rho of squared residuals (mm^2), and its slope by them."""
        left = (1 - squared / self.width**2).clamp_min(0)
        return torch.as_tensor(self.width**2 / 3) * (1 - left**3), left**2
