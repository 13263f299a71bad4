"""The pulls of the points of one fit on its parameters, and how they scatter: (74) of docs/formulation.md."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from brafit.cup.base import Linearised
from brafit.fitting.normal import PointRows
from brafit.fitting.objective import Objective
from brafit.geometry.panels import Feet
from brafit.geometry.products import total

_NEIGHBOURS = 5
"""Neighbours from which a point's pull is foretold."""
_LEAF = 16
"""Points in a leaf of the tree that finds them."""
_ROUND = 0.02
"""Least width of a point's neighbours across, in parts of their squared width along: a plane through points in a row
would be any plane."""


@dataclass(frozen=True)
class Pulls:
    """The points of one problem, panel by panel, without those that only fill the batch.

    Attributes:
        points, weights: the cloud.
        feet, directions, distances: nearest points, and signed distances from them along these unit vectors.
        slope: Gauss-Newton weights: slope times distance is the objective's derivative by the distance.
        jacobian: derivatives of the distances, columns as in `Linearised`, in single precision.
        edges, tangents, stations: of the cup.
        table: derivatives of its samples.
    """

    points: Float[Tensor, "points 3"]
    weights: Float[Tensor, " points"]
    feet: Feet
    directions: Float[Tensor, "points 3"]
    distances: Float[Tensor, " points"]
    slope: Float[Tensor, " points"]
    jacobian: Float[Tensor, "points columns"]
    edges: Float[Tensor, "edges stations 3"]
    tangents: Float[Tensor, "edges stations 3"]
    stations: Float[Tensor, " stations"]
    table: Float[Tensor, "rows 3 columns"]

    @staticmethod
    def each(objective: Objective, linear: Linearised, rows: PointRows, problems: slice) -> Iterator[Pulls]:
        """Those of some problems in turn. `linear`: of all; `rows`: of these."""
        targets, shape = objective.targets, linear.shape
        for k, order in enumerate(rows.order):
            own = problems.start + k
            order = order[targets.weights[own][order] > 0]
            count, one = len(order), slice(k, k + 1)
            table = rows.table[k].float()
            yield Pulls(
                points=targets.points[own][order],
                weights=targets.weights[own][order],
                feet=rows.feet.at((k, order)),
                directions=rows.directions[k, :count],
                distances=rows.distances[k, :count],
                slope=rows.slope[k, :count],
                jacobian=rows.sums.part((one, slice(0, count))).jacobian(table[None])[0],
                edges=shape.edges[own],
                tangents=shape.tangents[own],
                stations=shape.stations,
                table=table,
            )

    def scatter(self) -> Float[Tensor, "columns columns"]:
        """Covariance of the sum of the pulls; 0 for too few points.

        A pull counts by how much it differs from what a plane through its neighbours' foretells. What a point weighs is
        its share of the surface, which is no noise: pulls are compared by weight.
        """
        if len(self.points) <= _NEIGHBOURS:
            return self.jacobian.new_zeros(self.jacobian.shape[1], self.jacobian.shape[1])
        near, foretold = _foretelling(self.points, self.directions)
        own = self.weights / (1 + foretold.square().sum(1)).sqrt()
        each = self.jacobian * (self.slope * self.distances / self.weights).to(self.jacobian)[:, None]
        factor = torch.cat((own[:, None], -own[:, None] * foretold), dim=1).to(each)
        rest = torch.nn.functional.embedding_bag(near, each, mode="sum", per_sample_weights=factor)
        return rest.mT @ rest


def _foretelling(
    points: Float[Tensor, "points 3"], directions: Float[Tensor, "points 3"]
) -> tuple[Int[Tensor, "points all"], Float[Tensor, "points others"]]:
    """Each point and its neighbours, and the share of each neighbour in the value that a plane through theirs has at
    the point, as seen along the point's direction.
    """
    places = points.cpu().numpy()
    near = np.asarray(KDTree(places, leafsize=_LEAF).query(places, k=_NEIGHBOURS + 1)[1])
    found = torch.as_tensor(near, device=points.device)
    others = found[:, 1:].mT.contiguous()
    offset = [own.take(others) - own for own in points.mT.contiguous()]
    # two axes across the direction, the first of them upright on the coordinate axis that is most across it
    least = torch.nn.functional.one_hot(directions.abs().argmin(-1), 3).to(directions)
    first = torch.nn.functional.normalize(torch.linalg.cross(directions, least), dim=-1)
    axes = first.mT.contiguous(), torch.linalg.cross(directions, first).mT.contiguous()
    flat = [total([one * along for one, along in zip(offset, axis, strict=True)]) for axis in axes]
    a, b = (total(list(one)) / _NEIGHBOURS for one in flat)
    x, y = flat[0] - a, flat[1] - b
    xx, xy, yy = (total(list(one)) for one in (x * x, x * y, y * y))
    least_width = _ROUND * (xx + yy)
    xx, yy = xx + least_width, yy + least_width
    scale = 1 / (xx * yy - xy * xy).clamp_min(1e-300)
    shares = 1 / _NEIGHBOURS - x * (scale * (yy * a - xy * b)) - y * (scale * (xx * b - xy * a))
    return found, shares.mT
