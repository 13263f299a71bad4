"""Derivatives of a chain of strips by its parameters, in closed form: the equations of `brafit.geometry.strip`,
linearised panel by panel from the wire upwards.

A panel depends on its own parameters and on those of the panels below. So its derivatives have a last dimension of
columns: first those of the panels below, then its own, of which there are its angle, the terms of its rib angle and
those of its log ruling length, the last panel's with the corner's height, jump and place.

A name of a quantity, such as `spin`, stands for its derivatives by the columns here; the quantity itself is always an
attribute of a `ChainPanel`, a `Strip` or an `UpperTurn`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from brafit.cup.base import Linearised
from brafit.cup.corner import CORNER_SIZE, beside_corner, corner_columns
from brafit.cup.strip_chain import RIB_LIMIT, ChainPanel, chain_shape
from brafit.cup.strip_grid import StripGrid
from brafit.geometry.fairness import Variation
from brafit.geometry.products import apply
from brafit.geometry.strip import Angle, Strip, UpperTurn

Columns = Float[Tensor, "batch n _"]
Scalars = TypeVar("Scalars", Tensor, Angle, Strip, UpperTurn)


def linearised(
    grid: StripGrid, panels: Sequence[ChainPanel], terms: int, columns: Int[Tensor, " columns"]
) -> Linearised:
    """The cups at the nodes and their derivatives. Without gradients.

    Args:
        grid: the nodes, and the wires there.
        panels: from `march`, on the same grid.
        terms: free terms of every series.
        columns: of the free parameters, as the module has them, their places in the flat matrix.
    """
    (batch, n), count, levels = panels[0].bounded.shape, len(columns), len(panels) + 1
    free = count - len(panels) * (1 + 2 * terms)
    zeros = panels[0].bounded.new_zeros
    table = zeros(batch, 2 * levels * n, 3, count)
    edges, tangents = table.view(batch, 2, levels, n, 3, count).unbind(1)
    margin_columns = zeros(batch, len(panels), n, count)
    unfairness_columns = zeros(batch, 2 * len(panels), n - 1, count)
    bases = [basis[:terms].mT for basis in grid.bases]
    below = _Below(*[zeros(batch, n, 0)] * len(fields(_Below)))
    margins, unfairness, reach = [], [], []
    for i, panel in enumerate(panels):
        corner = () if panel.corner is None else corner_columns(panel.corner, grid.x)
        corner = [columns[..., CORNER_SIZE - free :] for columns in corner]
        places = _Places(below.speed.shape[-1], terms, terms + free if corner else terms)
        own = slice(0, places.size)
        one = _Linear(panel, grid, below, places, _Series.of(panel, bases, corner), _tall(panel.strip))
        rolled = one.rolled()
        turn = panel.upper_turn(grid)
        variations = panel.variations(turn, grid)
        unfairness += [variation.residual for variation in variations]
        unfairness_columns[:, 2 * i, :, own] = variations[0].columns(rolled.omega_eta, places.wider(below.speed))
        ruled = one.ruled(rolled)
        margin, margin_columns[:, i, :, own] = one.margin(ruled)
        margins.append(margin)
        speed, rate = one.upper(ruled, _tall(turn))
        unfairness_columns[:, 2 * i + 1, :, own] = one.upper_unfairness(variations[1], rate, speed)
        moving = one.moving(rolled)
        one.place(moving, edges[:, i, ..., own], edges[:, i + 1, ..., own])
        one.place_tangents(moving, ruled, tangents[:, i + 1, ..., own])
        reach.append(places.size)
        if i + 1 < len(panels):
            below = one.above(rolled, ruled, moving, speed)
    return Linearised(
        shape=chain_shape(grid, panels),
        table=table,
        margin=torch.stack(margins, dim=1),
        margin_columns=margin_columns,
        unfairness=torch.stack(unfairness, dim=1).flatten(1),
        unfairness_columns=unfairness_columns.flatten(1, 2),
        constraints={},
        columns=columns,
        reach=tuple(reach),
    )


@dataclass(frozen=True)
class _Places:
    """Where a panel's own parameters are among its columns.

    Attributes:
        below: columns of the panels below.
        terms: free terms of the rib angle.
        lengths: free terms of the log ruling length, the corner's among them.
    """

    below: int
    terms: int
    lengths: int

    @property
    def size(self) -> int:
        return self.below + 1 + self.terms + self.lengths

    @property
    def rib(self) -> slice:
        return slice(self.below + 1, self.size - self.lengths)

    @property
    def length(self) -> slice:
        return slice(self.size - self.lengths, self.size)

    def wider(self, columns: Columns) -> Columns:
        """What depends on the panels below alone, with columns of zeros for the panel's own parameters."""
        return pad(columns, (0, self.size - self.below))


@dataclass(frozen=True)
class _Below:
    """What a panel stands on: the rates of its lower edge's reference frame, and how far that frame turns about its own
    axes T, U and V; by the parameters of the panels below.
    """

    speed: Columns
    k1: Columns
    k2: Columns
    w: Columns
    about_tangent: Columns
    about_u: Columns
    about_v: Columns


