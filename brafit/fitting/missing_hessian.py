"""What the Gauss-Newton matrix leaves out of the Hessian, learnt from the steps (Dennis, Gay and Welsch, An adaptive
nonlinear least-squares algorithm, 1981).

Where residuals are large, as a cup's few millimetres are, their own second derivatives count: plain Gauss-Newton steps
then close in slowly. How the gradient changes over a step tells of it, one direction a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from brafit.fitting.normal import Normal
from brafit.geometry.products import bmm, dots

_LEAST = 1e-8
"""Of the product of their lengths: a step and a change of the gradient that point less alike tell nothing."""


@dataclass(frozen=True)
class MissingHessian:
    """The missing part of B Hessians.

    Attributes:
        matrix: symmetric; zero before the first step.
        trusted: whether the last step's decrease was foretold better with it than without it.
    """

    matrix: Float[Tensor, "batch n n"]
    trusted: Bool[Tensor, " batch"]

    @staticmethod
    def none(model: Normal) -> MissingHessian:
        """Before the first step."""
        return MissingHessian(torch.zeros_like(model.matrix), torch.ones_like(model.value, dtype=torch.bool))

    def select(self, index: Int[Tensor, " some"]) -> MissingHessian:
        """The problems with these batch indices."""
        return MissingHessian(self.matrix[index], self.trusted[index])

    @property
    def to_add(self) -> Float[Tensor, "batch n n"]:
        """What to add to the Gauss-Newton matrices: 0 where it is not trusted."""
        return torch.where(self.trusted[:, None, None], self.matrix, 0.0)

    def learnt(
        self, before: Normal, after: Normal, step: Float[Tensor, "batch n"], taken: Bool[Tensor, " batch"]
    ) -> MissingHessian:
        """After a step from one model's place to another's.

        Args:
            before: the model where the step began.
            after: the model where it ended.
            step: the change of the parameters.
            taken: which problems took their step; the others learn nothing.
        """
        foretold = _times(self.matrix, step)
        plain = -dots(before.gradient, step) - 0.5 * dots(step, _times(before.matrix, step))
        gain, along_foretold = before.value - after.value, dots(step, foretold)
        trusted = (gain - plain + 0.5 * along_foretold).abs() <= (gain - plain).abs()

        growth = after.gradient - before.gradient
        slope = dots(step, growth)
        usable = taken & (slope > _LEAST * (dots(step, step) * dots(growth, growth)).sqrt())
        missing = growth - _times(after.matrix, step)
        along = dots(step, missing)
        # where more was learnt before than is seen now, it is shrunk first
        share = torch.where(along_foretold.abs() > along.abs(), along.abs() / along_foretold.abs(), 1.0)
        share = torch.where(usable, share, 1.0)[:, None]
        rest = torch.where(usable[:, None], missing - share * foretold, 0.0)
        growth = torch.where(usable[:, None], growth / slope[:, None], 0.0)
        outer = rest[..., None] * growth[:, None]
        update = outer + outer.mT - dots(rest, step)[:, None, None] * (growth[..., None] * growth[:, None])
        return MissingHessian(share[..., None] * self.matrix + update, torch.where(taken, trusted, self.trusted))


def _times(matrix: Float[Tensor, "batch n n"], vector: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n"]:
    return bmm(matrix, vector[..., None])[..., 0]
