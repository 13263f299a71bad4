"""What every cup model has in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, Wire


class Cup(nn.Module, ABC):
    """B cups of one model on B wires, in solver units (every wire is pi long).

    The parameters of all cups are held as named `nn.Parameter`s with a leading batch dimension; solvers see them as one
    matrix (B, size), made by `flatten` and read by `shape_of`.
    """

    stations: Tensor

    def __init__(self, wire: Wire, panels: int, stations: int):
        super().__init__()
        if panels < 1:
            raise ValueError(f"a cup needs at least 1 panel, got {panels}")
        if stations < 9:
            raise ValueError(f"a cup needs at least 9 stations, got {stations}")
        self.wire = wire
        self.panels = panels
        like = wire.coefficients
        self.register_buffer("stations", torch.linspace(0, LENGTH, stations, dtype=like.dtype, device=like.device))

    @property
    @abstractmethod
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes (without the batch) of the parameters, in the order of `flatten`."""

    @abstractmethod
    def shape_of(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        """The cups with these parameters."""

    @abstractmethod
    def start(self, angles: Float[Tensor, "batch panels"], reaches: Float[Tensor, "batch panels"]) -> None:
        """Set the parameters to a plain start.

        The upper edge of panel i is to run near the plane through the wire's chord that is turned by angles[i] radians from +x (down)
        over +z (out), and reach out as far as reaches[i] from the chord.
        """

    @abstractmethod
    def select(self, index: Tensor) -> "Cup":
        """The cups with these batch indices (repetitions allowed)."""

    @abstractmethod
    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        """Equations that a shape of this model must satisfy to be a cup, by name; empty where the model satisfies them itself.

        Scaled so that the sum of squares over m is a mean square.
        """

    def closure(self, shape: CupShape) -> Float[Tensor, "batch m"] | None:
        """Those constraints that few enough equations make up for a solver to fulfil them to round-off; None where there are none."""
        return None

    @abstractmethod
    def roughness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        """Residuals whose squares tell how wavy the parameters are."""

    def forward(self) -> CupShape:
        return self.shape_of(self.flatten())

    @property
    def batch(self) -> int:
        return len(self.wire)

    @property
    def size(self) -> int:
        """Number of parameters of one cup."""
        return sum(math.prod(shape) for shape in self.layout.values())

    def flatten(self) -> Float[Tensor, "batch size"]:
        return torch.cat([self.get_parameter(name).flatten(1) for name in self.layout], dim=1)

    def split(self, flat: Float[Tensor, "batch size"]) -> dict[str, Tensor]:
        """Parameters by name from the flat matrix."""
        parts = flat.split([math.prod(shape) for shape in self.layout.values()], dim=1)
        return {name: part.unflatten(1, shape) for (name, shape), part in zip(self.layout.items(), parts)}

    @torch.no_grad()
    def load_flat(self, flat: Float[Tensor, "batch size"]) -> None:
        for name, value in self.split(flat).items():
            self.get_parameter(name).copy_(value)
