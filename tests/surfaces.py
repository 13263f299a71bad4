"""Developable panels known in closed form, together with the plane they come from.

A developable surface is a ruled surface P(a, r) = base(a) + r ruling(a) that is isometric to a plane region
Q(a, r) = flat_base(a) + r flat_ruling(a). An edge is a function r(s) on it. Everything that the package computes from
edges in space is known here from the surface and from the plane: the rib angle is an angle in the plane, the geodesic
curvature is the curvature of the plane curve, and the other two rates follow from the surface's one principal
curvature k by Euler's formula:

    omega_xi = -k cos(alpha)^2,   omega_eta = plane curvature,   omega_zeta = k cos(alpha) sin(alpha).

Derivatives by s are those of automatic differentiation, exact to round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from brafit.cup.shape import CupShape

Function = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Surface:
    """A developable surface.

    Attributes:
        base, ruling: (n) -> (n, 3), the rulings of unit length.
        flat_base, flat_ruling: (n) -> (n, 2), the same laid flat.
        normal: (n) -> (n, 3), the normal that looks at the reader where the plane does.
        curvature: (a, r) -> principal curvature k towards that normal.
        margin: (lower r, upper r) -> regularity margin A(t_max) / A(0).
    """

    base: Function
    ruling: Function
    flat_base: Function
    flat_ruling: Function
    normal: Function
    curvature: Callable[[Tensor, Tensor], Tensor]
    margin: Callable[[Tensor, Tensor], Tensor]


def stack(*parts: Tensor) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*parts), dim=-1)


def cylinder(radius: float) -> Surface:
    """About the z axis; laid flat, rulings are vertical."""
    zero = torch.zeros_like
    return Surface(
        base=lambda a: stack(radius * torch.cos(a), radius * torch.sin(a), zero(a)),
        ruling=lambda a: stack(zero(a), zero(a), torch.ones_like(a)),
        flat_base=lambda a: stack(radius * a, zero(a)),
        flat_ruling=lambda a: stack(zero(a), torch.ones_like(a)),
        normal=lambda a: stack(torch.cos(a), torch.sin(a), zero(a)),
        curvature=lambda a, r: torch.full_like(a, -1 / radius),
        margin=lambda low, high: torch.ones_like(low),
    )


def cone(half_angle: float) -> Surface:
    """Apex in the origin, axis z; laid flat a sector, a the polar angle there and r the distance from the apex."""
    sine, cosine = math.sin(half_angle), math.cos(half_angle)

    def ruling(a: Tensor) -> Tensor:
        turn = a / sine
        return stack(sine * torch.cos(turn), sine * torch.sin(turn), torch.full_like(a, cosine))

    return Surface(
        base=lambda a: 0 * ruling(a),
        ruling=ruling,
        flat_base=lambda a: stack(0 * a, 0 * a),
        flat_ruling=lambda a: stack(torch.cos(a), torch.sin(a)),
        normal=lambda a: stack(-cosine * torch.cos(a / sine), -cosine * torch.sin(a / sine), torch.full_like(a, sine)),
        curvature=lambda a, r: cosine / sine / r,
        margin=lambda low, high: high / low,
    )


def helix_tangents(bend: float, torsion: float) -> Surface:
    """Tangent developable of the helix of this curvature and torsion, by its arc length a; r > 0 is the forward half.

    Laid flat, the helix (the edge of regression) is the circle of the same curvature and the rulings are its tangents.
    """
    total = bend**2 + torsion**2
    rate, radius, climb = math.sqrt(total), bend / total, torsion / math.sqrt(total)
    around = bend / rate
    return Surface(
        base=lambda a: stack(radius * torch.cos(rate * a), radius * torch.sin(rate * a), climb * a),
        ruling=lambda a: stack(-around * torch.sin(rate * a), around * torch.cos(rate * a), torch.full_like(a, climb)),
        flat_base=lambda a: stack(torch.cos(bend * a), torch.sin(bend * a)) / bend,
        flat_ruling=lambda a: stack(-torch.sin(bend * a), torch.cos(bend * a)),
        normal=lambda a: stack(climb * torch.sin(rate * a), -climb * torch.cos(rate * a), torch.full_like(a, around)),
        curvature=lambda a, r: torsion / (bend * r),
        margin=lambda low, high: high / low,
    )


@dataclass(frozen=True)
class Panel:
    """A panel between two edges of a developable surface, at n values of s.

    Attributes:
        s: the common parameter of both edges, not their arc length.
        lower, upper: edges (n, 3); lower_tangent, upper_tangent their derivatives by s; lower_second the second one.
        directions, normals: unit rulings from lower to upper, and unit normals zeta x xi.
        rib, omega, principal: rib angle (n), rates (n, 3) and principal curvature (n) at the lower edge.
        margin: regularity margin (n).
        flat_lower, flat_upper: edges laid flat (n, 2), start of the lower one in the origin and its chord along +v.
    """

    s: Tensor
    lower: Tensor
    upper: Tensor
    lower_tangent: Tensor
    upper_tangent: Tensor
    lower_second: Tensor
    directions: Tensor
    normals: Tensor
    rib: Tensor
    omega: Tensor
    principal: Tensor
    margin: Tensor
    flat_lower: Tensor
    flat_upper: Tensor

    @property
    def lengths(self) -> Tensor:
        return (self.upper - self.lower).norm(dim=-1)

    @property
    def curvature(self) -> Tensor:
        """Curvature vector of the lower edge, from the rates: zeta' = omega_eta xi - omega_xi eta."""
        tangent = self.lower_tangent / self.lower_tangent.norm(dim=-1, keepdim=True)
        xi = torch.linalg.cross(self.normals, tangent)
        return self.omega[:, 1:2] * xi - self.omega[:, :1] * self.normals

    @property
    def shape(self) -> CupShape:
        """A cup of this one panel."""
        return CupShape(
            stations=self.s,
            edges=torch.stack((self.lower, self.upper)),
            tangents=torch.stack((self.lower_tangent, self.upper_tangent)),
            directions=self.directions[None],
            normals=self.normals[None],
            geodesic=self.omega[None, :, 1],
        )


