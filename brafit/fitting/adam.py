"""Batched Adam: the rough first approach. Elementwise in the batch, so that problems cannot touch each other."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

Flat = Float[Tensor, "batch size"]


def descend(
    function: Callable[[Flat], tuple[Float[Tensor, " batch"], Flat]],
    start: Flat,
    steps: int,
    rate: float,
    *,
    callback: Callable[[int], None] | None = None,
) -> tuple[Flat, Bool[Tensor, " batch"]]:
    """`steps` steps of Adam (Kingma and Ba 2015) whose rate falls to zero along a half cosine.

    Returns the best place each problem has seen, and which problems met a value or gradient that is not finite (those
    stay where they were best).

    Args:
        function: places -> values and gradients.
        start: starting places.
        steps: evaluations per problem.
        rate: the first one, in the unit of the variables.
        callback: called with the number of steps done so far, before each.
    """
    place, best = start.clone(), start.clone()
    lowest = torch.full_like(start[:, 0], torch.inf)
    mean, square = torch.zeros_like(start), torch.zeros_like(start)
    diverged = torch.zeros_like(lowest, dtype=torch.bool)
    for count in range(steps):
        if callback is not None:
            callback(count)
        value, gradient = function(place)
        diverged |= ~(value.isfinite() & gradient.isfinite().all(-1))
        better = ~diverged & (value < lowest)
        lowest = torch.where(better, value, lowest)
        best = torch.where(better[:, None], place, best)
        gradient = torch.where(diverged[:, None], 0.0, gradient)
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.99 * square + 0.01 * gradient.square()
        scale = (square / (1 - 0.99 ** (count + 1))).sqrt() + 1e-12
        here = rate * 0.5 * (1 + torch.cos(torch.tensor(torch.pi * count / steps)).item())
        step = here * mean / (1 - 0.9 ** (count + 1)) / scale
        place = torch.where(diverged[:, None], place, place - step)
    return best, diverged
