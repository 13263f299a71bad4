"""Products and functions that give an item of a batch the same bits, whatever else is in the batch.

The libraries below take another way, which rounds differently, for a batch of one, for rows of one, for items that do
not begin where a line of memory does, and for the last few numbers of a tensor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad

_LINE = 64
"""Bytes at whose multiples memory begins that is got anew."""
_EVEN = 32
"""Numbers of which whole lines of memory are made, and whole steps of a vectorised loop."""


def bmm(a: Float[Tensor, "batch n m"], b: Float[Tensor, "batch m k"]) -> Float[Tensor, "batch n k"]:
    """a @ b for every item."""
    return torch.bmm(_two(a), _two(b))[: len(a)]


def apply(matrix: Float[Tensor, "m n"], values: Float[Tensor, "*batch n k"]) -> Float[Tensor, "*batch m k"]:
    """matrix @ values for every batch item on its own."""
    items, rows = values.reshape(-1, *values.shape[-2:]), len(matrix)
    even = pad(matrix, (0, 0, 0, -rows % _EVEN)) if rows % _EVEN else matrix
    # Values times the transposed matrix: the matrix is read once for each few of its columns, not for each of its rows,
    # which takes a third of the time.
    product = bmm(items.mT, even.mT.expand(len(items), -1, -1))[..., :rows]
    return product.mT.contiguous().reshape(*values.shape[:-2], rows, values.shape[-1])


def apply_row(matrix: Float[Tensor, "m n"], values: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch m"]:
    """`apply` for scalar functions."""
    return apply(matrix, values[..., None])[..., 0]


def evenly(function: Callable[..., Tensor], *values: Tensor) -> Tensor:
    """A function of numbers, of all values at once: whole lines of them, so that none of them are the last few."""
    count = values[0].numel()
    if count % _EVEN == 0:
        return function(*values)
    return function(*(pad(v.flatten(), (0, -count % _EVEN)) for v in values))[:count].view_as(values[0])


def weighted_rows(weights: Float[Tensor, "batch m"], rows: Float[Tensor, "batch m k"]) -> Float[Tensor, "batch k"]:
    """Sum of the rows times their weights, for every item."""
    if rows.device.type != "cpu":
        return torch.bmm(weights[:, None], rows)[:, 0]
    return (weights[..., None] * rows).sum(-2)  # a product's rounding would depend on where in memory an item lies


def total(values: Sequence[Tensor]) -> Tensor:
    """Their sum, in their order."""
    result = values[0]
    for value in values[1:]:
        result = result + value
    return result


def dots(a: Float[Tensor, "batch n"], b: Float[Tensor, "batch n"]) -> Float[Tensor, " batch"]:
    """Scalar product of every item's two rows."""
    return weighted_rows(a, b[..., None])[..., 0]


def solved_each(
    matrix: Float[Tensor, "batch n n"], right: Float[Tensor, "batch n"]
) -> tuple[Float[Tensor, "batch n"], Bool[Tensor, " batch"]]:
    """Solutions of symmetric positive equations, and which of them there are.

    Args:
        matrix: symmetric; where it is not positive definite there is no solution.
        right: right-hand sides.
    """
    if matrix.device.type == "cpu":
        parts = [_solved(m[None], r[None]) for m, r in zip(matrix, right, strict=True)]
        return torch.cat([solution for solution, _ in parts]), torch.cat([usable for _, usable in parts])
    return _solved(matrix, right)


def _solved(matrix: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    factor, failed = torch.linalg.cholesky_ex(matrix)
    solution = torch.linalg.solve_triangular(factor, right[..., None], upper=False)
    solution = torch.linalg.solve_triangular(factor.mT, solution, upper=True)[..., 0]
    return solution, (failed == 0) & solution.isfinite().all(-1)


def aligned(values: Tensor) -> Tensor:
    """The values where a product of matrices takes the same way wherever in a batch they come from."""
    return values if values.data_ptr() % _LINE == 0 else values.clone()


def _two(values: Tensor) -> Tensor:
    """At least two items."""
    if len(values) != 1 or values.device.type != "cpu":
        return values
    return values.expand(2, *values.shape[1:])