@dataclass(frozen=True)
class _Series:
    """A panel's rib angle and the angle's slope, by the terms of their series; its ruling length and the length's two
    derivatives by s, by the terms of theirs.
    """

    alpha: Columns
    alpha_slope: Columns
    t: Columns
    t_slope: Columns
    t_second: Columns

    @staticmethod
    def of(panel: ChainPanel, bases: Sequence[Tensor], corner: Sequence[Tensor]) -> "_Series":
        """`bases`: values at the nodes, slopes and second derivatives, (n, terms) each; `corner`: those of the corner's
        free parameters, which the last panel has, (batch, n, free) each.
        """
        basis, basis_slope, _ = logs = bases
        if corner:
            pairs = zip(bases, corner, strict=True)
            logs = [torch.cat((own.expand(len(more), -1, -1), more), dim=-1) for own, more in pairs]
        log, log_slope, log_second = logs
        saturation = (1 - panel.bounded * panel.bounded)[..., None]
        twice = (2 / RIB_LIMIT * panel.bounded * panel.lean_slope)[..., None]
        t, t_slope, t_second = (v[..., None] for v in (panel.strip.t, panel.t_slope, panel.t_second))
        return _Series(
            alpha=saturation * basis,
            alpha_slope=saturation * (basis_slope - twice * basis),
            t=t * log,
            t_slope=torch.addcmul(t * log_slope, t_slope, log),
            t_second=t_second * log + 2 * t_slope * log_slope + t * log_second,
        )


@dataclass(frozen=True)
class _Rolled:
    """A panel's roll and the rates of its surface's frame."""

    phi: Columns
    omega_xi: Columns
    omega_eta: Columns


@dataclass(frozen=True)
class _Ruled:
    """How a panel's rulings run: `back` is speed sin(alpha), `opening` speed cos(alpha)."""

    spin: Columns
    back: Columns
    opening: Columns
    p: Columns
    q: Columns


@dataclass(frozen=True)
class _Moving:
    """How far the frame of the rulings turns about d, d_max and eta."""

    about_d: Columns
    about_d_max: Columns
    about_eta: Columns


