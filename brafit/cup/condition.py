"""Geometric conditions on cups, as residuals that a fit drives to zero, in solver units."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from brafit.geometry.developable import dot, regularity, unit

from brafit.cup.shape import CupShape

Points = Float[Tensor, "batch m 3"]


@torch.no_grad()
def nearest_on_polyline(
    points: Points, line: Float[Tensor, "batch k 3"]
) -> tuple[Int[Tensor, "batch m"], Float[Tensor, "batch m"]]:
    """Nearest segment of a polyline and the place on it in [0, 1], for every point."""
    start, step = line[:, None, :-1], (line[:, 1:] - line[:, :-1])[:, None]
    offset = points[:, :, None] - start
    place = (dot(offset, step) / dot(step, step).clamp_min(1e-30)).clamp(0, 1)
    squared = dot(offset, offset) + place * (place * dot(step, step) - 2 * dot(offset, step))
    segment = squared.argmin(-1, keepdim=True)
    return segment[..., 0], place.gather(-1, segment)[..., 0]


def polyline_points(line: Float[Tensor, "batch k 3"], segment: Tensor, place: Tensor) -> Points:
    """Points of a polyline by segment and place."""
    index = segment[..., None].expand(*segment.shape, 3)
    return torch.lerp(line.gather(1, index), line.gather(1, index + 1), place[..., None])


def line_offset(points: Points, line: Float[Tensor, "batch k 3"]) -> Points:
    """Difference vectors from the nearest points of a polyline to `points`, differentiable in both.

    Where the nearest point lies inside a segment only the component across the segment counts (the point may slide along the
    line), which has the same length and the envelope theorem's gradient.
    """
    segment, place = nearest_on_polyline(points.detach(), line.detach())
    delta = points - polyline_points(line, segment, place)
    with torch.no_grad():
        index = segment[..., None].expand(*segment.shape, 3)
        along = unit(line.gather(1, index + 1) - line.gather(1, index))
        sliding = ((place > 0) & (place < 1))[..., None] * along
    return delta - dot(delta, sliding)[..., None] * sliding


def upper_edge_offsets(shape: CupShape, neckline: Points) -> tuple[Points, Points]:
    """From upper edge to neckline and from neckline to upper edge: pulled both ways."""
    edge = shape.edges[:, -1]
    return line_offset(edge, neckline), line_offset(neckline, edge)


def margin_shortfall(shape: CupShape, bound: float, width: float) -> Float[Tensor, "batch panels*n"]:
    """Smooth barrier: about bound - margin where the regularity margin is below its bound, fading to 0 over `width` above it."""
    margin = regularity(shape.tangents[:, :-1], shape.tangents[:, 1:], shape.directions)
    return (width * torch.nn.functional.softplus((bound - margin) / width)).flatten(1)
