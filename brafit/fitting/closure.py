"""Closing a cup to round-off, and the scaling of variables in which that is the least change."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import derivatives
from brafit.fitting.normal import normal_equations
from brafit.fitting.objective import Objective, Pressure


def close(objective: Objective, place: Float[Tensor, "batch size"], pressure: Pressure) -> Float[Tensor, "batch size"]:
    """Fulfil the cup's closure equations to round-off by the least change, measured by the objective's Gauss-Newton
    matrix.

    Args:
        objective: the problems.
        place: their parameters.
        pressure: weights of constraints, barrier and neckline.
    """
    cup = objective.cup
    if not cup.constrained:  # closed by construction
        return place

    def closure(flat: Tensor) -> Tensor:
        value = cup.closure(cup.shape_of(flat))
        return flat.new_zeros(len(flat), 0) if value is None else value

    if closure(place).shape[1] == 0:
        return place
    # damped, so that the least change is no long step in a direction that the objective hardly sees
    transform = whitening(normal_equations(objective, place, pressure).matrix, damping=1e-4)
    for _ in range(8):
        gap = closure(place)
        jacobian = derivatives(lambda flat: (closure(flat),), place)[0].movedim(0, -1)
        change = []
        for j, w, g in zip(jacobian, transform, gap, strict=True):
            change.append(-w @ torch.linalg.lstsq(j @ w, g[:, None], driver="gelsd").solution[:, 0])
        place = place + torch.stack(change)
    return place


def whitening(matrix: Float[Tensor, "batch size size"], damping: float = 1e-7) -> Float[Tensor, "batch size size"]:
    """W with W^T A W = 1 for A = matrix + damping max(diag) 1; the identity where A is not positive definite or not
    finite.
    """
    size = matrix.shape[-1]
    identity = torch.eye(size, dtype=matrix.dtype, device=matrix.device)
    result = []
    for a in matrix:  # one at a time, so that rounding does not depend on the batch
        factor, failed = torch.linalg.cholesky_ex(a + damping * a.diagonal().max() * identity)
        usable = failed == 0 and bool(factor.isfinite().all())
        result.append(torch.linalg.solve_triangular(factor, identity, upper=False).mT if usable else identity)
    return torch.stack(result)
