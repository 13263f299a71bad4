"""Ritz bases: the functions of arc length in which the unknowns are expanded, (50), (51) of docs/formulation.md."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

BASES = ("cosine", "fourier", "chebyshev")


def ritz_basis(kind: str, terms: int, x: Float[Tensor, " n"]) -> Float[Tensor, "terms n"]:
    """Values of the first `terms` basis functions at x in [0, 1] (arc length over length).

    cosine:    1, cos(pi x), cos(2 pi x), ...            complete on [0, 1] without being periodic
    fourier:   1, sin(pi x), cos(pi x), sin(2 pi x), ... period 2: redundant on [0, 1], but rich with few terms
    chebyshev: T_k(2 x - 1)

    Args:
        kind: one of BASES.
        terms: how many functions.
        x: arc length over length.

    Raises:
        ValueError: unknown kind, or fewer than one term.
    """
    if terms < 1:
        raise ValueError(f"a Ritz basis needs at least 1 term, got {terms}")
    k = torch.arange(terms, dtype=x.dtype, device=x.device)[:, None]
    if kind == "cosine":
        return torch.cos(torch.pi * k * x)
    if kind == "fourier":
        order = torch.div(k + 1, 2, rounding_mode="floor")
        return torch.where(k % 2 == 1, torch.sin(torch.pi * order * x), torch.cos(torch.pi * order * x))
    if kind == "chebyshev":
        return torch.cos(k * torch.arccos((2 * x - 1).clamp(-1, 1)))
    raise ValueError(f"unknown Ritz basis {kind!r}: allowed are {', '.join(BASES)}")


def ritz_sum(coefficients: Float[Tensor, "*batch terms"], basis: Float[Tensor, "terms n"]) -> Float[Tensor, "*batch n"]:
    """The function with these Ritz coefficients. Summed elementwise, so that no item depends on its batch."""
    return (coefficients[..., :, None] * basis).sum(-2)
