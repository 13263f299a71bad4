"""Developable panels between two edges: rib angle, twist, regularity: (11)-(18) and (66)
of docs/formulation.md.

Along an edge: T the unit tangent (zeta), d the unit ruling direction, xi the unit vector across the panel in its
tangent plane, eta = zeta x xi the normal, so that xi = eta x zeta and d = -zeta sin(alpha) + xi cos(alpha).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

Vectors = Float[Tensor, "*batch n 3"]
Values = Float[Tensor, "*batch n"]


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Scalar products. (A product with ones: sums over so short a last dimension are several times slower.)"""
    product = a * b
    return product @ product.new_ones(product.shape[-1])


def heading(y: Values, x: Values, size: Values) -> Values:
    """atan2(y, x), where `size` is the length of (x, y): from tangents of half the angle, since the library's own is
    rounded by where in a batch a number stands.
    """
    ahead = x >= 0
    above = torch.where(ahead, y, size - x)
    below = torch.where(ahead, size + x, y)
    return 2 * torch.atan(above / below)


def unit(v: Tensor) -> Tensor:
    """v / |v|; a zero vector stays zero, with zero gradient."""
    squared = dot(v, v)[..., None]
    zero = squared == 0
    return torch.where(zero, torch.zeros_like(v), v / torch.where(zero, torch.ones_like(squared), squared).sqrt())


def rulings(lower: Vectors, upper: Vectors, lower_tangent: Vectors, upper_tangent: Vectors) -> Vectors:
    """Unit ruling directions g / |g|, (14), from the lower to the upper edge.

    Where the edges meet (the two ends) the ruling has no direction of its own; its limit is that of the difference of
    the tangents d edge / ds, pointing into the panel.

    Args:
        lower: positions of the lower edge, the first and the last at the ends where the edges meet.
        upper: positions of the upper edge at the same s.
        lower_tangent: derivatives of the lower edge by s.
        upper_tangent: derivatives of the upper edge by s.
    """
    g = upper - lower
    change = upper_tangent - lower_tangent
    inner = g[..., 1:-1, :]
    g = torch.cat((change[..., :1, :], inner, -change[..., -1:, :]), dim=-2)
    return unit(g)


def rib_angle(tangent: Vectors, direction: Vectors) -> Values:
    """alpha in radians, (18): positive where the ruling leans back against the edge's direction.

    Args:
        tangent: edge tangents (any length).
        direction: unit ruling directions.
    """
    return -torch.asin(dot(unit(tangent), direction).clamp(-1, 1))


def across(tangent: Vectors, direction: Vectors) -> Vectors:
    """xi: the unit vector in the panel's tangent plane at right angles to the edge, on the panel's side.

    Args:
        tangent: edge tangents (any length).
        direction: unit ruling directions.
    """
    t = unit(tangent)
    return unit(direction - dot(t, direction)[..., None] * t)


def normals(tangent: Vectors, direction: Vectors) -> Vectors:
    """eta = zeta x xi, the unit surface normal.

    Args:
        tangent: edge tangents (any length).
        direction: unit ruling directions.
    """
    return unit(torch.linalg.cross(tangent, direction))


def geodesic_curvature(tangent: Vectors, curvature: Vectors, direction: Vectors) -> Values:
    """omega_eta = curvature . xi: the curvature that the edge keeps when the panel is laid flat.

    Args:
        tangent: edge tangents (any length).
        curvature: d zeta / d arc length, from `curvature_vector`.
        direction: unit ruling directions.
    """
    return dot(curvature, across(tangent, direction))


def curvature_vector(tangent: Vectors, second: Vectors) -> Vectors:
    """d zeta / d arc length from the first and second derivatives of a curve by any parameter.

    Args:
        tangent: first derivatives.
        second: second derivatives by the same parameter.
    """
    squared = dot(tangent, tangent)[..., None]
    along = dot(second, tangent)[..., None] / squared
    return (second - along * tangent) / squared


def twist_determinant(lower_tangent: Vectors, upper_tangent: Vectors, direction: Vectors) -> Values:
    """det(zeta_a, zeta_b, d), (17) with unit vectors: zero where the panel is developable.

    Args:
        lower_tangent: of the lower edge, of any length.
        upper_tangent: of the upper edge, of any length.
        direction: unit ruling directions.
    """
    return dot(torch.linalg.cross(unit(lower_tangent), unit(upper_tangent)), direction)


def twist_angle(lower_tangent: Vectors, upper_tangent: Vectors, direction: Vectors) -> Values:
    """Angle in radians between the surface normals at the two ends of a ruling.

    Args:
        lower_tangent: of the lower edge, of any length.
        upper_tangent: of the upper edge, of any length.
        direction: unit ruling directions.
    """
    a, b = normals(lower_tangent, direction), normals(upper_tangent, direction)
    return torch.atan2(torch.linalg.cross(a, b).norm(dim=-1), dot(a, b))


def regularity(lower_tangent: Vectors, upper_tangent: Vectors, direction: Vectors) -> Values:
    """Margin A(t_max) / A(0), (66): how far the rulings are from crossing inside the panel.

    A(t) is the speed of the surface point at t across the ruling as s grows; it is linear in t. 1 for parallel
    rulings (a cylinder), 0 where the upper edge touches the edge of regression, negative where rulings cross.

    Args:
        lower_tangent: derivatives of the lower edge by s.
        upper_tangent: derivatives of the upper edge by the same s.
        direction: unit ruling directions.
    """
    normal = torch.linalg.cross(lower_tangent, direction)
    return dot(torch.linalg.cross(upper_tangent, direction), normal) / dot(normal, normal)
