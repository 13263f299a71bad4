"""Cup model A, "frames": the paper's. Ridge and upper line are curves drawn by moving frames, (32), (44)-(52) of
docs/formulation.md.

The panels between the edges are ruled by joining equal s; they are developable only where det(zeta_a, zeta_b, g) = 0,
and the edges end in the wire's end only where (38), (39) hold: both are conditions of the fit (`ends`, `twist`).
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, Lines, Wire
from brafit.geometry.curve import gauss_points, integrate_curve
from brafit.geometry.developable import (
    curvature_vector,
    geodesic_curvature,
    normals,
    rulings,
    twist_determinant,
)
from brafit.geometry.products import evenly
from brafit.geometry.ritz import ritz_basis, ritz_sum
from brafit.geometry.rotation import product, rotation_exp

SHARE = 0.27
"""How much the unfairness of these cups counts beside that of strips: their panels are not developable yet."""


STEP = 1 / 16
"""Of all parameters, see `Cup.steps`: rates and first frames turn a whole edge."""


class FramesCup(Cup):
    """Cups whose edges above the wire are integrated from (omega_xi, omega_eta, v) and an initial frame each.

    Args:
        wire: the wire lines of B cups.
        panels: number of panels; each adds one edge.
        terms: Ritz terms of each of the three functions of an edge.
        stations: samples along the wire.
        basis: Ritz basis, see `brafit.geometry.ritz`.

    Parameters, as multiples of `steps`:
        coefficients (B, panels, 3, terms): Ritz coefficients of omega_xi, omega_eta and v, with s' = v^2 and
            omega_zeta = 0.
        turn (B, panels, 3): rotation vector that turns the reference frame (a buffer set by `start`) into Phi_0.
    """

    reference: Tensor
    _at_stations: Tensor
    _at_gauss: Tensor
    _wire_lines: Tensor

    def __init__(self, wire: Wire | Lines, panels: int = 2, terms: int = 6, stations: int = 101, basis: str = "cosine"):
        super().__init__(wire, panels, stations)
        self.terms, self.basis = terms, basis
        like = self.stations
        self.coefficients = nn.Parameter(like.new_zeros(self.batch, panels, 3, terms))
        self.turn = nn.Parameter(like.new_zeros(self.batch, panels, 3))
        frames = torch.eye(3, dtype=like.dtype, device=like.device).expand(self.batch, panels, 3, 3)
        self.register_buffer("reference", frames.clone())
        s = self.stations
        self.register_buffer("_at_stations", ritz_basis(basis, terms, s / LENGTH), persistent=False)
        at_gauss = ritz_basis(basis, terms, gauss_points(s).flatten() / LENGTH)
        self.register_buffer("_at_gauss", at_gauss, persistent=False)
        self.read_wire()

    def read_wire(self) -> None:
        wire_lines = torch.stack([self.wire.sample(self.stations, k) for k in range(3)])
        self.register_buffer("_wire_lines", wire_lines, persistent=False)

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        return {"coefficients": (self.panels, 3, self.terms), "turn": (self.panels, 3)}

    def shape_of(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        named = self.split(flat)
        coefficients = named["coefficients"]
        frame = product(rotation_exp(named["turn"]), self.reference)
        inside = ritz_sum(coefficients, self._at_gauss).unflatten(-1, (-1, 2))
        speed = inside[..., 2, :, :].square()
        omega = torch.stack((inside[..., 0, :, :], inside[..., 1, :, :], torch.zeros_like(speed)), dim=-1)
        wire, wire_tangent, wire_second = self._wire_lines.unbind(0)
        origin = wire[:, None, 0].expand(-1, self.panels, -1)
        frames, positions = integrate_curve(omega, speed, self.stations.diff(), frame, origin)

        omega_xi, omega_eta, v = ritz_sum(coefficients, self._at_stations).unbind(-2)
        xi, eta, zeta = frames.unbind(-1)
        own_tangents = zeta * v.square()[..., None]
        own_curvature = omega_eta[..., None] * xi - omega_xi[..., None] * eta
        edges = torch.cat((wire[:, None], positions), dim=1)
        tangents = torch.cat((wire_tangent[:, None], own_tangents), dim=1)
        wire_curvature = curvature_vector(wire_tangent, wire_second)
        curvature = torch.cat((wire_curvature[:, None], own_curvature), dim=1)[:, :-1]
        directions = rulings(edges[:, :-1], edges[:, 1:], tangents[:, :-1], tangents[:, 1:])
        lower = tangents[:, :-1]
        return CupShape(
            stations=self.stations,
            edges=edges,
            tangents=tangents,
            directions=directions,
            normals=normals(lower, directions),
            geodesic=geodesic_curvature(lower, curvature, directions),
        )

    def columns(self, terms: int | None = None) -> Int[Tensor, " columns"]:
        free = torch.ones(self.panels, 3, self.terms, dtype=torch.bool, device=self.stations.device)
        free[..., self.terms if terms is None else terms :] = False
        turn = free.new_ones(3 * self.panels)
        return torch.cat((free.flatten(), turn)).nonzero()[:, 0]

    @property
    def steps(self) -> Float[Tensor, " size"]:
        return self.stations.new_full((self.size,), STEP)

    def ends(self, shape: CupShape) -> Float[Tensor, "batch m"]:
        """Gap between each edge's end and the wire's end, (38), (39)."""
        return (shape.edges[:, 1:, -1] - shape.edges[:, :1, -1]).flatten(1)

    def twist(self, shape: CupShape) -> Float[Tensor, "batch m"]:
        """det(zeta_a, zeta_b, d) at the inner stations, (40), (41) pointwise."""
        inner = slice(1, -1)
        lower, upper = shape.tangents[:, :-1, inner], shape.tangents[:, 1:, inner]
        return twist_determinant(lower, upper, shape.directions[:, :, inner]).flatten(1)

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        twist = self.twist(shape)
        return {"ends": self.ends(shape), "twist": twist / twist.shape[1] ** 0.5}

    def closure(self, shape: CupShape) -> Float[Tensor, "batch m"]:
        return self.ends(shape)

    def unfairness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        """The series are rates of the edges themselves: each coefficient by the square of its order, and SHARE."""
        order = torch.arange(self.terms, dtype=self.stations.dtype, device=self.stations.device).square()
        parts = {name: order.new_zeros(shape) for name, shape in self.layout.items()}
        parts["coefficients"] = parts["coefficients"] + order
        return SHARE * flat * torch.cat([part.flatten() for part in parts.values()])

    @torch.no_grad()
    def start(self, angles: Float[Tensor, "batch panels"], reaches: Float[Tensor, "batch panels"]) -> None:
        """Circular arcs over the wire's chord, in planes turned about it; the ends meet exactly."""
        chord = self._wire_lines[0, :, -1].norm(dim=-1, keepdim=True)
        reach = reaches.clamp_min(1e-2 * LENGTH)
        radius = (reach.square() + chord.square() / 4) / (2 * reach)
        half = 2 * evenly(torch.atan2, 2 * reach, chord.expand_as(reach))
        arc = 2 * radius * half
        zero = torch.zeros_like(angles)
        outward = torch.stack((torch.cos(angles), zero, torch.sin(angles)), dim=-1)
        along = torch.stack((zero, torch.ones_like(zero), zero), dim=-1)
        sine, cosine = torch.sin(half)[..., None], torch.cos(half)[..., None]
        zeta = sine * outward + cosine * along
        xi = sine * along - cosine * outward
        self.reference.copy_(torch.stack((xi, torch.linalg.cross(zeta, xi), zeta), dim=-1))
        flat = self.reference.new_zeros(self.batch, self.size)
        coefficients = self.split(flat)["coefficients"]
        coefficients[:, :, 1, 0] = 1 / radius
        coefficients[:, :, 2, 0] = (arc / LENGTH).sqrt()
        self.load_flat(flat)

    def select(self, index: Tensor) -> "FramesCup":
        return self._on(self.wire.select(index), index)

    def on(self, wire: Wire) -> "FramesCup":
        return self._on(wire, torch.arange(self.batch, device=self.stations.device))

    def _on(self, wire: Wire, index: Tensor) -> "FramesCup":
        cup = FramesCup(wire, self.panels, self.terms, self.stations.shape[0], self.basis)
        cup.load_flat(self.flatten().detach()[index])
        cup.reference.copy_(self.reference[index])
        return cup.to(wire.coefficients)
