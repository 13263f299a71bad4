"""Moving frames and the curves they draw: (1)-(4), (46)-(49) of docs/formulation.md.

A frame F = [xi eta zeta] turns as F' = F Omega(omega) and its curve runs as x' = speed zeta. Together they are one
equation on the rigid motions, G' = G A(s). Over one interval it is solved by the fourth-order Magnus expansion (55),
exact for constant omega. The products along the curve are associative and are taken in O(log n) batched steps.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.rotation import apply, motion_exp, product

GAUSS = (0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6)
"""The two Gauss points of the unit interval, where `integrate_curve` wants its rates."""


def gauss_points(stations: Float[Tensor, " n"]) -> Float[Tensor, "n-1 2"]:
    """The two Gauss points of every interval between stations."""
    nodes = torch.tensor(GAUSS, dtype=stations.dtype, device=stations.device)
    return stations[:-1, None] + (stations[1:] - stations[:-1])[:, None] * nodes


def prefix_motions(
    rotation: Float[Tensor, "*batch n 3 3"], translation: Float[Tensor, "*batch n 3"]
) -> tuple[Float[Tensor, "*batch n 3 3"], Float[Tensor, "*batch n 3"]]:
    """All prefix products G_1, G_1 G_2, ... of rigid motions, in log2(n) steps.

    Args:
        rotation: of G_1 to G_n.
        translation: of G_1 to G_n, in the same order.
    """
    count, offset = translation.shape[-2], 1
    while offset < count:
        left_r, left_t = rotation[..., :-offset, :, :], translation[..., :-offset, :]
        right_r, right_t = rotation[..., offset:, :, :], translation[..., offset:, :]
        moved = apply(left_r, right_t) + left_t
        turned = product(left_r, right_r)
        rotation = torch.cat((rotation[..., :offset, :, :], turned), dim=-3)
        translation = torch.cat((translation[..., :offset, :], moved), dim=-2)
        offset *= 2
    return rotation, translation


def integrate_curve(
    omega: Float[Tensor, "*batch m 2 3"],
    speed: Float[Tensor, "*batch m 2"],
    steps: Float[Tensor, " m"],
    frame: Float[Tensor, "*batch 3 3"],
    origin: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch m+1 3 3"], Float[Tensor, "*batch m+1 3"]]:
    """Frames and positions of a curve at the m + 1 stations.

    Args:
        omega: rotation rates (omega_xi, omega_eta, omega_zeta) per unit of the curve's own arc length, at the two
            Gauss points of each interval.
        speed: ds_curve / ds at the same places (v^2 of (44), (45)).
        steps: lengths of the intervals, in s.
        frame: frame at the first station, columns (xi, eta, zeta).
        origin: position of the first station.
    """
    rates = omega * speed[..., None]
    h = steps[:, None]
    first, second = rates[..., 0, :], rates[..., 1, :]
    zero = torch.zeros_like(speed)
    velocity = torch.stack((zero, zero, speed), dim=-1)
    # log(G_k^-1 G_k+1) = h (A1 + A2) / 2 + h^2 sqrt(3) / 12 [A1, A2] for G' = G A
    commutator = torch.linalg.cross(first, second)
    drift = torch.linalg.cross(first, velocity[..., 1, :]) - torch.linalg.cross(second, velocity[..., 0, :])
    magnus = h * h * (3**0.5 / 12)
    rotvec = 0.5 * h * (first + second) + magnus * commutator
    shift = 0.5 * h * (velocity[..., 0, :] + velocity[..., 1, :]) + magnus * drift
    rotation, translation = motion_exp(rotvec, shift)
    rotation = torch.cat((frame[..., None, :, :], rotation), dim=-3)
    translation = torch.cat((origin[..., None, :], translation), dim=-2)
    return prefix_motions(rotation, translation)
