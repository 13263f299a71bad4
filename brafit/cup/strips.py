"""Cup model B, "strips": developable by construction. Panels have the parameters, and each panel makes the next edge.

Per panel: the angle at which it leaves its lower edge in the middle, and series for the rib angle and the logarithm of
the ruling length. See `brafit.geometry.strip` for the equations. Both ends of all edges meet in the wire's ends, and
developability holds, up to the spectral error of the nodes; no constraint is left.
"""

from __future__ import annotations

import copy
import math
from functools import cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from brafit.cup.base import Cup, Linearised
from brafit.cup.corner import CORNER_REACH, CORNER_SIZE, corner_gap, cornered
from brafit.cup.edge_gaps import Gaps
from brafit.cup.plain import HEIGHT, lines, term_counts
from brafit.cup.shape import CupShape
from brafit.cup.strip_chain import chain_shape, march, series
from brafit.cup.strip_derivatives import linearised
from brafit.cup.strip_grid import StripGrid, chebyshev_bases
from brafit.cup.wire import LENGTH, Lines, Wire
from brafit.geometry.developable import unit
from brafit.geometry.grid import like
from brafit.geometry.nearest import nearest_on_curve
from brafit.geometry.products import apply, apply_row, evenly
from brafit.geometry.strip import (
    Nodes,
)

STEP_ORDER = 3.0
"""From about this order on terms change a cup ever more."""
JUMP_COUNT = 0.43
"""How much the jump at the upper edge's corner counts in `Cup.plain`, times the root of the number of panels. What is
plain counts over that number: so the jump counts alike with any. Free, it would wander with the corner's place."""
CORNER_TERMS = 6
"""Terms from which on the corner is free: before, the edge is too rough to tell where it belongs."""


