"""Losses as functions rho of a squared residual, with their slopes (the weights of Gauss-Newton).

Numbers in parentheses are equations of docs/formulation.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import torch
from torch import Tensor

from brafit.geometry.products import evenly

Loss = Callable[[Tensor], tuple[Tensor, Tensor]]
"""squared residual -> (rho, d rho / d squared)"""


def square(squared: Tensor) -> tuple[Tensor, Tensor]:
    return squared, torch.ones_like(squared)


def beyond(squared: Tensor, free: Tensor | float) -> tuple[Tensor, Tensor]:
    """Quadratic with a dead zone: rho = max(|r| - free, 0)^2, so that residuals up to `free` cost nothing."""
    excess = (squared.sqrt() - free).clamp_min(0)
    return excess.square(), excess / (excess + free).clamp_min(1e-30)


def smooth_absolute(squared: Tensor, width: Tensor | float) -> tuple[Tensor, Tensor]:
    """|r|, rounded off within `width` of zero: the unsquared distance of (31), made differentiable."""
    root = (squared + width**2).sqrt()
    return root - width, 0.5 / root


def cauchy(squared: Tensor, width: Tensor | float) -> tuple[Tensor, Tensor]:
    """Quadratic within `width`, logarithmic beyond: outliers lose their pull."""
    ratio = squared / width**2
    return width**2 * torch.log1p(ratio), 1 / (1 + ratio)


def fuzzy(squared: Tensor, strength: float, sharpness: Tensor | float, widths: float = 2.0) -> tuple[Tensor, Tensor]:
    """The fuzzy condition (42), k1 exp(k2 r^2) - k1 with k1 = strength, k2 = sharpness.

    Beyond `widths` / sqrt(k2) it goes on as the tangent line in |r|, so that it cannot overflow.
    """
    sharpness = torch.as_tensor(sharpness, dtype=squared.dtype, device=squared.device)
    edge = widths / sharpness.sqrt()
    inside = squared < edge**2
    near = strength * evenly(torch.exp, sharpness * torch.where(inside, squared, 0.0))
    top = strength * torch.exp(torch.as_tensor(widths**2, dtype=squared.dtype))
    rise = 2 * sharpness * edge * top
    radius = torch.where(inside, edge**2, squared).sqrt()
    far = top + rise * (radius - edge)
    value = torch.where(inside, near, far) - strength
    return value, torch.where(inside, sharpness * near, 0.5 * rise / radius)


def point_loss(kind: str | Loss, width: float, unit: Tensor | float = 1.0) -> Loss:
    """The loss of the points: `l1` (31), `l2`, `robust` (Cauchy), or one given, in mm.

    Args:
        kind: its name, or the loss.
        width: rounding of l1 and scale of robust, mm.
        unit: millimetres per unit of the residuals that it is to take.

    Raises:
        ValueError: another name, or what is given is no loss.
    """
    if not isinstance(kind, str):
        return partial(in_unit, loss=checked_loss(kind, "condition.points"), unit=unit)
    losses: dict[str, Loss] = {
        "l1": partial(smooth_absolute, width=width / unit),
        "l2": square,
        "robust": partial(cauchy, width=width / unit),
    }
    if kind not in losses:
        raise ValueError(f"unknown point loss {kind!r}: allowed are {', '.join(losses)}")
    return losses[kind]


def in_unit(squared: Tensor, loss: Loss, unit: Tensor | float) -> tuple[Tensor, Tensor]:
    """A loss in mm, of residuals of which a unit is so many millimetres."""
    rho, slope = loss(squared * unit**2)
    return rho / unit**2, slope


def checked_loss(loss: Any, setting: str) -> Loss:
    """What was given as a loss, if it is one.

    Raises:
        ValueError: it is none; names the setting, and what a loss is.
    """
    wanted = "a function of a tensor of squared residuals (mm^2) that gives rho and its slope by them, two tensors"
    name, rho_of = getattr(loss, "__name__", type(loss).__name__), cast(Loss, loss)
    if not callable(loss) or isinstance(loss, type):
        raise ValueError(f"{setting}: {name} is no loss: {wanted}")
    squared = torch.tensor([[0.0, 0.25, 100.0]], dtype=torch.float64)
    try:
        rho, slope = rho_of(squared)
        fine = rho.shape == slope.shape == squared.shape and bool((rho.isfinite() & slope.isfinite()).all())
    except Exception as error:
        raise ValueError(f"{setting}: {name} is no loss ({type(error).__name__}: {error}): {wanted}") from error
    if not fine:
        raise ValueError(f"{setting}: {name} is no loss (not finite, or not as many as the residuals): {wanted}")
    return rho_of
