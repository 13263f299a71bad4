"""Cup model B, "strips": developable by construction. Panels have the parameters, and each panel makes the next edge.

Per panel: the angle at which it leaves its lower edge in the middle, and series for the rib angle and the logarithm of the ruling length. See
`brafit.geometry.strip` for the equations. Both ends of all edges meet in the wire's ends, and developability holds, up to the spectral
error of the nodes; no constraint is left.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from brafit.cup.base import Cup, Linearised
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, Wire
from brafit.geometry.developable import dot, unit
from brafit.geometry.grid import like
from brafit.geometry.ritz import ritz_basis
from brafit.geometry.strip import Nodes, Rates, Strip, apply, apply_row, next_rates, roll, strip, turned

RIB_LIMIT = 1.3
"""Largest rib angle in radians: alpha = 1.3 tanh(series / 1.3)."""


class StripsCup(Cup):
    """Cups whose panels are exact developable strips, each built on the edge below it.

    Args:
        wire: the wire lines of B cups.
        panels: number of panels.
        terms: terms of both series of a panel (Chebyshev polynomials of the wire's arc length).
        stations: samples of the output along the wire, evenly spaced.
        nodes: Chebyshev nodes at which the panels are integrated and fitted.

    Parameters:
        angle (B, panels): phi_0, the angle by which each panel leaves the reference normal in the middle of its lower edge: the chest's normal at the
            wire, the panel below at the ridges.
        rib (B, panels, terms): series of the rib angle before its bound.
        length (B, panels, terms): series of log(t / (1 - x^2)), t the ruling length, x in [-1, 1] along the wire.
    """

    def __init__(self, wire: Wire, panels: int = 2, terms: int = 10, stations: int = 201, nodes: int = 48):
        super().__init__(wire, panels, stations)
        if terms < 1:
            raise ValueError(f"a series needs at least 1 term, got {terms}")
        if nodes < 2 * terms:
            raise ValueError(f"{terms} terms need at least {2 * terms} nodes, got {nodes}")
        self.terms, self.nodes = terms, nodes
        some = wire.coefficients
        self.angle = nn.Parameter(some.new_zeros(len(wire), panels))
        self.rib = nn.Parameter(some.new_zeros(len(wire), panels, terms))
        self.length = nn.Parameter(some.new_zeros(len(wire), panels, terms))
        operators = Nodes.of(nodes, LENGTH)
        x = 2 * operators.s / LENGTH - 1
        constants = {
            "_s": operators.s,
            "_derivative": operators.derivative,
            "_integral": operators.integral,
            "_to_stations": operators.interpolation(self.stations.cpu().double().numpy()),
            "_bump": 1 - x * x,
            "_bump_slope": -2 * x * (2 / LENGTH),
        }
        for name, value in constants.items():
            self.register_buffer(name, like(value, some), persistent=False)
        basis = ritz_basis("chebyshev", terms, torch.from_numpy(operators.s) / LENGTH)
        slope = apply(torch.from_numpy(operators.derivative), basis.mT).mT
        self.register_buffer("_basis", basis.to(some), persistent=False)
        self.register_buffer("_basis_slope", slope.to(some), persistent=False)
        for name, value in _wire_frame(wire, self._s, self._derivative).items():
            self.register_buffer(f"_wire_{name}", value, persistent=False)

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        return {"angle": (self.panels,), "rib": (self.panels, self.terms), "length": (self.panels, self.terms)}

    def columns(self, terms: int | None = None) -> Int[Tensor, " columns"]:
        return self._panel_columns(terms).sort().values

    def _panel_columns(self, terms: int | None) -> Int[Tensor, " columns"]:
        """Panel by panel: angle, rib, length."""
        each = torch.arange(self.terms if terms is None else min(terms, self.terms), device=self._s.device)
        parts = []
        for i in range(self.panels):
            rib = self.panels + i * self.terms + each
            parts += [each.new_tensor([i]), rib, rib + self.panels * self.terms]
        return torch.cat(parts)

    # --- the chain of panels ---

    def _series(self, coefficients: Float[Tensor, "batch terms"]) -> tuple[Tensor, Tensor]:
        values = [(coefficients[:, :, None] * b).sum(1) for b in (self._basis, self._basis_slope)]
        return values[0], values[1]

    def _march(
        self, flat: Float[Tensor, "batch size"]
    ) -> Iterator[tuple[Rates, Tensor, Tensor, Tensor, Strip, Tensor, Tensor, Tensor, Tensor]]:
        """Panel by panel: rates, lower edge, its T, the saturation of the rib angle, the strip, d, d_max, eta, t'."""
        named = self.split(flat)
        rates = Rates(self._wire_speed, self._wire_k1, self._wire_k2, self._wire_w)
        edge, T, U, V = self._wire_edge, self._wire_T, self._wire_U, self._wire_V
        for i in range(self.panels):
            lean, lean_slope = self._series(named["rib"][:, i])
            bounded = torch.tanh(lean / RIB_LIMIT)
            alpha, saturation = RIB_LIMIT * bounded, 1 - bounded * bounded
            log, log_slope = self._series(named["length"][:, i])
            size = torch.exp(log)
            t, t_slope = size * self._bump, size * (self._bump_slope + self._bump * log_slope)
            phi, _ = roll(rates, torch.tan(alpha), named["angle"][:, i], self._integral)
            panel = strip(rates, phi, alpha, saturation * lean_slope, t, t_slope)
            xi, eta = turned(U, V, phi)
            d_max, d = turned(T, xi, alpha)
            yield rates, edge, T, torch.stack((bounded, lean_slope)), panel, d, d_max, eta, t_slope
            edge = edge + t[..., None] * d
            T, U = turned(d_max, d, -panel.beta)
            V = eta
            if i + 1 < self.panels:
                rates = next_rates(panel, self._derivative)

    def sketch(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        """The cups at the nodes."""
        edges, tangents = [self._wire_edge], [self._wire_T * self._wire_speed[..., None]]
        directions, normals, geodesic = [], [], []
        for rates, edge, _, _, panel, d, d_max, eta, _ in self._march(flat):
            edges.append(edge + panel.t[..., None] * d)
            tangents.append(panel.p[..., None] * d + panel.q[..., None] * d_max)
            directions.append(d)
            normals.append(eta)
            geodesic.append(panel.omega_eta / rates.speed)
        stacked = (torch.stack(v, dim=1) for v in (edges, tangents, directions, normals, geodesic))
        return CupShape(self._s, *stacked)

    def shape_of(self, flat: Float[Tensor, "batch size"]) -> CupShape:
        nodes = self.sketch(flat)
        at = self._to_stations
        edges, tangents = apply(at, nodes.edges), apply(at, nodes.tangents)
        edges = torch.cat((edges[:, :, :1] * 0 + edges[:, :1, :1], edges[:, :, 1:-1], edges[:, :, -1:] * 0 + edges[:, :1, -1:]), 2)
        return CupShape(
            stations=self.stations,
            edges=edges,
            tangents=tangents,
            directions=unit(apply(at, nodes.directions)),
            normals=unit(apply(at, nodes.normals)),
            geodesic=apply_row(at, nodes.geodesic),
        )

    # --- derivatives ---

    @torch.no_grad()
    def linearise(self, flat: Float[Tensor, "batch size"], terms: int | None = None) -> Linearised:
        """The cups at the nodes and their derivatives, in closed form: the linearised equations of `brafit.geometry.strip`."""
        columns = self._panel_columns(terms)
        terms = (len(columns) // self.panels - 1) // 2
        n, own = self.nodes, 2 * terms + 1
        batch = len(flat)
        basis, basis_slope = self._basis[:terms].mT, self._basis_slope[:terms].mT  # (n, terms)
        rows = (self.panels + 1) * n
        table = flat.new_zeros(batch, 2 * rows, 3, self.panels * own)
        margins, margin_columns = [], flat.new_zeros(batch, self.panels, n, self.panels * own)
        edges, tangents = [self._wire_edge], [self._wire_T * self._wire_speed[..., None]]
        directions, normals, geodesic = [], [], []
        width = 0
        d_speed = d_k1 = d_k2 = d_w = flat.new_zeros(batch, n, 0)
        d_edge = theta = flat.new_zeros(batch, n, 3, 0)
        steps = list(self._march(flat))
        for i, (rates, edge, T, (bounded, lean_slope), panel, d, d_max, eta, t_slope) in enumerate(steps):
            size = width + own
            angle, rib, length = width, slice(width + 1, width + 1 + terms), slice(width + 1 + terms, size)
            sine, cosine = (f(panel.phi)[..., None] for f in (torch.sin, torch.cos))
            rib_sine, rib_cosine = (f(panel.alpha)[..., None] for f in (torch.sin, torch.cos))
            slope = rib_sine / rib_cosine
            omega_xi, omega_eta = panel.omega_xi[..., None], panel.omega_eta[..., None]
            t, p, q, spin, speed = (v[..., None] for v in (panel.t, panel.p, panel.q, panel.spin, panel.speed))

            saturation = (1 - bounded * bounded)[..., None]
            twice = (2 / RIB_LIMIT * bounded * lean_slope)[..., None]
            own_alpha = saturation * basis
            own_alpha_slope = saturation * (basis_slope - twice * basis)
            own_t = t * basis
            own_t_slope = t_slope[..., None] * basis + t * basis_slope

            def field(before: Tensor) -> Tensor:
                return torch.nn.functional.pad(before, (0, own))

            # the roll: delta' + a delta = h, delta(middle) = delta of the angle
            h = flat.new_empty(batch, n, width + terms)
            h[..., :width] = -d_w - (d_k1 * sine - d_k2 * cosine) * slope
            h[..., width:] = -omega_xi / rib_cosine**2 * own_alpha
            factor = torch.exp(apply(self._integral, omega_eta * slope).clamp(-40, 40))
            h = apply(self._integral, factor * h) / factor
            d_phi = flat.new_zeros(batch, n, size)
            d_phi[..., :width] = h[..., :width]
            d_phi[..., angle] = 1 / factor[..., 0]
            d_phi[..., rib] = h[..., width:]

            d_xi, d_eta = field(d_k1 * sine - d_k2 * cosine), field(d_k1 * cosine + d_k2 * sine)
            d_xi.addcmul_(omega_eta, d_phi)
            d_eta.addcmul_(omega_xi, d_phi, value=-1)
            d_spin = d_eta
            d_spin[..., rib] += own_alpha_slope
            d_open = field(d_speed * rib_cosine)
            d_open[..., rib] -= speed * rib_sine * own_alpha
            d_q = d_open - t * d_spin
            d_q[..., length] -= spin * own_t
            d_p = field(-d_speed * rib_sine)
            d_p[..., rib] -= speed * rib_cosine * own_alpha
            d_p[..., length] += own_t_slope
            opening = panel.opening[..., None]
            margin = q / opening
            margins.append(margin[..., 0])
            margin_columns[:, i, :, :size] = (d_q - margin * d_open) / opening

            # frames turn by theta, edges move
            theta_panel = torch.nn.functional.pad(theta, (0, own))
            theta_panel.addcmul_(T[..., None], d_phi[..., None, :])
            theta_panel[..., rib] += eta[..., None] * own_alpha[..., None, :]
            reach = panel.t[..., None] * d
            moved = torch.nn.functional.pad(d_edge, (0, own)) + _cross(theta_panel, reach)
            moved[..., length] += d[..., None] * own_t[..., None, :]
            along = panel.p[..., None] * d + panel.q[..., None] * d_max
            d_tangent = _cross(theta_panel, along)
            d_tangent.addcmul_(d[..., None], d_p[..., None, :]).addcmul_(d_max[..., None], d_q[..., None, :])
            table[:, (i + 1) * n : (i + 2) * n, :, :size] = moved
            table[:, rows + (i + 1) * n : rows + (i + 2) * n, :, :size] = d_tangent
            edges.append(edge + reach)
            tangents.append(along)
            directions.append(d)
            normals.append(eta)
            geodesic.append(panel.omega_eta / rates.speed)

            if i + 1 < self.panels:
                squared = p * p + q * q
                d_beta = (p * d_q - q * d_p) / squared
                d_speed = (p * d_p + q * d_q) / squared.sqrt()
                bend = omega_xi / rib_cosine
                d_bend = d_xi / rib_cosine
                d_bend[..., rib] += bend * slope * own_alpha
                turn_sine, turn_cosine = (f(panel.beta)[..., None] for f in (torch.sin, torch.cos))
                d_k1 = d_spin - apply(self._derivative, d_beta)
                d_k2 = turn_sine * bend * d_beta - turn_cosine * d_bend
                d_w = -turn_cosine * bend * d_beta - turn_sine * d_bend
                theta = theta_panel.addcmul_(eta[..., None], d_beta[..., None, :], value=-1)
                d_edge, width = moved, size
        stacked = (torch.stack(v, dim=1) for v in (edges, tangents, directions, normals, geodesic))
        return Linearised(
            shape=CupShape(self._s, *stacked),
            table=table,
            margin=torch.stack(margins, dim=1),
            margin_columns=margin_columns,
            roughness=torch.diag(self.waviness)[:, columns].expand(batch, -1, -1),
            constraints={},
            columns=columns,
        )

    # --- the rest of the face ---

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        return {}

    def roughness(self, flat: Float[Tensor, "batch size"]) -> Float[Tensor, "batch m"]:
        return flat * self.waviness

    @property
    def waviness(self) -> Float[Tensor, " size"]:
        order = torch.arange(self.terms, dtype=self._s.dtype, device=self._s.device).square()
        return torch.cat((order.new_zeros(self.panels), order.repeat(2 * self.panels)))

    @torch.no_grad()
    def start(self, angles: Float[Tensor, "batch panels"], reaches: Float[Tensor, "batch panels"]) -> None:
        """Rulings at right angles to the edges, and each ruling length a single bump, such that the middle ruling's ends are at these places."""
        first = self._wire_edge[:, self.nodes // 2]
        profile = torch.stack((reaches * torch.cos(angles), reaches * torch.sin(angles)), dim=-1)
        profile = torch.cat((first[:, None, ::2], profile), dim=1)
        step = profile.diff(dim=1)
        T, V = self._wire_T[:, self.nodes // 2], self._wire_V[:, self.nodes // 2]
        U = torch.linalg.cross(V, T)
        planar = torch.stack([(step * axis[:, None, ::2]).sum(-1) for axis in (U, V)])
        heading = torch.atan2(planar[1], planar[0])
        turn = torch.cat((heading[:, :1], heading.diff(dim=1)), dim=1)
        self.angle.copy_(torch.remainder(turn + torch.pi, 2 * torch.pi) - torch.pi)
        self.rib.zero_()
        self.length.zero_()
        self.length[..., 0] = step.norm(dim=-1).clamp_min(1e-2 * LENGTH).log()

    def select(self, index: Tensor) -> "StripsCup":
        cup = StripsCup(self.wire.select(index), self.panels, self.terms, self.stations.shape[0], self.nodes)
        cup.load_flat(self.flatten().detach()[index])
        return cup.to(self._s)

    def refined(self) -> "StripsCup":
        """The same cups with half as many nodes again."""
        cup = StripsCup(self.wire, self.panels, self.terms, self.stations.shape[0], self.nodes * 3 // 2)
        cup.load_flat(self.flatten().detach())
        return cup.to(self._s)


def _cross(turn: Float[Tensor, "*batch 3 k"], vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 k"]:
    """turn x vector for each of the k columns."""
    x, y, z = vector[..., None].unbind(-2)
    a, b, c = turn.unbind(-2)
    return torch.stack((b * z - c * y, c * x - a * z, a * y - b * x), dim=-2)


def _wire_frame(wire: Wire, s: Tensor, derivative: Tensor) -> dict[str, Tensor]:
    """The wire at the nodes: positions, reference frame (V the chest's normal made orthogonal to T), rates."""
    position, first, second = (wire.sample(s, k) for k in range(3))
    speed = first.norm(dim=-1)
    T = first / speed[..., None]
    normal = torch.zeros_like(T)
    normal[..., 2] = 1
    V = unit(normal - dot(normal, T)[..., None] * T)
    U = torch.linalg.cross(V, T)
    turning = (second - dot(second, T)[..., None] * T) / speed[..., None]
    rates = {"speed": speed, "k1": dot(turning, U), "k2": dot(turning, V), "w": -dot(apply(derivative, V), U)}
    return {"edge": position, "T": T, "U": U, "V": V, **rates}