class StripsCup(Cup):
    """Cups whose panels are exact developable strips, each built on the edge below it.

    Args:
        wire: the wire lines of B cups.
        panels: number of panels.
        terms: terms of both series of a panel (Chebyshev polynomials of the wire's arc length).
        stations: samples of the output along the wire, evenly spaced.
        nodes: Chebyshev nodes of the fit.
        output_nodes: Chebyshev nodes of the output: as many as make it exact.

    Parameters, as multiples of `steps`:
        angle (B, panels): phi_0, the angle by which each panel leaves the reference normal in the middle of its lower
            edge: the chest's normal at the wire, the panel below at the ridges.
        rib (B, panels, terms): series of the rib angle before its bound.
        length (B, panels, terms): series of log(t / (1 - x^2)), t the ruling length, x in [-1, 1] along the wire.
        corner (B, 3): c, d and x0 of the terms c |x - x0| + d (x - x0) |x - x0| / 2 (rounded off) in the last panel's
            log length: the upper edge may have one corner, and its own curvature on either side.

    Raises:
        ValueError: no panel, fewer than 9 stations, no term, or fewer nodes than twice the terms.
    """

    constrained = False
    developable = True
    _to_stations: Tensor

    def __init__(
        self,
        wire: Wire | Lines,
        panels: int = 2,
        terms: int = 14,
        stations: int = 201,
        nodes: int = 48,
        output_nodes: int = 128,
    ):
        super().__init__(wire, panels, stations)
        if terms < 1:
            raise ValueError(f"a series needs at least 1 term, got {terms}")
        if min(nodes, output_nodes) < 2 * terms:
            raise ValueError(f"{terms} terms need at least {2 * terms} nodes, got {nodes} and {output_nodes}")
        self.terms = terms
        self.corner_place = panels + 2 * panels * terms + CORNER_SIZE - 1
        some = self.stations
        self.angle = nn.Parameter(some.new_zeros(self.batch, panels))
        self.rib = nn.Parameter(some.new_zeros(self.batch, panels, terms))
        self.length = nn.Parameter(some.new_zeros(self.batch, panels, terms))
        self.corner = nn.Parameter(some.new_zeros(self.batch, CORNER_SIZE))
        self.grid = StripGrid.of(self.wire, terms, nodes)
        self.output_grid = StripGrid.of(self.wire, terms, output_nodes)
        self._place_stations()

    def read_wire(self) -> None:
        self.grid = StripGrid.of(self.wire, self.terms, len(self.grid.s))
        self.output_grid = StripGrid.of(self.wire, self.terms, len(self.output_grid.s))

    def _place_stations(self) -> None:
        operators = Nodes.of(len(self.output_grid.s), LENGTH)
        to_stations = operators.interpolation(self.stations.cpu().double().numpy())
        self.register_buffer("_to_stations", like(to_stations, self.stations), persistent=False)

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        series = (self.panels, self.terms)
        return {"angle": (self.panels,), "rib": series, "length": series, "corner": (CORNER_SIZE,)}

    def columns(self, terms: int | None = None) -> Int[Tensor, " columns"]:
        return self._panel_columns(terms).sort().values

    def _panel_columns(self, terms: int | None) -> Int[Tensor, " columns"]:
        """Panel by panel: angle, rib, length; last the corner's height and jump, from CORNER_TERMS terms on, and its
        place.
        """
        count = self.terms if terms is None else min(terms, self.terms)
        each = torch.arange(count, device=self.stations.device)
        parts = []
        for i in range(self.panels):
            rib = self.panels + i * self.terms + each
            parts += [each.new_tensor([i]), rib, rib + self.panels * self.terms]
        free = CORNER_SIZE if count >= min(CORNER_TERMS, self.terms) else 1
        return torch.cat((*parts, torch.arange(self.size - free, self.size, device=each.device)))

    @torch.no_grad()
    def place_corner(
        self, flat: Float[Tensor, "batch size"], points: Float[Tensor, "batch 3"], given: Bool[Tensor, " batch"]
    ) -> Float[Tensor, "batch size"]:
        """The parameters with a corner that is still flat moved to the ruling whose upper end is nearest to a point,
        where one is given.
        """
        shape, s = self.sketch(flat), self.grid.s
        segment, share = nearest_on_curve(points[:, None], shape.edges[:, -1], shape.tangents[:, -1], s)
        place = 2 / LENGTH * torch.lerp(s[segment], s[segment + 1], share)[:, 0] - 1
        moved = flat.clone()
        moved[:, -1] = torch.where(
            given & (flat[:, -CORNER_SIZE] == 0), place.clamp(-CORNER_REACH, CORNER_REACH), flat[:, -1]
        )
        return moved

    def corner_gap(self, flat: Float[Tensor, "batch size"], shape: CupShape, points: Float[Tensor, "batch 3"]) -> Gaps:
        return corner_gap(flat[:, -CORNER_SIZE:], shape, points, self.grid.x, self.grid.analysis)

    def sketch(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        """The cups at the nodes of the fit."""
        return chain_shape(self.grid, list(march(self.grid, **self.split(flat))))

    def shape_of(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        named = self.split(flat)
        panels = list(march(self.output_grid, **named))
        nodes, at = chain_shape(self.output_grid, panels), self._to_stations
        directions = unit(apply(at, nodes.directions))
        edges, tangents = apply(at, nodes.edges[:, :-1]), apply(at, nodes.tangents[:, :-1])
        # The upper edge may have a corner, which no polynomial follows: what it is made of is smooth, and its lengths
        # are evaluated here.
        last = panels[-1]
        x = 2 * self.stations / LENGTH - 1
        logs = [v[:, 0] for v in series(named["length"][:, -1:], *chebyshev_bases(self.terms, x))]
        log, log_slope, _ = cornered(logs, named["corner"], x)
        bump = (1 - x * x).clamp_min(0)
        t, t_slope = torch.exp(log) * bump, torch.exp(log) * (bump * log_slope - 4 / LENGTH * x)
        leaning = last.rates.speed * last.strip.alpha.sine
        back, opening, spin = (apply_row(at, v) for v in (leaning, last.strip.opening, last.strip.spin))
        d = directions[:, -1]
        d_max = torch.linalg.cross(d, unit(apply(at, last.eta)))
        upper = edges[:, -1] + t[..., None] * d
        upper_tangent = (t_slope - back)[..., None] * d + (opening - t * spin)[..., None] * d_max
        return CupShape(
            stations=self.stations,
            edges=torch.cat((edges, upper[:, None]), dim=1),
            tangents=torch.cat((tangents, upper_tangent[:, None]), dim=1),
            directions=directions,
            normals=unit(apply(at, nodes.normals)),
            geodesic=apply_row(at, nodes.geodesic),
        )

    @torch.no_grad()
    def linearise(self, flat: Float[Tensor, "batch size"], terms: int | None = None) -> Linearised:
        """The cups at the nodes and their derivatives, in closed form."""
        columns = self._panel_columns(terms)
        free = self.terms if terms is None else min(terms, self.terms)
        return linearised(self.grid, list(march(self.grid, **self.split(flat))), free, columns)

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        return {}

    def unfairness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        edges = []
        for panel in march(self.grid, **self.split(flat)):
            edges += [edge.residual for edge in panel.variations(panel.upper_turn(self.grid), self.grid)]
        return torch.cat(edges, dim=-1)

    @property
    def spans(self) -> Float[Tensor, " m"]:
        return self.grid.s.diff().repeat(2 * self.panels)

    @property
    def steps(self) -> Float[Tensor, " size"]:
        """Terms of order k by about (1 + (k / STEP_ORDER)^4)^-1: the higher, the more they bend and turn the edges."""
        order = torch.arange(self.terms, dtype=self.stations.dtype, device=self.stations.device)
        share = torch.exp2(-(1 + (order / STEP_ORDER) ** 4).log2().round())
        series = share.repeat(2 * self.panels)
        return torch.cat((series.new_ones(self.panels), series, series.new_ones(CORNER_SIZE)))

    def plain(self, height: Float[Tensor, " batch"]) -> tuple[Float[Tensor, "batch size"], Float[Tensor, " size"]]:
        """See `brafit.cup.plain`. Angles do not count, nor do the corner's size and place."""
        at, by_height, counts = (values.to(self.stations) for values in _plain_line(self.panels, self.terms))
        return at + by_height * (height[:, None] - HEIGHT), counts

    @torch.no_grad()
    def start(self, angles: Float[Tensor, "batch panels"], reaches: Float[Tensor, "batch panels"]) -> None:
        """Rulings at right angles to the edges, and each ruling length a single bump, such that the middle ruling's
        ends are at these places.
        """
        grid = self.grid
        middle = len(grid.s) // 2
        profile = torch.stack((reaches * torch.cos(angles), reaches * torch.sin(angles)), dim=-1)
        step = torch.cat((grid.edge[:, middle, None, ::2], profile), dim=1).diff(dim=1)
        across, out = ((step * axis[:, middle, None, ::2]).sum(-1) for axis in (grid.U, grid.V))
        heading = evenly(torch.atan2, out, across)
        turn = torch.cat((heading[:, :1], heading.diff(dim=1)), dim=1)
        flat = self.plain(self.stations.new_full((self.batch,), HEIGHT))[0]
        parts = self.split(flat)
        parts["angle"].copy_(torch.remainder(turn + torch.pi, 2 * torch.pi) - torch.pi)
        rib, length = parts["rib"], parts["length"]
        middle_lean, middle_length = (_in_the_middle(values[..., 1:]) for values in (rib, length))
        rib[..., 0] = -middle_lean
        length[..., 0] = step.norm(dim=-1).clamp_min(1e-2 * LENGTH).log() - middle_length
        self.load_flat(flat)

    def select(self, index: Tensor) -> "StripsCup":
        cup = copy.copy(self)
        cup._parameters, cup._modules = dict(self._parameters), dict(self._modules)
        cup._buffers = dict(self._buffers)
        for name in self.layout:
            cup.register_parameter(name, nn.Parameter(self.get_parameter(name).detach()[index]))
        cup.wire = self.wire.select(index)
        cup.grid, cup.output_grid = self.grid.select(index), self.output_grid.select(index)
        return cup

    def on(self, wire: Wire) -> "StripsCup":
        own, count = wire.coefficients, len(self.stations)
        cup = self.select(torch.arange(self.batch, device=self.stations.device)).to(own)
        cup.wire = wire
        cup.stations = torch.linspace(0, LENGTH, count, dtype=own.dtype, device=own.device)
        cup.read_wire()
        cup._place_stations()
        cup.load_flat(self.flatten().detach().to(own))
        return cup

    def refined(self) -> "StripsCup":
        cup = self.select(torch.arange(self.batch, device=self.stations.device))
        own = self.stations
        cup.stations = torch.linspace(0, LENGTH, 2 * len(own) - 1, dtype=own.dtype, device=own.device)
        cup.output_grid = StripGrid.of(self.wire, self.terms, 2 * len(self.output_grid.s))
        cup._place_stations()
        return cup

    def finer(self) -> "StripsCup":
        cup = self.select(torch.arange(self.batch, device=self.stations.device))
        cup.grid = StripGrid.of(self.wire, self.terms, len(self.grid.s) * 3 // 2)
        return cup


@cache
def _plain_line(panels: int, terms: int) -> tuple[Float[Tensor, " size"], ...]:
    """Parameters of the plain cup at HEIGHT, their change with the height, and how much they count."""
    zero, corner = torch.zeros(panels, dtype=torch.float64), torch.zeros(CORNER_SIZE, dtype=torch.float64)
    series = lines(panels, terms)
    at, by_height = (
        torch.cat((zero, *(series[name][k].flatten() for name in ("rib", "length")), corner)) for k in (0, 1)
    )
    jump = corner.clone()
    jump[1] = JUMP_COUNT * math.sqrt(panels)
    return at, by_height, torch.cat((zero, term_counts(terms).repeat(2 * panels), jump))


def _in_the_middle(series: Float[Tensor, "*batch terms"]) -> Float[Tensor, " *batch"]:
    """What Chebyshev polynomials T_1, T_2, ... add up to at 0: T_2 is -1 there, T_4 is 1, odd ones are 0."""
    even = series[..., 1::2]
    sign = 2.0 * (torch.arange(even.shape[-1], device=series.device) % 2) - 1.0
    return (even * sign.to(series)).sum(-1)
