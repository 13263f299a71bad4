"""Places on a chain of ruled panels, as weighted sums of samples of the edges.

Panel i is X(s, u) = (1 - u) a(s) + u b(s), (56) of docs/formulation.md, with a and b its edges, which run between
stations as cubic Hermite curves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.developable import unit
from brafit.geometry.hermite import hermite, hermite_slope
from brafit.geometry.products import weighted_rows

Points = Float[Tensor, "*batch points 3"]
Edges = Float[Tensor, "*batch edges n 3"]


@dataclass(frozen=True)
class Feet:
    """Where on the panels the nearest points lie.

    Attributes:
        panel: index of the nearest panel: 0 is the one at the wire.
        interval: index of the interval between stations.
        tau: place in that interval, in [0, 1].
        u: place on the ruling, 0 at the lower edge and 1 at the upper.
    """

    panel: Int[Tensor, "*batch points"]
    interval: Int[Tensor, "*batch points"]
    tau: Float[Tensor, "*batch points"]
    u: Float[Tensor, "*batch points"]

    def at(self, index: Any) -> "Feet":
        """Some of the feet."""
        return Feet(self.panel[index], self.interval[index], self.tau[index], self.u[index])

    def arc(self, stations: Float[Tensor, " n"]) -> Float[Tensor, "*batch points"]:
        """Wire arc length s* of the feet."""
        start = stations[self.interval]
        return start + self.tau * (stations[self.interval + 1] - start)

    def on(self, stations: Float[Tensor, " n"], others: Float[Tensor, " m"]) -> "Feet":
        """The same feet on panels that are sampled at other stations.

        Args:
            stations: s of the samples that the feet refer to.
            others: s of the samples that they shall refer to, over the same range.
        """
        arc = self.arc(stations)
        interval = (torch.searchsorted(others, arc, right=True) - 1).clamp(0, len(others) - 2)
        start = others[interval]
        return Feet(self.panel, interval, ((arc - start) / (others[interval + 1] - start)).clamp(0, 1), self.u)


def stencil(
    feet: Feet, stations: Float[Tensor, " n"], edge_count: int, slope: bool = False
) -> tuple[Int[Tensor, "*batch points 8"], Float[Tensor, "*batch points 8"]]:
    """The surface points as weighted sums of samples: indices into `sample_table` and weights.

    Args:
        feet: where on the panels.
        stations: s of the samples, increasing.
        edge_count: edges, one more than panels.
        slope: the weights of the derivative dX/dtau instead of X.
    """
    n = stations.shape[0]
    h = stations[feet.interval + 1] - stations[feet.interval]
    weights = (hermite_slope if slope else hermite)(feet.tau, h)
    lower = feet.panel * n + feet.interval
    tangents = edge_count * n
    own = torch.stack((lower, lower + 1, lower + tangents, lower + tangents + 1), dim=-1)
    u = feet.u[..., None]
    return torch.cat((own, own + n), dim=-1), torch.cat(((1 - u) * weights, u * weights), dim=-1)


def sample_table(edges: Edges, tangents: Edges) -> Float[Tensor, "*batch rows 3"]:
    """Positions of all edges' samples, then their tangents: the rows that `stencil` indexes."""
    return torch.cat((edges.flatten(-3, -2), tangents.flatten(-3, -2)), dim=-2)


def gather_rows(
    table: Float[Tensor, "*batch rows k"], index: Int[Tensor, "*batch p m"]
) -> Float[Tensor, "*batch p m k"]:
    """Rows of each batch item's table, for two trailing dimensions of indices.

    Args:
        table: for each batch item.
        index: m rows for each of p places.
    """
    flat = index.flatten(-2)[..., None].expand(*index.shape[:-2], -1, table.shape[-1])
    return table.gather(-2, flat).unflatten(-2, index.shape[-2:])


def weighted(weight: Float[Tensor, "*batch p m"], rows: Float[Tensor, "*batch p m k"]) -> Float[Tensor, "*batch p k"]:
    """Weighted sums of rows."""
    return (weight[..., None, :] @ rows)[..., 0, :]


