"""What is asked of a cup's edges beside closeness to a scan: fair ones, (68), and those of a plain cup where data say
little, (69) of docs/formulation.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from jaxtyping import Float
from torch import Tensor

from brafit.cup.base import Cup, Linearised
from brafit.fitting.block import Block
from brafit.fitting.loss import smooth_absolute, square

FAIRNESS = 4e-6
"""Weight of the variation of the flat edges' curvature (`brafit.geometry.fairness`) at `Conditions.fairness` 1."""
WAVES = 4.0
"""How much the size of every change of curvature counts beside its square, see `wavy`."""
WAVE_SLOPE = 0.5
"""Changes of curvature per s that are smaller than this count by their square alone."""
PLAINNESS = 3e-3
"""Weight of what sets a cup apart from the plain one (`Cup.plain`) at `Conditions.fairness` 1, see `plainness`."""
FEW = 3
"""Panels up to which plainness falls with their number alone."""


@dataclass(frozen=True)
class Shares:
    """How much of these weights counts while a stage of a fit runs, see `brafit.fitting.lm.LMStage`."""

    fairness: float = 1.0
    plainness: float = 1.0
    waves: float = 1.0
    seam: float = 1.0


def fairness_blocks(
    cup: Cup,
    flat: Float[Tensor, "batch size"],
    unfairness: Float[Tensor, "batch m"],
    strength: float,
    shares: Shares,
    height: Float[Tensor, " batch"],
) -> list[Block]:
    """The blocks of fairness and plainness.

    Args:
        cup: the cup model.
        flat: its parameters.
        unfairness: `Cup.unfairness` of these.
        strength: `Conditions.fairness`, more than 0.
        shares: how much counts at present.
        height: mean height of the breasts over their wires' planes, solver units.
    """
    spans = cup.spans
    losses = (square if spans is None else partial(wavy, spans=spans, share=share) for share in (shares.waves, 1.0))
    fair, final = (
        Block("fairness", unfairness, strength * FAIRNESS, "fairness", loss, rows=_unfairness_rows) for loss in losses
    )
    blocks = [replace(fair, weight=shares.fairness * strength * FAIRNESS, final=final)]
    if (plain := cup.plain(height)) is not None:
        away = (flat - plain[0]) * plain[1]
        weight = strength * plainness(cup.panels)
        final = Block("plainness", away, weight, "fairness", diagonal=plain[1])
        blocks.append(replace(final, weight=shares.plainness * weight, final=final))
    return blocks


def plainness(panels: int) -> float:
    """Its weight with so many panels, at `Conditions.fairness` 1: the fewer panels, the less close the cup, and the
    less data say about it. With more than FEW it falls faster: there the plain cup would win over closer ones.
    """
    return PLAINNESS / panels * min(1.0, FEW / panels)


def wavy(squared: Tensor, spans: Float[Tensor, " m"], share: float = 1.0) -> tuple[Tensor, Tensor]:
    """rho of changes of curvature: their squares, and their sizes, rounded off.

    The square hardly counts a small wave beside the bends that a breast asks for. The sizes add up to the curvature's
    total variation, which every wave adds to, and which is the same however steeply curvature rises to a bend.

    Args:
        squared: squared changes over spans.
        spans: of s, that the changes are taken over.
        share: how much the sizes count, times WAVES.
    """
    root = spans.sqrt()
    rho, slope = smooth_absolute(squared, WAVE_SLOPE * root)
    count = share * WAVES * root
    return squared + count * rho, 1 + count * slope


def _unfairness_rows(linear: Linearised) -> Float[Tensor, "batch m columns"]:
    return linear.unfairness_columns
