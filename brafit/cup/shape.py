"""The face that every cup model shows: edges and the rulings between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

from jaxtyping import Float
from torch import Tensor

from brafit.geometry.developable import regularity


@dataclass(frozen=True)
class CupShape:
    """A chain of ruled panels, sampled at common stations along the wire.

    Edge 0 is the wire, edge `panels` the upper line, those between are ridges; panel i lies between
    edges i and i + 1, and the ruling of panel i at station k joins the two edges' k-th samples. Both ends of
    all edges meet in the wire's ends. Lengths are in whatever unit the wire was given in.

    Attributes:
        stations: wire arc length s of the samples, increasing, first 0, last the wire length.
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

    def map(self, function: Callable[[Tensor], Tensor]) -> "CupShape":
        """The shape with `function` applied to every batched tensor (for indexing, detaching, moving)."""
        batched = [f.name for f in fields(self) if f.name != "stations"]
        return replace(self, **{name: function(getattr(self, name)) for name in batched})