@dataclass(frozen=True)
class _Linear:
    """One panel, of which `strip` has the scalars with a last dimension of 1, beside columns."""

    panel: ChainPanel
    grid: StripGrid
    below: _Below
    places: _Places
    series: _Series
    strip: Strip

    def rolled(self) -> _Rolled:
        """The roll, which solves phi' = -w - omega_xi tan(alpha): its change delta fulfils delta' + a delta = h, and in
        the middle it is that of the panel's angle.
        """
        below, own, wider, width = self.below, self.strip, self.places.wider, self.places.below
        sine, cosine, slope = own.phi.sine, own.phi.cosine, own.alpha.tangent
        bending = torch.addcmul(below.k1 * sine, below.k2, cosine, value=-1)
        turning = torch.addcmul(below.k1 * cosine, below.k2, sine)
        by_rib = -own.omega_xi / own.alpha.cosine**2 * self.series.alpha
        h = torch.cat((-torch.addcmul(below.w, bending, slope), by_rib), dim=-1)
        factor = torch.exp(apply(self.grid.integral, own.omega_eta * slope).clamp(-40, 40))
        h = apply(self.grid.integral, factor * h)
        phi = torch.cat((h[..., :width], torch.ones_like(factor), h[..., width:]), dim=-1) / factor
        phi = pad(phi, (0, self.places.lengths))
        omega_xi = wider(bending).addcmul_(own.omega_eta, phi)
        return _Rolled(phi, omega_xi, wider(turning).addcmul_(own.omega_xi, phi, value=-1))

    def ruled(self, rolled: _Rolled) -> _Ruled:
        own, below, series = self.strip, self.below, self.series
        wider, rib, length = self.places.wider, self.places.rib, self.places.length
        spin = rolled.omega_eta.clone()
        spin[..., rib] += series.alpha_slope
        back, opening = wider(below.speed * own.alpha.sine), wider(below.speed * own.alpha.cosine)
        back[..., rib] += own.speed * own.alpha.cosine * series.alpha
        opening[..., rib] -= own.speed * own.alpha.sine * series.alpha
        p, q = -back, torch.addcmul(opening, own.t, spin, value=-1)
        p[..., length] += series.t_slope
        q[..., length] -= own.spin * series.t
        return _Ruled(spin, back, opening, p, q)

    def margin(self, ruled: _Ruled) -> tuple[Float[Tensor, "batch n"], Columns]:
        """The regularity margin q / opening itself, and its derivatives."""
        opening = self.strip.opening
        margin = self.strip.q / opening
        return margin[..., 0], torch.addcmul(ruled.q, margin, ruled.opening, value=-1).div_(opening)

    def upper(self, ruled: _Ruled, turn: UpperTurn) -> tuple[Columns, Columns]:
        """Speed of the upper edge, and how it turns in the panel: spin - beta'.

        Only what is smooth is differentiated on the grid, as in `brafit.geometry.strip.upper_turn`.
        """
        own, series, length = self.strip, self.series, self.places.length
        t_slope = self.panel.t_slope[..., None]
        back, opening, spin = (apply(self.grid.derivative, v) for v in (ruled.back, ruled.opening, ruled.spin))
        p_slope, q_slope = back.neg_(), opening.addcmul_(own.t, spin, value=-1)
        q_slope.addcmul_(t_slope, ruled.spin, value=-1)
        p_slope[..., length] += series.t_second
        q_slope[..., length] -= torch.addcmul(series.t_slope * own.spin, series.t, turn.spin)
        speed = (own.p * ruled.p).addcmul_(own.q, ruled.q).div_(own.next_speed)
        beta_slope = (ruled.p * turn.q).addcmul_(own.p, q_slope)
        beta_slope.sub_((ruled.q * turn.p).addcmul_(own.q, p_slope)).div_(own.next_speed**2)
        beta_slope.sub_(2 * turn.beta / own.next_speed * speed)
        return speed, ruled.spin - beta_slope

    def upper_unfairness(
        self, variation: Variation, rate: Columns, speed: Columns
    ) -> Float[Tensor, "batch intervals columns"]:
        """How the upper edge's curvature varies; the corner's place is the last column."""
        columns = variation.columns(rate, speed)
        if (corner := self.panel.corner) is not None:
            steps = variation.curvature.diff(dim=-1) / variation.lengths.sqrt()
            columns[..., -1] += steps * beside_corner(corner, self.grid.x)[1]
        return columns

    def moving(self, rolled: _Rolled) -> _Moving:
        below, places = self.below, self.places
        phi, alpha = self.strip.phi, self.strip.alpha
        about_xi = places.wider(torch.addcmul(below.about_u * phi.cosine, below.about_v, phi.sine))
        about_eta = places.wider(torch.addcmul(below.about_v * phi.cosine, below.about_u, phi.sine, value=-1))
        about_eta[..., places.rib] += self.series.alpha
        about_tangent = rolled.phi + places.wider(below.about_tangent) if places.below else rolled.phi
        return _Moving(
            about_d=torch.addcmul(about_xi * alpha.cosine, about_tangent, alpha.sine, value=-1),
            about_d_max=torch.addcmul(about_xi * alpha.sine, about_tangent, alpha.cosine),
            about_eta=about_eta,
        )

    def place(self, moving: _Moving, lower: Tensor, upper: Tensor) -> None:
        """Fill in the derivatives of the upper edge, from those of the lower one; both (batch, n, 3, size)."""
        panel, t = self.panel, self.strip.t
        upper.copy_(lower)
        _add_vectors(upper, panel.eta, t * moving.about_d_max)
        _add_vectors(upper, panel.d_max, t * moving.about_eta, -1)
        _add_vectors(upper[..., self.places.length], panel.d, self.series.t)

    def place_tangents(self, moving: _Moving, ruled: _Ruled, tangents: Tensor) -> None:
        """Fill in those of the upper edge's tangents p d + q d_max, (batch, n, 3, size), which are zero."""
        panel, p, q = self.panel, self.strip.p, self.strip.q
        _add_vectors(tangents, panel.d, torch.addcmul(ruled.p, q, moving.about_eta))
        _add_vectors(tangents, panel.d_max, torch.addcmul(ruled.q, p, moving.about_eta, value=-1))
        _add_vectors(tangents, panel.eta, torch.addcmul(p * moving.about_d_max, q, moving.about_d, value=-1))

    def above(self, rolled: _Rolled, ruled: _Ruled, moving: _Moving, speed: Columns) -> _Below:
        """What the next panel stands on."""
        own, sine, cosine, own_bend = self.strip, self.strip.beta.sine, self.strip.beta.cosine, self.strip.bend
        beta = (cosine * ruled.p).addcmul_(sine, ruled.q).neg_().div_(own.next_speed)
        bend = rolled.omega_xi / own.alpha.cosine
        bend[..., self.places.rib] += own_bend * own.alpha.tangent * self.series.alpha
        return _Below(
            speed=speed,
            k1=ruled.spin - apply(self.grid.derivative, beta),
            k2=torch.addcmul(sine * own_bend * beta, cosine, bend, value=-1),
            w=-torch.addcmul(cosine * own_bend * beta, sine, bend),
            about_tangent=torch.addcmul(cosine * moving.about_d_max, sine, moving.about_d, value=-1),
            about_u=torch.addcmul(cosine * moving.about_d, sine, moving.about_d_max),
            about_v=moving.about_eta - beta,
        )


def _tall(scalars: Scalars) -> Scalars:
    """The same with a last dimension of 1, to be multiplied by columns."""
    if isinstance(scalars, Tensor):
        return scalars[..., None]
    return type(scalars)(**{name: _tall(value) for name, value in vars(scalars).items()})


def _add_vectors(
    table: Float[Tensor, "*batch 3 k"],
    vector: Float[Tensor, "*batch 3"],
    factors: Float[Tensor, "*batch k"],
    sense: int = 1,
) -> None:
    """Add a multiple of the vector to each of the k columns, or take it away with `sense` -1."""
    table.addcmul_(vector[..., None], factors[..., None, :], value=sense)
