"""Fairness of flat edges: how quickly their curvature changes.

An edge is fair where its curvature varies slowly. The measure is the integral of (d curvature / d arc length)^2 along
the edge, which circles make zero (the minimum variation curve of Moreton and Sequin, Functional optimization for fair
surface design, 1992), taken between neighbouring samples. Its square roots are residuals.

The curvature of a flat edge is rate / speed: how the edge turns in its panel, and how fast it runs, both per unit of a
common parameter s. The measure is (68) of docs/formulation.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline
from torch import Tensor

from brafit.geometry.polyline import distinct, running_length

Values = Float[Tensor, "*batch n"]
STRAIGHT = 0.002
"""Curvature (1 / mm) below which an edge passes for straight: its sign there means nothing."""
ENDS = 0.02
"""Share of an edge at either end where the panel shrinks to a cusp."""
CORNER_MM = 10.0
"""An upper edge's corner is rounded off within this distance (mm, along the edge)."""
_SAMPLES = 401


@dataclass(frozen=True)
class Variation:
    """Variation of the curvature of edges.

    Attributes:
        rate: how the edges turn, per s.
        speed: d arc length / ds.
        steps: intervals between the samples, in s.
        share: roots of the weights of the intervals; 1 counts an interval in full.
    """

    rate: Values
    speed: Values
    steps: Float[Tensor, " intervals"]
    share: Float[Tensor, "*batch intervals"] | float = 1.0

    @cached_property
    def curvature(self) -> Values:
        return self.rate / self.speed

    @property
    def scale(self) -> Float[Tensor, "*batch intervals"]:
        """Roots of weight over arc length: residual = scale * change of curvature."""
        return self.share / self.lengths.sqrt()

    @cached_property
    def lengths(self) -> Float[Tensor, "*batch intervals"]:
        """Arc length of the intervals."""
        return 0.5 * self.steps * (self.speed[..., 1:] + self.speed[..., :-1])

    @cached_property
    def residual(self) -> Float[Tensor, "*batch intervals"]:
        return self.scale * self.curvature.diff(dim=-1)

    def columns(
        self, rate: Float[Tensor, "*batch n k"], speed: Float[Tensor, "*batch n k"]
    ) -> Float[Tensor, "*batch intervals k"]:
        """Derivatives of the residuals from those of rate and speed (weights held)."""
        change = torch.addcmul(rate, self.curvature[..., None], speed, value=-1) / self.speed[..., None]
        lengths = 0.5 * self.steps[:, None] * (speed[..., 1:, :] + speed[..., :-1, :])
        stretch = 0.5 * self.residual / self.lengths
        return torch.addcmul(self.scale[..., None] * change.diff(dim=-2), stretch[..., None], lengths, value=-1)


@dataclass(frozen=True)
class EdgeCurvature:
    """Signed curvature of a plane curve, positive where it turns to the left.

    Attributes:
        arc: evenly spaced distances along the curve, mm.
        curvature: 1 / mm.
        runs: which samples belong to each smooth part: all but the ends, on either side of the corner.
    """

    arc: Float[np.ndarray, " n"]
    curvature: Float[np.ndarray, " n"]
    runs: tuple[Bool[np.ndarray, " n"], ...]

    @staticmethod
    def of(curve: Float[np.ndarray, "k 2"], corner: Float[np.ndarray, "2"] | None = None) -> "EdgeCurvature":
        """Of the smooth curve through samples; `corner`: where it has one, and is not smooth."""
        curve = distinct(curve)
        along = running_length(curve)
        spline, arc = CubicSpline(along, curve), np.linspace(0, along[-1], _SAMPLES)
        (dx, dy), (ddx, ddy) = spline(arc, 1).T, spline(arc, 2).T
        curvature = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
        inner = (arc > ENDS * arc[-1]) & (arc < (1 - ENDS) * arc[-1])
        if corner is None:
            return EdgeCurvature(arc, curvature, (inner,))
        at = arc[np.linalg.norm(spline(arc) - corner, axis=1).argmin()]
        return EdgeCurvature(arc, curvature, (inner & (arc < at - CORNER_MM), inner & (arc > at + CORNER_MM)))

    def inflections(self) -> list[int]:
        """Sign changes of the curvature in each run, where the curve is not as good as straight."""
        counts = []
        for run in self.runs:
            bent = self.curvature[run & (np.abs(self.curvature) > STRAIGHT)]
            counts.append(int((np.diff(np.sign(bent)) != 0).sum()))
        return counts

    def tightest(self) -> tuple[float, float]:
        """The least radius (mm) in any run, and its distance along the curve (mm)."""
        size = np.where(np.any(self.runs, axis=0), np.abs(self.curvature), 0.0)
        k = int(size.argmax())
        return float(1 / max(size[k], 1e-12)), float(self.arc[k])
