"""What the Gauss-Newton matrix leaves out of the Hessian, learnt from the steps (Dennis, Gay and Welsch, An adaptive
nonlinear least-squares algorithm, 1981).

Where residuals are large, as a cup's few millimetres are, their own bending counts: plain Gauss-Newton steps then close
in slowly. How the gradient changes over a step tells of it, one direction a step.
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
class Bending:
    """The missing part of B Hessians.

    Attributes:
        matrix: symmetric; zero before the first step.
        trusted: where the last step came out nearer to what the model with it had foretold than to what the one without
            it had.
    """

    matrix: Float[Tensor, "batch n n"]
    trusted: Bool[Tensor, " batch"]

    @staticmethod
    def none(model: Normal) -> Bending:
        """Before the first step."""
        return Bending(torch.zeros_like(model.matrix), torch.ones_like(model.value, dtype=torch.bool))

    def select(self, index: Int[Tensor, " some"]) -> Bending:
        """The problems with these batch indices."""
        return Bending(self.matrix[index], self.trusted[index])

    def of(self) -> Float[Tensor, "batch n n"]:
        """What to add to the Gauss-Newton matrices."""
        return torch.where(self.trusted[:, None, None], self.matrix, 0.0)

    def learnt(
        self, before: Normal, after: Normal, step: Float[Tensor, "batch n"], taken: Bool[Tensor, " batch"]
    ) -> Bending:
        """After a step from one model's place to another's.

        Args:
            before: the model where the step began.
            after: the model where it ended.
            step: the change of the parameters.
            taken: which problems took their step; the others learn nothing.
        """
        bent = _times(self.matrix, step)
        plain = -dots(before.gradient, step) - 0.5 * dots(step, _times(before.matrix, step))
        gain, along_bent = before.value - after.value, dots(step, bent)
        trusted = (gain - plain + 0.5 * along_bent).abs() <= (gain - plain).abs()

        growth = after.gradient - before.gradient
        slope = dots(step, growth)
        usable = taken & (slope > _LEAST * (dots(step, step) * dots(growth, growth)).sqrt())
        missing = growth - _times(after.matrix, step)
        along = dots(step, missing)
        # where more was learnt before than is seen now, it is shrunk first
        share = torch.where(along_bent.abs() > along.abs(), along.abs() / along_bent.abs(), 1.0)
        share = torch.where(usable, share, 1.0)[:, None]
        rest = torch.where(usable[:, None], missing - share * bent, 0.0)
        growth = torch.where(usable[:, None], growth / slope[:, None], 0.0)
        outer = rest[..., None] * growth[:, None]
        update = outer + outer.mT - dots(rest, step)[:, None, None] * (growth[..., None] * growth[:, None])
        return Bending(share[..., None] * self.matrix + update, torch.where(taken, trusted, self.trusted))


def _times(matrix: Float[Tensor, "batch n n"], vector: Float[Tensor, "batch n"]) -> Float[Tensor, "batch n"]:
    return bmm(matrix, vector[..., None])[..., 0]
