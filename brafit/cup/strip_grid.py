"""The nodes along the wire on which strips are computed."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from brafit.cup.wire import LENGTH, Wire
from brafit.geometry.developable import dot, unit
from brafit.geometry.grid import chebyshev_analysis, chebyshev_synthesis, like
from brafit.geometry.products import apply
from brafit.geometry.strip import Nodes


class StripGrid(nn.Module):
    """Nodes with their operators and bases, and the wires there: positions, reference frame (V the chest's normal made
    orthogonal to T), rates.
    """

    s: Tensor
    x: Tensor
    derivative: Tensor
    integral: Tensor
    analysis: Tensor
    bump: Tensor
    bump_slope: Tensor
    bases: Tensor
    edge: Tensor
    T: Tensor
    U: Tensor
    V: Tensor
    speed: Tensor
    k1: Tensor
    k2: Tensor
    w: Tensor
    WIRE = ("edge", "T", "U", "V", "speed", "k1", "k2", "w")

    def __init__(self, tensors: dict[str, Tensor]):
        super().__init__()
        for name, value in tensors.items():
            self.register_buffer(name, value, persistent=False)

    @staticmethod
    def of(wire: Wire, terms: int, nodes: int) -> "StripGrid":
        """The grid of `nodes` nodes on these wires, with bases of `terms` Chebyshev polynomials."""
        some, operators = wire.coefficients, Nodes.of(nodes, LENGTH)
        x = 2 * operators.s / LENGTH - 1
        arrays = {
            "s": operators.s,
            "x": x,
            "derivative": operators.derivative,
            "integral": operators.integral,
            "analysis": chebyshev_analysis(nodes),
            "bump": 1 - x * x,
            "bump_slope": -4 / LENGTH * x,
        }
        constants = {name: like(value, some) for name, value in arrays.items()}
        constants["bases"] = torch.stack([basis.to(some) for basis in chebyshev_bases(terms, torch.from_numpy(x))])
        position, first, second = (wire.sample(constants["s"], k) for k in range(3))
        speed = first.norm(dim=-1)
        T = first / speed[..., None]
        normal = torch.zeros_like(T)
        normal[..., 2] = 1
        V = unit(normal - dot(normal, T)[..., None] * T)
        U = torch.linalg.cross(V, T)
        turning = (second - dot(second, T)[..., None] * T) / speed[..., None]
        twisting = -dot(apply(constants["derivative"], V), U)
        rates = {"speed": speed, "k1": dot(turning, U), "k2": dot(turning, V), "w": twisting}
        return StripGrid({**constants, "edge": position, "T": T, "U": U, "V": V, **rates})

    def select(self, index: Tensor) -> "StripGrid":
        """The grid on the wires with these batch indices."""
        return StripGrid({name: v[index] if name in self.WIRE else v for name, v in self.named_buffers()})


def chebyshev_bases(terms: int, x: Float[Tensor, " n"]) -> tuple[Float[Tensor, "terms n"], ...]:
    """Chebyshev polynomials at x in [-1, 1], and their first and second derivatives by s.

    Args:
        terms: how many polynomials.
        x: places in [-1, 1].
    """
    points = x.cpu().double().numpy()
    return tuple(like(chebyshev_synthesis(terms, points, k).T * (2 / LENGTH) ** k, x) for k in range(3))
