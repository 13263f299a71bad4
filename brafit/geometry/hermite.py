"""Curves between samples as cubic Hermite arcs: weights of the samples, and power series for many places at once.

Places with components first, as in `Series`, make every step of a pass over many points contiguous.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


def hermite(tau: Tensor, h: Tensor) -> Tensor:
    """Weights of (x_k, x_k+1, x'_k, x'_k+1) in the cubic Hermite interpolant, in a new last dimension.

    Args:
        tau: places in their intervals, in [0, 1].
        h: lengths of the intervals, in the unit by which x' are derivatives.
    """
    t2, t3 = tau * tau, tau * tau * tau
    return torch.stack((2 * t3 - 3 * t2 + 1, 3 * t2 - 2 * t3, h * (t3 - 2 * t2 + tau), h * (t3 - t2)), dim=-1)


def hermite_slope(tau: Tensor, h: Tensor) -> Tensor:
    """Derivatives by tau of the weights of `hermite`."""
    t2 = tau * tau
    return torch.stack((6 * t2 - 6 * tau, 6 * tau - 6 * t2, h * (3 * t2 - 4 * tau + 1), h * (3 * t2 - 2 * tau)), dim=-1)


def hermite_bend(tau: Tensor, h: Tensor) -> Tensor:
    """Second derivatives by tau of the weights of `hermite`."""
    return torch.stack((12 * tau - 6, 6 - 12 * tau, h * (6 * tau - 4), h * (6 * tau - 2)), dim=-1)


def cubics(
    edges: Float[Tensor, "*batch n 3"], tangents: Float[Tensor, "*batch n 3"], stations: Tensor
) -> Float[Tensor, "*batch intervals 4 3"]:
    """Power-series coefficients of curves over every interval."""
    h = (stations[1:] - stations[:-1])[:, None]
    x0, x1 = edges[..., :-1, :], edges[..., 1:, :]
    v0, v1 = h * tangents[..., :-1, :], h * tangents[..., 1:, :]
    rise = x1 - x0
    return torch.stack((x0, v0, 3 * rise - 2 * v0 - v1, v0 + v1 - 2 * rise), dim=-2)


def columns(table: Float[Tensor, "k rows"], index: Int[Tensor, " m"]) -> Float[Tensor, "k m"]:
    """Columns of a table. (Rows gathered and then transposed take twice as long.)"""
    return table.gather(1, index.expand(len(table), -1))


@dataclass(frozen=True)
class Series:
    """Cubics in tau, one for every point, with components first: value, slope and bend at given places."""

    terms: tuple[Tensor, ...]

    @staticmethod
    def of(terms: Float[Tensor, "4 *components m"]) -> "Series":
        c0, c1, c2, c3 = terms.unbind(0)
        return Series((c0, c1, c2, c3, 2 * c2, 3 * c3))

    def value(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        c0, c1, c2, c3, _, _ = self.terms
        return torch.addcmul(c0, torch.addcmul(c1, torch.addcmul(c2, c3, tau), tau), tau)

    def slope(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        _, c1, _, _, twice, thrice = self.terms
        return torch.addcmul(c1, torch.addcmul(twice, thrice, tau), tau)

    def bend(self, tau: Float[Tensor, " m"]) -> Float[Tensor, "*components m"]:
        *_, twice, thrice = self.terms
        return torch.addcmul(twice, thrice, tau, value=2)
