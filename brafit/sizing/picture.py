"""Pictures of sizes: the cups in one scale, and how well k of them serve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray

from brafit.report.figures import FAINT, INK, SOFT
from brafit.sizing.nest import Layer
from brafit.sizing.service import Step

COLUMNS = 6
"""Cups in a row at most."""
VIEWS = ((1, 0, -1), (1, 2, 1))
"""Axes that run to the right and up, and the sign of the latter: from the front, and from below."""


def cups_figure(
    cups: Sequence[Float[ndarray, "edges n 3"]], layers: Sequence[Layer], captions: Sequence[str]
) -> Figure:
    """Cups by size, each from the front (wire below) and from below (chest at the foot), all in one scale.

    Args:
        cups: edges from the wire up, cup frame, mm.
        layers: of the nest, for names and colours.
        captions: some words for each.
    """
    columns = min(COLUMNS, len(cups))
    rows = math.ceil(len(cups) / columns)
    centred = [edges - (edges.reshape(-1, 3).min(0) + edges.reshape(-1, 3).max(0)) / 2 for edges in cups]
    half = max(float(np.abs(edges).max()) for edges in centred) * 1.08
    figure = Figure(figsize=(2.5 * columns, 5.0 * rows), layout="constrained")
    axes = figure.subplots(2 * rows, columns, squeeze=False)
    for place in axes.flat:
        place.set_axis_off()
    for k, (edges, layer, caption) in enumerate(zip(centred, layers, captions, strict=True)):
        for view, (right, up, sign) in enumerate(VIEWS):
            place = axes[2 * (k // columns) + view, k % columns]
            _draw(place, edges[..., [right, up]] * (1, sign), layer.colour)
            place.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        title = axes[2 * (k // columns), k % columns].set_title(f"{layer.name}\n{caption}", fontsize=9, color=INK)
        title.set_parse_math(False)
    bar = axes[1, 0]
    bar.plot((-half, -half + 50), (-0.95 * half,) * 2, color=INK, linewidth=2)
    bar.text(-half, -0.9 * half, "50 mm", fontsize=8, color=INK)
    return figure


def _draw(axes: Axes, edges: Float[ndarray, "edges n 2"], colour: str) -> None:
    for lower, upper in pairwise(edges):
        axes.fill(*np.concatenate((lower, upper[::-1])).T, color=colour, alpha=0.12, linewidth=0)
        for k in np.linspace(0, len(lower) - 1, 15).astype(int)[1:-1]:
            axes.plot(*np.stack((lower[k], upper[k])).T, color=colour, linewidth=0.5, alpha=0.6)
    for k, edge in enumerate(edges):
        axes.plot(*edge.T, color=colour, linewidth=2.0 if k == 0 else 1.0)


def served_figure(steps: Sequence[Step], count: int) -> Figure:
    """How the error falls with the number of sizes: the mean, and the share that is served closely.

    Args:
        steps: for k = 1, 2, ...
        count: the number of sizes that was chosen.
    """
    k = [step.sizes.served.count for step in steps]
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    ways = (
        ("best sizes", "#0b5394", "-", [step.sizes.served for step in steps]),
        ("groups by wire length", "#b4460f", "--", [step.wire_groups.served for step in steps]),
        ("best sizes, chosen by wire length", "#2e6b34", ":", [step.by_wire.served for step in steps]),
    )
    for label, colour, line, served in ways:
        left.plot(k, [one.mean for one in served], line, color=colour, marker=".", label=label)
        right.plot(k, [100 * one.near for one in served], line, color=colour, marker=".", label=label)
    for axes, words in ((left, "mean error, mm"), (right, "within 3 mm, %")):
        axes.axvline(count, color=SOFT, linewidth=0.8)
        axes.set(xlabel="sizes", ylabel=words, ylim=(0, None))
        axes.grid(color=FAINT, linewidth=0.6)
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.spines[["right", "top"]].set_visible(False)
    left.legend(frameon=False, fontsize=9)
    return figure
