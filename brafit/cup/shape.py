"""The face that every cup model shows: edges and the rulings between them.

Numbers in parentheses are equations of docs/formulation.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.developable import dot, regularity, rib_angle
from brafit.geometry.development import FlatPanel, develop
from brafit.geometry.nearest import project
from brafit.geometry.panels import surface_points


@dataclass(frozen=True)
class CupShape:
    """A chain of ruled panels, sampled at common stations along the wire.

    Edge 0 is the wire, edge `panels` the upper line, those between are ridges; panel i lies between
    edges i and i + 1, and the ruling of panel i at station k joins the two edges' k-th samples. Both ends of
    all edges meet in the wire's ends. Lengths are in solver units, or millimetres.

    Attributes:
        stations: places s of the samples along the wire, increasing, from 0. s is the wire's arc length; in solver
            units where a batch is in millimetres (`Cup.shape`), since its wires differ in length and share s.
        edges: positions of the edges.
        tangents: derivatives d edge / ds (not of unit length, except the wire's).
        directions: unit ruling directions d, from the lower to the upper edge; at the two wire ends,
            where the ruling shrinks to a point, their limits.
        normals: unit surface normals eta of each panel along its lower edge.
        geodesic: geodesic curvature omega_eta of each panel's lower edge, in that panel, per unit of the
            edge's own arc length.
    """

    stations: Float[Tensor, " n"]
    edges: Float[Tensor, "*batch edges n 3"]
    tangents: Float[Tensor, "*batch edges n 3"]
    directions: Float[Tensor, "*batch panels n 3"]
    normals: Float[Tensor, "*batch panels n 3"]
    geodesic: Float[Tensor, "*batch panels n"]

    @property
    def panels(self) -> int:
        return self.directions.shape[-3]

    @property
    def lengths(self) -> Float[Tensor, "*batch panels n"]:
        """Ruling lengths t_max."""
        return (self.edges[..., 1:, :, :] - self.edges[..., :-1, :, :]).norm(dim=-1)

    @property
    def margin(self) -> Float[Tensor, "*batch panels n"]:
        """Regularity margin of every ruling, see `regularity`."""
        lower, upper = self.tangents[..., :-1, :, :], self.tangents[..., 1:, :, :]
        return regularity(lower, upper, self.directions)

    def flat(self) -> FlatPanel:
        """All panels laid flat, (20)-(25), with a dimension of panels before that of the stations."""
        lower = self.tangents[..., :-1, :, :]
        rib = rib_angle(lower, self.directions)
        return develop(self.stations, lower.norm(dim=-1), self.geodesic, rib, self.lengths)

    def distances(
        self, points: Float[Tensor, "*batch m 3"], coarse: "CupShape | None" = None
    ) -> Float[Tensor, "*batch m"]:
        """Signed distances of points to the cups, positive outside, in the unit of the edges.

        Differentiable once, in the edges and in the points: the nearest points on the cup are found without
        derivatives, which the distance does not need to first order (the envelope theorem). Second derivatives through
        it are not those of the distance.

        Args:
            points: rows with a number that is not finite are padding: their distance is nan, without a gradient.
            coarse: the same cups on fewer stations, where the nearest rulings are sought first.
        """
        known = points.isfinite().all(-1)
        points = torch.where(known[..., None], points, 0.0)
        near = None
        if coarse is not None and len(coarse.stations) < len(self.stations):
            found = project(points, coarse.edges, coarse.tangents, coarse.stations, iterations=2).feet
            near = found.on(coarse.stations, self.stations)
        found = project(points, self.edges, self.tangents, self.stations, 8 if near is None else 3, near)
        distances = found.distances
        if torch.is_grad_enabled() and (points.requires_grad or self.edges.requires_grad):
            feet = surface_points(self.edges, self.tangents, self.stations, found.feet)
            distances = dot(points - feet, found.directions)
        return torch.where(known, distances, torch.nan)

    def scaled(self, scale: Float[Tensor, "*batch"]) -> "CupShape":
        """The cups with every length times `scale`; s stays as it is."""
        edges, panels = scale[..., None, None, None], scale[..., None, None]
        return replace(self, edges=self.edges * edges, tangents=self.tangents * edges, geodesic=self.geodesic / panels)

    def map(self, function: Callable[[Tensor], Tensor]) -> "CupShape":
        """The shape with `function` applied to every batched tensor (for indexing, detaching, moving)."""
        batched = [f.name for f in fields(self) if f.name != "stations"]
        return replace(self, **{name: function(getattr(self, name)) for name in batched})
