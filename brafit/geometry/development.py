"""The panel laid flat, (20)-(25) of docs/formulation.md."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.developable import heading
from brafit.geometry.grid import sliding_derivative, sliding_integral


@dataclass(frozen=True)
class FlatPanel:
    """Planar development of panels, seen from outside the cup.

    Sample k of both edges is joined by a ruling. The lower edge starts in the origin, its chord lies along +v (the
    first coordinate), and the panel lies to the left of its lower edge.
    """

    lower: Float[Tensor, "*batch n 2"]
    upper: Float[Tensor, "*batch n 2"]


def develop(
    stations: Float[Tensor, " n"],
    speed: Float[Tensor, "*batch n"],
    geodesic: Float[Tensor, "*batch n"],
    rib: Float[Tensor, "*batch n"],
    lengths: Float[Tensor, "*batch n"],
) -> FlatPanel:
    """Lay panels flat.

    Args:
        stations: the common parameter s.
        speed: d (arc length of the lower edge) / ds.
        geodesic: geodesic curvature omega_eta of the lower edge, per unit of its arc length.
        rib: rib angle alpha at the lower edge.
        lengths: ruling lengths |g|.
    """

    def integral(values: Tensor) -> Tensor:
        return sliding_integral(values[..., None], stations)[..., 0]

    turning = integral(geodesic * speed)
    a = integral(torch.cos(turning) * speed)[..., -1:]
    b = integral(torch.sin(turning) * speed)[..., -1:]
    mu = turning - heading(b, a, torch.sqrt(a * a + b * b))  # (24) with the sign that brings the chord onto the v axis
    lower = torch.stack((integral(torch.cos(mu) * speed), integral(torch.sin(mu) * speed)), dim=-1)
    leaning = mu + torch.pi / 2 + rib
    upper = lower + lengths[..., None] * torch.stack((torch.cos(leaning), torch.sin(leaning)), dim=-1)
    return FlatPanel(lower, upper)


def arc_lengths(curve: Float[Tensor, "*batch n k"], stations: Float[Tensor, " n"]) -> Float[Tensor, "*batch n"]:
    """Arc length from the first sample to each, of smooth curves in the plane or in space sampled at `stations`.

    Args:
        curve: positions; the last dimension has their coordinates.
        stations: any common parameter of the samples, increasing.
    """
    speed = sliding_derivative(curve, stations).norm(dim=-1)
    return sliding_integral(speed[..., None], stations)[..., 0]