def surface_points(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """X(s*, u*): differentiable in the edges, with the feet held fixed.

    Args:
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        feet: places on these panels.
    """
    index, weight = stencil(feet, stations, edges.shape[-3])
    return weighted(weight, gather_rows(sample_table(edges, tangents), index))


def surface_normals(edges: Edges, tangents: Edges, stations: Float[Tensor, " n"], feet: Feet) -> Points:
    """Unit normals X_s x X_u at the feet, outward for a cup: eta = zeta x xi.

    Args:
        edges: positions of all edges at the stations, from the wire up.
        tangents: their derivatives by s.
        stations: s of the samples, increasing.
        feet: places on these panels.
    """
    rows = sample_table(edges, tangents)
    index, slope = stencil(feet, stations, edges.shape[-3], slope=True)
    samples = gather_rows(rows, index)
    along = weighted(slope, samples)
    h = stations[feet.interval + 1] - stations[feet.interval]
    bare = hermite(feet.tau, h)
    ruling = weighted(bare, samples[..., 4:, :] - samples[..., :4, :])
    return unit(torch.linalg.cross(along, ruling))


@dataclass(frozen=True)
class Sums:
    """Signed distances m . (p - X*) as sums over coordinates of samples, the feet held: what depends on the cup is the
    sum over k of weight[k] * coordinate[index[k]], from `sample_table` with its last two dimensions as one.

    Attributes:
        index, weight: of each point's 24 coordinates.
    """

    index: Int[Tensor, "*batch points 24"]
    weight: Float[Tensor, "*batch points 24"]

    @staticmethod
    def of(directions: Points, feet: Feet, stations: Float[Tensor, " n"], edge_count: int) -> "Sums":
        """`directions`: unit vectors m from `project` or `foot_directions`."""
        index, weight = stencil(feet, stations, edge_count)
        components = torch.arange(3, device=index.device, dtype=torch.int32)
        # 32 bits are enough for the rows of any table that fits into memory, and half the traffic.
        index = (index.int() * 3)[..., None] + components
        return Sums(index.flatten(-2), (weight[..., None] * -directions[..., None, :]).flatten(-2))

    def part(self, which: tuple[slice, slice]) -> "Sums":
        """Those of some problems and points."""
        return Sums(self.index[which], self.weight[which])

    def gradient(
        self, force: Float[Tensor, "*batch points"], table_jacobian: Float[Tensor, "*batch rows 3 size"]
    ) -> Float[Tensor, "*batch size"]:
        """Gradient of the sum of force * distance by the parameters, without a row for each point.

        Args:
            force: the value's derivative by each distance.
            table_jacobian: derivatives of `sample_table` by the parameters.
        """
        *batch, rows, _, size = table_jacobian.shape
        problem = 3 * rows * torch.arange(math.prod(batch), device=force.device).view(*batch, 1, 1)
        pull = force.new_zeros(math.prod(batch) * 3 * rows)
        pull.scatter_add_(0, (self.index + problem).flatten(), (force[..., None] * self.weight).flatten())
        table = table_jacobian.reshape(-1, 3 * rows, size)
        return weighted_rows(pull.view(-1, 3 * rows), table).view(*batch, size)

    def jacobian(self, table_jacobian: Float[Tensor, "*batch rows 3 size"]) -> Float[Tensor, "*batch points size"]:
        """Derivatives of the distances by the parameters, in the precision of the table's derivatives."""
        *batch, rows, _, size = table_jacobian.shape
        problem = 3 * rows * torch.arange(math.prod(batch), device=self.index.device, dtype=torch.int32)
        bags = torch.nn.functional.embedding_bag(
            (self.index + problem.view(*batch, 1, 1)).reshape(-1, 24),
            table_jacobian.reshape(-1, size),
            mode="sum",
            per_sample_weights=self.weight.to(table_jacobian).reshape(-1, 24),
        )
        return bags.view(*batch, -1, size)