def derivative(function: Function) -> Function:
    """By s, of a function that treats every s alone."""
    return lambda s: torch.func.jvp(function, (s,), (torch.ones_like(s),))[1]


def panel(surface: Surface, s: Tensor, place: Function, low: Function, high: Function) -> Panel:
    """The panel between the edges r = low(s) and r = high(s) on the rulings a = place(s).

    In the plane it must lie to the left of its lower edge: that fixes which way a runs, and is checked.
    """

    def edge(r: Function, base: Function, ruling: Function) -> Function:
        return lambda s: base(place(s)) + r(s)[:, None] * ruling(place(s))

    lower, upper = (edge(r, surface.base, surface.ruling) for r in (low, high))
    flat_lower, flat_upper = (edge(r, surface.flat_base, surface.flat_ruling) for r in (low, high))
    a, sign = place(s), torch.sign((high(s) - low(s)).sum())
    first, second = derivative(flat_lower)(s), derivative(derivative(flat_lower))(s)
    speed = first.norm(dim=-1)
    forward = first / speed[:, None]
    left = stack(-forward[:, 1], forward[:, 0])
    flat_direction = sign * surface.flat_ruling(a)
    rib = torch.atan2(-(flat_direction * forward).sum(-1), (flat_direction * left).sum(-1))
    assert (rib.abs() < math.pi / 2).all(), "the panel does not lie to the left of its lower edge"
    principal = surface.curvature(a, low(s))
    bend = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    cosine, sine = torch.cos(rib), torch.sin(rib)
    start, chord = flat_lower(s)[0], flat_lower(s)[-1] - flat_lower(s)[0]
    v = chord / chord.norm()
    axes = torch.stack((v, stack(-v[1], v[0])))
    return Panel(
        s=s,
        lower=lower(s),
        upper=upper(s),
        lower_tangent=derivative(lower)(s),
        upper_tangent=derivative(upper)(s),
        lower_second=derivative(derivative(lower))(s),
        directions=sign * surface.ruling(a),
        normals=surface.normal(a),
        rib=rib,
        omega=stack(-principal * cosine**2, bend, principal * cosine * sine),
        principal=principal,
        margin=surface.margin(low(s), high(s)),
        flat_lower=(flat_lower(s) - start) @ axes.mT,
        flat_upper=(flat_upper(s) - start) @ axes.mT,
    )


def _wavy(s: Tensor) -> Tensor:
    return 2 + 0.3 * torch.cos(2 * s) + 0.1 * torch.sin(3 * s)


def _lens(surface: Surface, direction: float, height: float) -> Callable[[Tensor], Panel]:
    """A panel with a wavy lower edge whose two edges meet at both ends, s = 0 and s = pi."""

    def make(s: Tensor) -> Panel:
        return panel(surface, s, lambda s: direction * s, _wavy, lambda s: _wavy(s) + height * torch.sin(s))

    return make


LENSES: dict[str, Callable[[Tensor], Panel]] = {
    "cylinder": _lens(cylinder(1.3), 1.0, 0.8),
    "cone, towards the apex": _lens(cone(0.6), 1.0, -0.9),
    "cone, away from the apex": _lens(cone(0.6), -1.0, 0.9),
    "helix, towards the edge of regression": _lens(helix_tangents(0.8, 0.5), 1.0, -0.9),
    "helix, away from the edge of regression": _lens(helix_tangents(0.8, -0.5), -1.0, 0.9),
}
"""Makers of panels, all of whose edges meet at both ends: s (n, within [0, pi]) -> Panel."""


def stations(n: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.linspace(0, math.pi, n, dtype=dtype)
