"""Cup model B, "strips": developable by construction. Panels have the parameters, and each panel makes the next edge.

Per panel: the angle at which it leaves its lower edge in the middle, and series for the rib angle and the logarithm of
the ruling length. See `brafit.geometry.strip` for the equations. Both ends of all edges meet in the wire's ends, and
developability holds, up to the spectral error of the nodes; no constraint is left.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from brafit.cup.base import Cup, Linearised
from brafit.cup.condition import Gaps
from brafit.cup.corner import CORNER_REACH, CORNER_SIZE, beside_corner, corner_columns, corner_gap, cornered
from brafit.cup.shape import CupShape
from brafit.cup.strip_grid import StripGrid, chebyshev_bases
from brafit.cup.wire import LENGTH, Lines, Wire
from brafit.geometry.developable import unit
from brafit.geometry.fairness import Variation
from brafit.geometry.grid import like
from brafit.geometry.nearest import nearest_on_curve
from brafit.geometry.products import apply, apply_row, bmm, evenly
from brafit.geometry.strip import (
    Angle,
    Nodes,
    Rates,
    Strip,
    UpperTurn,
    next_rates,
    roll,
    strip,
    turned,
    upper_turn,
)

RIB_LIMIT = 1.3
"""Largest rib angle in radians: alpha = 1.3 tanh(series / 1.3)."""
PLAIN: dict[str, dict[str, tuple[float, ...]]] = {
    "first": {"rib": (0.0, 0.2), "length": (0.8, -0.1, 0.08)},
    "middle": {"rib": (-0.1, -0.3), "length": (0.6, -0.2, 0.05)},
    "last": {"rib": (-0.3, -1.6, 0.08), "length": (1.6, 0.0, 0.05)},
}
"""First coefficients of a plain cup's panels, lengths times the number of panels: rounded means of close fits to 14
breasts with two and three panels. Fits of different breasts differ little in them, and data say little about them."""
PLAIN_ORDER = 5.0
"""From about this order on terms count ever more."""
STEP_ORDER = 3.0
"""From about this order on terms change a cup ever more."""
JUMP_COUNT = 0.25
"""How much the jump at the upper edge's corner counts in `Cup.plain`, times the number of panels. What is plain counts
over the square of that number: so the jump counts alike with any. Free, it would wander with the corner's place."""
BUMP_SECOND = -8 / LENGTH**2
"""Second derivative of 1 - x^2 by s."""
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

    exact = True
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

    # --- the chain of panels ---

    def _march(self, flat: Float[Tensor, "batch size"], grid: "StripGrid") -> Iterator["_Panel"]:
        """The panels in turn, at the nodes of a grid."""
        named = self.split(flat)
        rates = Rates(grid.speed, grid.k1, grid.k2, grid.w)
        edge, T, U, V = grid.edge, grid.T, grid.U, grid.V
        both = torch.cat((named["rib"], named["length"]), dim=1)
        values, slopes, seconds = (v.unbind(1) for v in _series(both, *grid.bases))
        for i in range(self.panels):
            bounded, lean_slope = torch.tanh(values[i] / RIB_LIMIT), slopes[i]
            log, log_slope, log_second = (v[self.panels + i] for v in (values, slopes, seconds))
            if i == self.panels - 1:
                log, log_slope, log_second = cornered((log, log_slope, log_second), named["corner"], grid.x)
            alpha, saturation = Angle.of(RIB_LIMIT * bounded), 1 - bounded * bounded
            size = torch.exp(log)
            t, t_slope = size * grid.bump, size * torch.addcmul(grid.bump_slope, grid.bump, log_slope)
            t_second = size * (BUMP_SECOND + (2 * grid.bump_slope + grid.bump * log_slope) * log_slope)
            t_second = torch.addcmul(t_second, t, log_second)
            phi = Angle.of(roll(rates, alpha.tangent, named["angle"][:, i], grid.integral))
            panel = strip(rates, phi, alpha, saturation * lean_slope, t, t_slope)
            xi, eta = turned(U, V, phi)
            d_max, d = turned(T, xi, alpha)
            yield _Panel(rates, edge, bounded, lean_slope, t_slope, t_second, panel, d, d_max, eta)
            edge = edge + t[..., None] * d
            U, T = turned(d, d_max, panel.beta)
            V = eta
            if i + 1 < self.panels:
                rates = next_rates(panel, grid.derivative)

    def _shape(self, grid: "StripGrid", panels: list["_Panel"]) -> CupShape:
        edges, tangents = [grid.edge], [grid.T * grid.speed[..., None]]
        for panel in panels:
            edges.append(panel.upper)
            tangents.append(panel.upper_tangent)
        return CupShape(
            stations=grid.s,
            edges=torch.stack(edges, dim=1),
            tangents=torch.stack(tangents, dim=1),
            directions=torch.stack([panel.d for panel in panels], dim=1),
            normals=torch.stack([panel.eta for panel in panels], dim=1),
            geodesic=torch.stack([panel.strip.omega_eta / panel.rates.speed for panel in panels], dim=1),
        )

    def sketch(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        """The cups at the nodes of the fit."""
        return self._shape(self.grid, list(self._march(flat, self.grid)))

    def shape_of(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        panels = list(self._march(flat, self.output_grid))
        nodes, at = self._shape(self.output_grid, panels), self._to_stations
        directions = unit(apply(at, nodes.directions))
        edges, tangents = apply(at, nodes.edges[:, :-1]), apply(at, nodes.tangents[:, :-1])
        # The upper edge may have a corner, which no polynomial follows: what it is made of is smooth, and its lengths
        # are evaluated here.
        last = panels[-1]
        x = 2 * self.stations / LENGTH - 1
        named = self.split(flat)
        logs = [v[:, 0] for v in _series(named["length"][:, -1:], *chebyshev_bases(self.terms, x))]
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

    # --- derivatives ---

    @torch.no_grad()
    def linearise(self, flat: Float[Tensor, "batch size"], terms: int | None = None) -> Linearised:
        """The cups at the nodes and their derivatives, in closed form: the linearised equations of
        `brafit.geometry.strip`.
        """
        grid, columns = self.grid, self._panel_columns(terms)
        terms = self.terms if terms is None else min(terms, self.terms)
        n, batch = len(grid.s), len(flat)
        basis, basis_slope, basis_second = (b[:terms].mT for b in grid.bases)  # (n, terms)
        rows = (self.panels + 1) * n
        table = flat.new_zeros(batch, 2 * rows, 3, len(columns))
        margins, margin_columns = [], flat.new_zeros(batch, self.panels, n, len(columns))
        unfair, unfair_columns = [], flat.new_zeros(batch, 2 * self.panels, n - 1, len(columns))
        width = 0
        d_speed = d_k1 = d_k2 = d_w = flat.new_zeros(batch, n, 0)
        # how the frame of the lower edge turns, about its own axes T, U and V
        about_T = about_U = about_V = flat.new_zeros(batch, n, 0)
        panels = list(self._march(flat, grid))
        for i, panel in enumerate(panels):
            own_logs = basis, basis_slope, basis_second
            corner_count = len(columns) - self.panels * (1 + 2 * terms)
            if i == self.panels - 1:
                extra = (v[..., -corner_count:] for v in corner_columns(flat[:, -CORNER_SIZE:], grid.x))
                pairs = zip(own_logs, extra, strict=True)
                own_logs = tuple(torch.cat((b.expand(batch, -1, -1), e), dim=-1) for b, e in pairs)
            own_log, own_log_slope, own_log_second = own_logs
            own = 1 + terms + own_log.shape[-1]
            size = width + own
            rib, length = slice(width + 1, width + 1 + terms), slice(width + 1 + terms, size)
            scalars = panel.strip
            sine, cosine, rib_sine, rib_cosine, slope, omega_xi, omega_eta = (
                v[..., None]
                for v in (
                    scalars.phi.sine,
                    scalars.phi.cosine,
                    scalars.alpha.sine,
                    scalars.alpha.cosine,
                    scalars.alpha.tangent,
                    scalars.omega_xi,
                    scalars.omega_eta,
                )
            )
            t, p, q, spin, speed = (
                v[..., None] for v in (scalars.t, scalars.p, scalars.q, scalars.spin, scalars.speed)
            )

            saturation = (1 - panel.bounded * panel.bounded)[..., None]
            twice = (2 / RIB_LIMIT * panel.bounded * panel.lean_slope)[..., None]
            own_alpha = saturation * basis
            own_alpha_slope = saturation * (basis_slope - twice * basis)
            own_t = t * own_log
            t_slope, t_second = panel.t_slope[..., None], panel.t_second[..., None]
            own_t_slope = torch.addcmul(t * own_log_slope, t_slope, own_log)
            own_t_second = t_second * own_log + 2 * t_slope * own_log_slope + t * own_log_second
            bending = torch.addcmul(d_k1 * sine, d_k2, cosine, value=-1)

            # the roll: delta' + a delta = h, delta(middle) = delta of the angle
            h = torch.cat((-torch.addcmul(d_w, bending, slope), -omega_xi / rib_cosine**2 * own_alpha), dim=-1)
            factor = torch.exp(apply(grid.integral, omega_eta * slope).clamp(-40, 40))
            h = apply(grid.integral, factor * h)
            d_phi = torch.cat((h[..., :width], torch.ones_like(factor), h[..., width:]), dim=-1) / factor
            d_phi = pad(d_phi, (0, size - d_phi.shape[-1]))

            d_xi = pad(bending, (0, own)).addcmul_(omega_eta, d_phi)
            d_spin = pad(torch.addcmul(d_k1 * cosine, d_k2, sine), (0, own)).addcmul_(omega_xi, d_phi, value=-1)
            turn = upper_turn(scalars, panel.t_slope, panel.t_second, grid.derivative)
            edge_below, edge_above = self._variations(panel, turn, flat[:, -CORNER_SIZE:], i)
            unfair += [edge_below.residual, edge_above.residual]
            unfair_columns[:, 2 * i, :, :size] = edge_below.columns(d_spin, pad(d_speed, (0, own)))
            d_spin[..., rib] += own_alpha_slope
            d_open = pad(d_speed * rib_cosine, (0, own))
            d_open[..., rib] -= speed * rib_sine * own_alpha
            d_q = torch.addcmul(d_open, t, d_spin, value=-1)
            d_q[..., length] -= spin * own_t
            d_p = pad(-d_speed * rib_sine, (0, own))
            d_p[..., rib] -= speed * rib_cosine * own_alpha
            d_p[..., length] += own_t_slope
            opening = scalars.opening[..., None]
            margin = q / opening
            margins.append(margin[..., 0])
            margin_columns[:, i, :, :size] = torch.addcmul(d_q, margin, d_open, value=-1) / opening

            # how the upper edge turns in the panel: d (spin - beta')
            p_slope, q_slope, spin_slope, beta_slope = (v[..., None] for v in (turn.p, turn.q, turn.spin, turn.beta))
            d_back = pad(d_speed * rib_sine, (0, own))
            d_back[..., rib] += speed * rib_cosine * own_alpha
            d_back, d_opening, d_spin_slope = (apply(grid.derivative, d) for d in (d_back, d_open, d_spin))
            d_p_slope, d_q_slope = -d_back, torch.addcmul(d_opening, t, d_spin_slope, value=-1)
            d_q_slope = torch.addcmul(d_q_slope, t_slope, d_spin, value=-1)
            d_p_slope[..., length] += own_t_second
            d_q_slope[..., length] -= torch.addcmul(own_t_slope * spin, own_t, spin_slope)
            next_speed = scalars.next_speed[..., None]
            d_next_speed = torch.addcmul(p * d_p, q, d_q) / next_speed
            d_beta_slope = torch.addcmul(d_p * q_slope, p, d_q_slope) - torch.addcmul(d_q * p_slope, q, d_p_slope)
            d_beta_slope = d_beta_slope / next_speed**2 - 2 * beta_slope / next_speed * d_next_speed
            unfair_columns[:, 2 * i + 1, :, :size] = edge_above.columns(d_spin - d_beta_slope, d_next_speed)
            if i == self.panels - 1:
                steps = edge_above.curvature.diff(dim=-1) / edge_above.lengths.sqrt()
                unfair_columns[:, 2 * i + 1, :, size - 1] += steps * beside_corner(flat[:, -CORNER_SIZE:], grid.x)[1]

            # the frame of the rulings turns, about d, d_max and eta, and the edge moves
            about_xi = pad(torch.addcmul(about_U * cosine, about_V, sine), (0, own))
            about_eta = pad(torch.addcmul(about_V * cosine, about_U, sine, value=-1), (0, own))
            about_eta[..., rib] += own_alpha
            about_T = d_phi if i == 0 else d_phi + pad(about_T, (0, own))
            about_d = torch.addcmul(about_xi * rib_cosine, about_T, rib_sine, value=-1)
            about_d_max = torch.addcmul(about_xi * rib_sine, about_T, rib_cosine)
            lower, upper = (table[:, k * n : (k + 1) * n, :, :size] for k in (i, i + 1))
            upper.copy_(lower)
            _add_vectors(upper, panel.eta, t * about_d_max)
            _add_vectors(upper, panel.d_max, -t * about_eta)
            _add_vectors(upper[..., length], panel.d, own_t)
            tangent = table[:, rows + (i + 1) * n : rows + (i + 2) * n, :, :size]
            _add_vectors(tangent, panel.d, torch.addcmul(d_p, q, about_eta))
            _add_vectors(tangent, panel.d_max, torch.addcmul(d_q, p, about_eta, value=-1))
            _add_vectors(tangent, panel.eta, torch.addcmul(p * about_d_max, q, about_d, value=-1))

            if i + 1 < self.panels:
                turn_sine, turn_cosine = (v[..., None] for v in (scalars.beta.sine, scalars.beta.cosine))
                d_speed = d_next_speed
                d_beta = -torch.addcmul(turn_cosine * d_p, turn_sine, d_q) / next_speed
                bend = omega_xi / rib_cosine
                d_bend = d_xi / rib_cosine
                d_bend[..., rib] += bend * slope * own_alpha
                d_k1 = d_spin - apply(grid.derivative, d_beta)
                d_k2 = torch.addcmul(turn_sine * bend * d_beta, turn_cosine, d_bend, value=-1)
                d_w = -torch.addcmul(turn_cosine * bend * d_beta, turn_sine, d_bend)
                about_T = torch.addcmul(turn_cosine * about_d_max, turn_sine, about_d, value=-1)
                about_U = torch.addcmul(turn_cosine * about_d, turn_sine, about_d_max)
                about_V = about_eta - d_beta
                width = size
        return Linearised(
            shape=self._shape(grid, panels),
            table=table,
            margin=torch.stack(margins, dim=1),
            margin_columns=margin_columns,
            unfairness=torch.stack(unfair, dim=1).flatten(1),
            unfairness_columns=unfair_columns.flatten(1, 2),
            constraints={},
            columns=columns,
            reach=(*((i + 1) * (1 + 2 * terms) for i in range(self.panels - 1)), len(columns)),
        )

    # --- the rest of the face ---

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        return {}

    def unfairness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        edges = []
        for i, panel in enumerate(self._march(flat, self.grid)):
            turn = upper_turn(panel.strip, panel.t_slope, panel.t_second, self.grid.derivative)
            edges += [edge.residual for edge in self._variations(panel, turn, flat[:, -CORNER_SIZE:], i)]
        return torch.cat(edges, dim=-1)

    def _variations(
        self, panel: "_Panel", turn: UpperTurn, corner: Float[Tensor, "batch 3"], number: int
    ) -> tuple[Variation, Variation]:
        """How the curvature of a flat panel's lower and upper edge varies, the upper edge's corner apart."""
        scalars, grid = panel.strip, self.grid
        steps = grid.s.diff()
        share = beside_corner(corner, grid.x)[0] if number == self.panels - 1 else 1.0
        return (
            Variation(scalars.omega_eta, scalars.speed, steps),
            Variation(scalars.spin - turn.beta, scalars.next_speed, steps, share),
        )

    @property
    def steps(self) -> Float[Tensor, " size"]:
        """Terms of order k by about (1 + (k / STEP_ORDER)^4)^-1: the higher, the more they bend and turn the edges."""
        order = torch.arange(self.terms, dtype=self.stations.dtype, device=self.stations.device)
        share = torch.exp2(-(1 + (order / STEP_ORDER) ** 4).log2().round())
        series = share.repeat(2 * self.panels)
        return torch.cat((series.new_ones(self.panels), series, series.new_ones(CORNER_SIZE)))

    @property
    def plain(self) -> tuple[Float[Tensor, " size"], Float[Tensor, " size"]]:
        """See PLAIN. A term of order k counts (1 + (k / PLAIN_ORDER)^6)^(1/2): low orders alike, high orders as third
        derivatives of the edges would count them.
        """
        series = {name: self.stations.new_zeros(self.panels, self.terms) for name in ("rib", "length")}
        for i in range(self.panels):
            role = "last" if i == self.panels - 1 else "first" if i == 0 else "middle"
            for name, values in PLAIN[role].items():
                kept = self.stations.new_tensor(values[: self.terms])
                series[name][i, : len(kept)] = kept
        series["length"][:, 0] -= math.log(self.panels)
        order = torch.arange(self.terms, dtype=self.stations.dtype, device=self.stations.device)
        count = (1 + (order / PLAIN_ORDER) ** 6).sqrt().expand(self.panels, -1)
        none = {"angle": order.new_zeros(self.panels), "corner": order.new_zeros(CORNER_SIZE)}
        values, counts = none | series, none | dict.fromkeys(series, count)
        counts["corner"] = order.new_tensor([0.0, JUMP_COUNT * self.panels, 0.0])
        flat = (torch.cat([parts[name].flatten() for name in self.layout]) for parts in (values, counts))
        return next(flat), next(flat)

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
        flat = self.plain[0].repeat(self.batch, 1)
        parts = self.split(flat)
        parts["angle"].copy_(torch.remainder(turn + torch.pi, 2 * torch.pi) - torch.pi)
        rib, length = parts["rib"], parts["length"]
        rib[..., 0] = rib[..., 2] if self.terms > 2 else 0.0  # no lean in the middle, where T_2 is -1
        even = length[..., 2] if self.terms > 2 else 0.0  # T_2(0) = -1
        length[..., 0] = step.norm(dim=-1).clamp_min(1e-2 * LENGTH).log() + even
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


@dataclass(frozen=True)
class _Panel:
    """One panel at the nodes: rates of its lower edge, the edge, tanh of the rib angle's series and the series' slope,
    first and second derivative of the ruling length, scalars, frame."""

    rates: Rates
    lower: Tensor
    bounded: Tensor
    lean_slope: Tensor
    t_slope: Tensor
    t_second: Tensor
    strip: Strip
    d: Tensor
    d_max: Tensor
    eta: Tensor

    @property
    def upper(self) -> Tensor:
        return torch.addcmul(self.lower, self.strip.t[..., None], self.d)

    @property
    def upper_tangent(self) -> Tensor:
        return torch.addcmul(self.strip.p[..., None] * self.d, self.strip.q[..., None], self.d_max)


def _series(
    coefficients: Float[Tensor, "batch series terms"], *bases: Float[Tensor, "terms n"]
) -> tuple[Float[Tensor, "batch series n"], ...]:
    """Values of series and their derivatives, one for each basis."""
    every = torch.cat(bases, dim=-1)
    return bmm(coefficients, every.expand(len(coefficients), -1, -1)).chunk(len(bases), dim=-1)


def _add_vectors(
    table: Float[Tensor, "*batch 3 k"], vector: Float[Tensor, "*batch 3"], factors: Float[Tensor, "*batch k"]
) -> None:
    """Add a multiple of the vector to each of the k columns."""
    table.addcmul_(vector[..., None], factors[..., None, :])
