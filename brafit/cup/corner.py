"""The corner of an upper edge: terms of the last panel's log ruling length, height |a| + jump a |a| / 2, rounded off,
where a = x - place and x in [-1, 1] runs along the wire.

The height turns the edge at the corner, the jump sets the edge's curvature on either side of it apart. Without the
jump the smooth series would have to, and would swing all along the edge.

The edge turns within the rounding, narrower than the nodes are apart. Its curvature there would be seen where a node is
near, and missed elsewhere, so that the corner would stick to nodes, and which node would be chance. So second
derivatives, which only fairness asks for, leave the turn out.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.cup.edge_gaps import Gaps
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH
from brafit.geometry.products import evenly, weighted_rows

CORNER_SIZE = 3
"""Parameters of a corner: height, jump, place. They come last."""
CORNER_WIDTH = 0.03
"""Rounding of the upper edge's corner, as a share of half the wire."""
CORNER_FREE = 0.12
"""Within about this share of half the wire of the corner the upper edge's fairness does not count."""
CORNER_REACH = 0.8
"""The corner stays within this share of half the wire from its middle."""


def cornered(
    logs: Sequence[Float[Tensor, "batch n"]], corner: Float[Tensor, "batch 3"], x: Float[Tensor, " n"]
) -> tuple[Tensor, ...]:
    """A log length and its two derivatives by s with the corner's terms; the second without the turn at the corner.

    Args:
        logs: values, first and second derivatives by s at the places x.
        corner: height, jump and place.
        x: places along the wire, in [-1, 1].
    """
    extra = corner_columns(corner, x)
    height, jump = corner[:, :1], corner[:, 1:2]
    pairs = zip(logs, extra, strict=True)
    return tuple(log + height * columns[..., 0] + jump * columns[..., 1] for log, columns in pairs)


def corner_columns(corner: Float[Tensor, "batch 3"], x: Float[Tensor, " n"]) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives of a log length and of its two derivatives by s, as `cornered` has them, by the corner's parameters,
    in the last dimension. The first two are the corner's terms at height and jump 1.
    """
    height, jump, place = corner.split(1, dim=-1)
    away = x - place
    square = (away * away + CORNER_WIDTH**2).reciprocal()
    root = square.sqrt()
    along, bend = away * root, CORNER_WIDTH**2 * square * root
    # rounded |a|, its slope and its bend; and those of a |a| / 2
    size = 1 / root
    half, half_slope = 0.5 * away * size, 0.5 * (size + away * along)
    half_bend = along * (1.5 - 0.5 * along * along)
    steeper = 1.5 * bend * CORNER_WIDTH**2 * square  # the slope of that
    value = torch.stack((size, half, -height * along - jump * half_slope), dim=-1)
    slope = torch.stack((along, half_slope, -height * bend - jump * half_bend), dim=-1)
    second = torch.stack((torch.zeros_like(bend), half_bend, -jump * steeper), dim=-1)
    return value, slope * (2 / LENGTH), second * (2 / LENGTH) ** 2


def beside_corner(corner: Float[Tensor, "batch 3"], x: Float[Tensor, " n"]) -> tuple[Tensor, Tensor]:
    """How much each interval between nodes counts in the upper edge's fairness: hardly about the corner, which is no
    bend; and the derivative by the corner's place.
    """
    away = 0.5 * (x[1:] + x[:-1]) - corner[:, -1:]
    square = (away / CORNER_FREE) * (away / CORNER_FREE)
    power = square * square  # a power's rounding would depend on where in a batch it is taken
    root = (1 + power * power).rsqrt()
    return power * root, -4 * away**3 / CORNER_FREE**4 * (root * root * root)


def corner_gap(
    corner: Float[Tensor, "batch 3"],
    shape: CupShape,
    points: Float[Tensor, "batch 3"],
    x: Float[Tensor, " n"],
    analysis: Float[Tensor, "n n"],
) -> Gaps:
    """From points to the upper edge's corner.

    There the upper edge is the lower one plus a ruling. Without the corner's factor, the exponential of its terms,
    rulings vary smoothly, so that they are interpolated between the nodes x.

    Args:
        corner: height, jump and place, x in [-1, 1].
        shape: the cups at the nodes.
        points: one a cup, solver units.
        x: the nodes, in [-1, 1].
        analysis: values at the nodes -> Chebyshev coefficients.
    """
    n, last = len(x), shape.panels
    height, jump, place = corner.split(1, dim=-1)
    place = place.clamp(-CORNER_REACH, CORNER_REACH)
    turn = evenly(torch.arccos, place)
    order = torch.arange(n, dtype=place.dtype, device=place.device)
    series = analysis.expand(len(place), -1, -1)
    cardinal = weighted_rows(torch.cos(order * turn), series)
    slope = weighted_rows(order * torch.sin(order * turn) / evenly(torch.sin, turn), series)
    away = x - place
    r = (away * away + CORNER_WIDTH**2).sqrt()
    half = 0.5 * away * r
    factor = torch.exp(height * (CORNER_WIDTH - r) - jump * half)
    weight = torch.cat((cardinal * (1 - factor), cardinal * factor), dim=-1)
    own = shape.edges[:, -2:].flatten(1, 2)
    vectors = weighted_rows(weight, own) - points
    with torch.no_grad():
        rulings = shape.edges[:, -1] - shape.edges[:, -2]
        by_height = weighted_rows(cardinal * factor * (CORNER_WIDTH - r), rulings)[:, None]
        by_jump = weighted_rows(-cardinal * factor * half, rulings)[:, None]
        steep = height * away / r + jump * 0.5 * (r + away * away / r)
        along = slope * factor + cardinal * factor * steep
        by_place = (weighted_rows(slope, shape.edges[:, -2]) + weighted_rows(along, rulings))[:, None]
        rows = torch.arange((last - 1) * n, (last + 1) * n, device=place.device)
    return Gaps(
        vectors=vectors[:, None],
        index=rows.expand(len(corner), 1, -1),
        weight=weight[:, None],
        sliding=torch.zeros_like(vectors[:, None]),
        own=torch.stack((by_height, by_jump, by_place), dim=-1),
    )
