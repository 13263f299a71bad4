"""One picture of a scan before its fit: the body, what is cut out of it, landmarks and lines, for a person to check."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray

SHOWN = 40_000
"""Points drawn of each kind at most."""
LETTERS, LINE = 185, 0.16
"""Letters in a line of text, and its height in inches."""
_KINDS = {
    "rest": ("#c4c8ce", 0.4, "not of this breast"),
    "cup": ("#2f6db3", 1.6, "points of the cup"),
    "assumed": ("#e5a50a", 2.0, "no points: assumed"),
    "removed": ("#c01c8a", 3.0, "removed: on no surface"),
}
_MARKS = {"apex": "*", "strap_point": "D", "inner_end": "<", "outer_end": ">"}
"""Signs of the landmarks, which the legend names: names beside them would lie over each other."""
_WAYS = ("down along the chest, mm", "outwards, mm", "out of the chest, mm")
"""The axes of the cup frame, in words."""
_LINES = {"wire": ("#d1480c", "wire"), "neckline": ("#2e7d32", "neckline")}
_CALLED = {"apex": "bust point"}
"""Landmarks that people call otherwise than landmark files do."""


def inspection_figure(
    clouds: Mapping[str, Float[ndarray, "n 3"]],
    lines: Mapping[str, Float[ndarray, "k 3"]],
    marks: Mapping[str, Float[ndarray, "3"]],
    title: str,
    facts: str,
    origins: Mapping[str, str] | None = None,
) -> Figure:
    """The scan from in front, whole and near, and the breast from the outer side and from below.

    Args:
        clouds: `cup` and `rest`, maybe `assumed` and `removed`, in the cup frame (x down, y outwards, z to the front),
            mm.
        lines: `wire` and, if there is one, `neckline`, likewise.
        marks: landmarks by name, likewise.
        title: above the figure.
        facts: lines of text below the pictures.
        origins: where lines and landmarks come from, by name: written beside them.
    """
    told = [part for line in facts.splitlines() for part in textwrap.wrap(line, LETTERS, subsequent_indent="  ")]
    below = LINE * (len(told) + 1)
    figure = Figure(figsize=(16, 6.5 + below), layout="constrained")
    grid = figure.add_gridspec(2, 4, height_ratios=(6.5, below))
    everything = np.concatenate([clouds["cup"], *lines.values()])
    low, high = everything.min(axis=0) - 25, everything.max(axis=0) + 25
    near = {kind: points[((points > low) & (points < high)).all(axis=1)] for kind, points in clouds.items()}
    # Farther away, points were removed at the rim of what was looked at only because their neighbours were not.
    whole = {**clouds, **{kind: near[kind] for kind in ("removed",) if kind in near}}
    views = (
        ("whole scan, from in front", whole, (1, 0)),
        ("from in front", near, (1, 0)),
        ("from the outer side", near, (2, 0)),
        ("from below", near, (1, 2)),
    )
    for place, (caption, shown, axes) in enumerate(views):
        _view(figure.add_subplot(grid[0, place]), caption, shown, lines, marks, axes, origins or {})
    handles, labels = figure.axes[1].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside upper right", ncols=5, frameon=False)
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D) and handle.get_marker() == ".":
            handle.set_markersize(10)
    text = figure.add_subplot(grid[1, :])
    text.axis("off")
    words = text.text(0, 1, "\n".join(told), va="top", family="monospace", fontsize=9, parse_math=False)
    words.set_in_layout(False)  # it has its room
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold").set_parse_math(False)
    return figure


def _view(
    axes: Axes,
    caption: str,
    clouds: Mapping[str, ndarray],
    lines: Mapping[str, ndarray],
    marks: Mapping[str, ndarray],
    columns: tuple[int, int],
    origins: Mapping[str, str],
) -> None:
    i, j = columns
    for kind, (colour, size, label) in _KINDS.items():
        if not len(clouds.get(kind, ())):
            continue
        points = clouds[kind][:: max(1, len(clouds[kind]) // SHOWN)]
        axes.plot(points[:, i], points[:, j], ".", markersize=size, color=colour, label=label)
    for name, line in lines.items():
        colour, label = _LINES[name]
        axes.plot(line[:, i], line[:, j], color=colour, linewidth=1.8, label=_said(label, origins.get(name)))
    for name, mark in marks.items():
        label = _said(_CALLED.get(name, name.replace("_", " ")), origins.get(name))
        sign, size = _MARKS.get(name, "o"), 12 if name == "apex" else 8
        axes.plot(mark[i], mark[j], sign, markersize=size, color="#ffffff", markeredgecolor="#111111", label=label)
    axes.set_aspect("equal")
    if j == 0:
        axes.invert_yaxis()
    axes.set_xlabel(_WAYS[i])
    axes.set_ylabel(_WAYS[j])
    axes.set_title(caption, fontsize=11)


def _said(label: str, origin: str | None) -> str:
    return label if origin is None else f"{label} ({origin})"
