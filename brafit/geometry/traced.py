"""Smooth curves near polylines as tensors, differentiable in the polylines' points.

The same curves as `brafit.geometry.smoothing`, `brafit.geometry.polyline` and `brafit.cup.wire` make of arrays, to
round-off. In double precision, on the CPU.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from brafit.geometry.grid import (
    chebyshev_analysis,
    chebyshev_integral,
    chebyshev_points,
    chebyshev_synthesis,
)
from brafit.geometry.smoothing import TERMS, roughness

Line = Float[Tensor, "k 3"]
ARC_NODES = 200
"""Chebyshev points on which arc length is integrated."""
_INVERSIONS = 6
"""Newton steps from the share of the polyline to that of the arc length, which are all but the same."""


def chords_of(line: Float[Tensor, "k d"]) -> Float[Tensor, " k-1"]:
    """Lengths of a polyline's segments."""
    return line.diff(dim=0).norm(dim=-1)


def traced_series(line: Line, smoothing: Tensor | float) -> Float[Tensor, "terms 3"]:
    """Chebyshev coefficients of the smooth curve of `smooth_series`, by the share of the polyline's length.

    Args:
        line: distinct points.
        smoothing: as in `smooth_series`.
    """
    chords = chords_of(line)
    length = torch.cat((chords.new_zeros(1), chords.cumsum(0)))
    x = 2 * length / length[-1] - 1
    terms = min(TERMS, len(line))
    values = _polynomials(terms, x)
    weights = torch.cat((chords[:1], chords[1:] + chords[:-1], chords[-1:])) / (2 * chords.sum())
    rough = torch.from_numpy(roughness(terms))
    normal = values.mT @ (weights[:, None] * values) + torch.as_tensor(smoothing).clamp_min(1e-12) * rough
    ends = values[[0, -1]]
    system = torch.cat((torch.cat((normal, ends.mT), 1), torch.cat((ends, ends.new_zeros(2, 2)), 1)))
    right = torch.cat((values.mT @ (weights[:, None] * line), line[[0, -1]]))
    return torch.linalg.solve(system, right)[:terms]


def _polynomials(terms: int, x: Float[Tensor, " k"]) -> Float[Tensor, "k terms"]:
    """Chebyshev polynomials at x, by their recurrence: arc cosines have no derivative at the ends."""
    values = [torch.ones_like(x), x]
    for _ in range(terms - 2):
        values.append(2 * x * values[-1] - values[-2])
    return torch.stack(values[:terms], dim=1)


def by_arc_length(series: Float[Tensor, "terms 3"], count: int) -> tuple[Float[Tensor, "count 3"], Float[Tensor, ""]]:
    """Positions at the Chebyshev points of the arc length, and the length, of a curve given as a Chebyshev series.

    Args:
        series: of the positions, by a parameter in [-1, 1] that is about the share of the arc length.
        count: Chebyshev points of the arc length.
    """
    x = chebyshev_points(ARC_NODES)
    slope = torch.from_numpy(chebyshev_synthesis(len(series), x, 1))
    speed = (slope @ series).norm(dim=-1)
    arc = torch.from_numpy(chebyshev_integral(ARC_NODES)) @ speed
    analysis = torch.from_numpy(chebyshev_analysis(ARC_NODES))
    coefficients, speeds = analysis @ arc, analysis @ speed
    share = torch.from_numpy((chebyshev_points(count) + 1) / 2)
    place = torch.from_numpy(chebyshev_points(count).copy())
    with torch.no_grad():
        for _ in range(_INVERSIONS):
            place = place - _arc_step(coefficients, speeds, place, share, arc[-1])
    # the step that is left is zero; its derivatives are the places'
    inner = (place - _arc_step(coefficients, speeds, place, share, arc[-1]))[1:-1]
    place = torch.cat((inner.new_tensor([-1.0]), inner, inner.new_tensor([1.0])))
    return _polynomials(len(series), place) @ series, arc[-1]


def _arc_step(coefficients: Tensor, speeds: Tensor, place: Tensor, share: Tensor, length: Tensor) -> Tensor:
    """Newton's step from places to those whose arc lengths are these shares of the whole."""
    basis = _polynomials(len(coefficients), place.clamp(-1, 1))
    return (basis @ coefficients - share * length) / (basis @ speeds).detach()


def spaced(line: Float[Tensor, "k d"], count: int) -> Float[Tensor, "count d"]:
    """Points at equal arc length along a polyline, ends included: `evenly_spaced`."""
    chords = chords_of(line)
    arc = torch.cat((chords.new_zeros(1), chords.cumsum(0)))
    at = torch.linspace(0, 1, count, dtype=line.dtype) * arc[-1]
    segment = (torch.searchsorted(arc.detach(), at.detach(), right=True) - 1).clamp(0, len(chords) - 1)
    share = ((at - arc[segment]) / chords[segment])[:, None]
    return line[segment] + share * line.diff(dim=0)[segment]


def dense(series: Float[Tensor, "terms 3"], count: int) -> Float[Tensor, "count 3"]:
    """Points of a Chebyshev series, evenly spaced in its parameter."""
    return _polynomials(len(series), torch.linspace(-1, 1, count, dtype=series.dtype)) @ series
