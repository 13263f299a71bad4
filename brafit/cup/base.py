"""What every cup model has in common."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from brafit.cup.edge_gaps import Gaps
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, Lines, Wire
from brafit.geometry.development import FlatPanel
from brafit.geometry.panels import sample_table


@dataclass(frozen=True)
class Linearised:
    """B cups and the derivatives of what a fit needs of them, by some of the parameters.

    Attributes:
        shape: the cups at the stations that solvers work with, see `Cup.sketch`.
        table: derivatives of `brafit.geometry.panels.sample_table` of the shape.
        margin, margin_columns: regularity margin of every panel at every station, and its derivatives.
        unfairness, unfairness_columns: `Cup.unfairness` and its derivatives.
        constraints: derivatives of `Cup.constraints`.
        columns: places in the flat matrix of the parameters that the derivatives' last dimension runs over.
        reach: how many of these, the first ones, each panel depends on.
    """

    shape: CupShape
    table: Float[Tensor, "batch rows 3 columns"]
    margin: Float[Tensor, "batch panels n"]
    margin_columns: Float[Tensor, "batch panels n columns"]
    unfairness: Float[Tensor, "batch m"]
    unfairness_columns: Float[Tensor, "batch m columns"]
    constraints: dict[str, Tensor]
    columns: Int[Tensor, " columns"]
    reach: tuple[int, ...]


def derivatives(
    function: Callable[[Tensor], tuple[Tensor, ...]],
    at: Float[Tensor, "batch size"],
    columns: Int[Tensor, " columns"] | None = None,
) -> tuple[Tensor, ...]:
    """Derivatives of a batched function by each of the parameters, or by some, forward mode: (columns, *output) for
    each output.

    Args:
        function: from parameters (batch, size) to tensors whose item k depends on row k alone.
        at: the parameters.
        columns: the parameters by which; None: all.
    """
    directions = torch.eye(at.shape[1], dtype=at.dtype, device=at.device)
    directions = directions if columns is None else directions[columns]
    directions = directions[:, None].expand(-1, *at.shape)
    with torch.enable_grad():  # what is iterated is differentiable in grad mode only
        return torch.func.vmap(lambda d: torch.func.jvp(function, (at,), (d,))[1])(directions)


class Cup(nn.Module, ABC):
    """B cups of one model on B wires: a module from points to their distances, in millimetres.

    The parameters of all cups are held as named `nn.Parameter`s with a leading batch dimension, each as a multiple of
    its `steps`. Solvers see them as one matrix (B, size) in solver units (every wire is pi long), made by `flatten` and
    read by `shape_of`.

    Args:
        wire: the wire lines of B cups: a `Wire`, or what `Wire.of` takes, in millimetres in the cup frame.
        panels: number of panels.
        stations: samples along the wire.

    Raises:
        ValueError: no panel, fewer than 9 stations, or points that make no wire.
    """

    corner_place = -1
    """Which parameter is the place of the upper edge's corner; -1: none."""
    constrained = True
    """Whether `constraints` are left, which a solver has to satisfy. Without any it can raise other weights until a
    limit is kept, and the optimum has derivatives.
    """
    developable = False
    """Whether panels are developable whatever the parameters, up to the grid behind `shape_of`."""
    stations: Tensor
    terms: int

    def __init__(self, wire: Wire | Lines, panels: int, stations: int):
        super().__init__()
        wire = Wire.of(wire)
        if panels < 1:
            raise ValueError(f"a cup needs at least 1 panel, got {panels}")
        if stations < 9:
            raise ValueError(f"a cup needs at least 9 stations, got {stations}")
        self.wire = wire
        self.panels = panels
        like = wire.coefficients
        self.register_buffer("stations", torch.linspace(0, LENGTH, stations, dtype=like.dtype, device=like.device))
        self.register_load_state_dict_post_hook(_read_wire)

    @abstractmethod
    def read_wire(self) -> None:
        """Compute anew what is derived from the wires."""

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

        The upper edge of panel i is to run near the plane through the wire's chord that is turned by angles[i]
        radians from +x (down) over +z (out), and reach out as far as reaches[i] from the chord.

        Args:
            angles: for each panel's upper edge, radians.
            reaches: likewise, solver units.
        """

    @abstractmethod
    def select(self, index: Tensor) -> "Cup":
        """The cups with these batch indices (repetitions allowed)."""

    @abstractmethod
    def on(self, wire: Wire) -> "Cup":
        """Cups with the same parameters on these wires, one each, in the wires' precision and place."""

    @abstractmethod
    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        """Equations that a shape of this model, in solver units, must satisfy to be a cup, by name; empty where the
        model satisfies them itself.

        Scaled so that the sum of squares over m is a mean square.
        """

    def closure(self, shape: CupShape) -> Float[Tensor, "batch m"] | None:
        """Those constraints that few enough equations make up for a solver to fulfil them to round-off; None where
        there are none.
        """
        return None

    @abstractmethod
    def unfairness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        """Residuals whose squares add up to how much the curvature of the flat edges varies."""

    @property
    def spans(self) -> Float[Tensor, " m"] | None:
        """For each residual of `unfairness` the span of s over which it is a change of curvature. None: they are no
        changes of curvature.
        """
        return None

    @property
    def steps(self) -> Float[Tensor, " size"]:
        """How far each parameter goes for a change of the cup that is about as large as the others': powers of two, so
        that parameters held as multiples of them are not rounded. An optimiser that moves all alike, such as Adam,
        needs them.
        """
        return self.stations.new_ones(self.size)

    def plain(
        self, height: Float[Tensor, " batch"]
    ) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " size"]] | None:
        """The parameters of the plainest cups of the model, if it has any, and how much each counts where cups are
        otherwise equal.

        Args:
            height: mean height of each breast over its wire's plane, solver units.
        """
        return None

    def sketch(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        """The cups at the stations that solvers work with, which may be fewer than those of `shape_of`; by default they
        are the same.
        """
        return self.shape_of(flat)

    def columns(self, terms: int | None = None) -> Int[Tensor, " columns"]:
        """Places in the flat matrix, increasing, of the parameters that are free while series have this many terms
        (None: all there are).
        """
        return torch.arange(self.size, device=self.stations.device)

    def corner_gap(
        self, flat: Float[Tensor, "batch size"], shape: CupShape, points: Float[Tensor, "batch 3"]
    ) -> Gaps | None:
        """From points to the upper edge's corner; None for models without one.

        Args:
            flat: parameters of the cups.
            shape: the cups at the solver's stations.
            points: one a cup, solver units.
        """
        return None

    def place_corner(
        self, flat: Float[Tensor, "batch size"], points: Float[Tensor, "batch 3"], given: Bool[Tensor, " batch"]
    ) -> Float[Tensor, "batch size"]:
        """The parameters with the upper edge's corner, if the model has one, brought near the strap points that are
        given.

        Args:
            flat: parameters of the cups.
            points: strap points, solver units.
            given: for which cups there is one.
        """
        return flat

    def refined(self) -> "Cup":
        """The same cups with a finer grid behind `shape_of`; themselves where there is none."""
        return self

    def finer(self) -> "Cup":
        """The same cups with a finer grid for the fit; themselves where there is none."""
        return self

    @torch.no_grad()
    def linearise(self, flat: Float[Tensor, "batch size"], terms: int | None = None) -> Linearised:
        """The cups and their derivatives by the parameters that are free with this many terms (all by default).

        Args:
            flat: parameters of the cups.
            terms: free terms of the series; None: all.
        """
        columns = self.columns(terms)
        shape = self.sketch(flat)
        names = list(self.constraints(shape))

        def parts(at: Tensor) -> tuple[Tensor, ...]:
            own = self.sketch(at)
            constraints = self.constraints(own)
            table = sample_table(own.edges, own.tangents)
            return table, own.margin, self.unfairness(at), *(constraints[k] for k in names)

        table, margin, unfairness, *others = (v.movedim(0, -1) for v in derivatives(parts, flat, columns))
        return Linearised(
            shape=shape,
            table=table.contiguous(),
            margin=shape.margin,
            margin_columns=margin,
            unfairness=self.unfairness(flat),
            unfairness_columns=unfairness,
            constraints=dict(zip(names, others, strict=True)),
            columns=columns,
            reach=(len(columns),) * self.panels,
        )

    def forward(self, points: Tensor) -> Float[Tensor, "batch points"]:
        """Signed distances of points to the cups, mm, positive outside.

        Differentiable once, in parameters and points (see `CupShape.distances`).

        Args:
            points: (batch, points, 3) in the cup frame, mm, in the cup's precision and place. Clouds of different size
                are padded with nan, and so are their distances: `nanmean` leaves them out.

        Raises:
            ValueError: points of another shape, precision or place.
        """
        if points.ndim != 3 or len(points) != self.batch or points.shape[-1] != 3:
            raise ValueError(f"points must be ({self.batch}, n, 3), one cloud for each cup, got {(*points.shape,)}")
        own = self.stations
        if (points.dtype, points.device) != (own.dtype, own.device):
            got, wanted = (f"{tensor.dtype} on {tensor.device}" for tensor in (points, own))
            raise ValueError(f"points are {got}, the cup is {wanted}: give points.to(cup.stations)")
        return self.shape().distances(points)

    def shape(self) -> CupShape:
        """The cups as they stand in their cup frames, mm, differentiable in the parameters.

        s stays in solver units, in which all wires of a batch are pi long; tangents are mm per that.
        """
        return self.shape_of(self.flatten()).scaled(self.wire.scale)

    def patterns(self) -> FlatPanel:
        """The panels laid flat, mm: edges of shape (batch, panels, stations, 2), differentiable in the parameters."""
        return self.shape().flat()

    def margin(self) -> Float[Tensor, "batch panels stations"]:
        """Regularity margin of every ruling, differentiable in the parameters: 1 on a cylinder, negative where rulings
        cross.
        """
        return self.shape_of(self.flatten()).margin

    @property
    def batch(self) -> int:
        return len(self.wire)

    @property
    def size(self) -> int:
        """Number of parameters of one cup."""
        return sum(math.prod(shape) for shape in self.layout.values())

    def flatten(self) -> Float[Tensor, "batch size"]:
        return torch.cat([self.get_parameter(name).flatten(1) for name in self.layout], dim=1) * self.steps

    def split(self, flat: Float[Tensor, "batch size"]) -> dict[str, Tensor]:
        """Parameters by name from the flat matrix."""
        parts = flat.split([math.prod(shape) for shape in self.layout.values()], dim=1)
        return {name: part.unflatten(1, shape) for (name, shape), part in zip(self.layout.items(), parts, strict=True)}

    @torch.no_grad()
    def load_flat(self, flat: Float[Tensor, "batch size"]) -> None:
        for name, value in self.split(flat / self.steps).items():
            self.get_parameter(name).copy_(value)


def _read_wire(cup: nn.Module, _: object) -> None:
    """After a state is loaded, which may have other wires."""
    assert isinstance(cup, Cup)
    cup.read_wire()
