"""Drawings of cups and patterns as the paper shows them, as matplotlib figures that belong to no window."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.pattern.piece import Piece
from brafit.report.figures import FAINT, INK, SOFT


def cup_figure(shape: CupShape, points: Float[ndarray, "n 3"] | None, title: str, unit: str = "") -> Figure:
    """A cup as the paper draws it (Figs 9, 11): wire solid, rulings dashed, points dots; in space and in three planes.

    Args:
        shape: the cup, cup frame.
        points: data in the same frame and unit, if any.
        title: above the figure.
        unit: name of the unit for the axes; empty: none.
    """
    edges = shape.edges.detach().cpu().double().numpy()
    everything = edges.reshape(-1, 3) if points is None else np.vstack((edges.reshape(-1, 3), points))
    low, high = everything.min(0), everything.max(0)
    half = 0.53 * float((high - low).max())  # all flat views at one scale
    chosen = np.unique(np.linspace(0, edges.shape[1] - 1, 29).astype(int)[1:-1])
    figure = Figure(figsize=(10, 10), layout="constrained")
    axes = figure.add_subplot(2, 2, 1, projection="3d")
    assert isinstance(axes, Axes3D)
    _draw_cup(axes, edges, points, chosen, [0, 1, 2])
    axes.view_init(elev=28, azim=-38)
    axes.set_box_aspect(np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1), zoom=0.86)  # type: ignore[arg-type]
    for name, axis in zip("xyz", (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_label_text(_unit_label(name, unit))
        axis.set_major_locator(MaxNLocator(4))
    for place, (i, j) in zip((2, 3, 4), ((0, 1), (0, 2), (1, 2)), strict=True):
        axes = figure.add_subplot(2, 2, place)
        _draw_cup(axes, edges, points, chosen, [i, j])
        axes.set_aspect("equal")
        for limits, k in ((axes.set_xlim, i), (axes.set_ylim, j)):
            limits((low[k] + high[k]) / 2 - half, (low[k] + high[k]) / 2 + half)
        _mm_axes(axes, _unit_label("xyz"[i], unit), _unit_label("xyz"[j], unit))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    _suptitle(figure, title)
    return figure


def flat_figure(pieces: Sequence[Piece], title: str, unit: str = "") -> Figure:
    """Pieces as the paper draws patterns (Figs 10, 12): lower edges solid, upper edges dotted, each in its own axes."""
    corners = np.array([piece.bounds for piece in pieces])
    low, high = corners[:, 0].min(0), corners[:, 1].max(0)
    room = 0.05 * (high - low).max()
    flatness = (high - low + 2 * room)[1] / (high - low + 2 * room)[0]
    figure = Figure(figsize=(4.8 * len(pieces) + 0.6, 4.1 * flatness + 1.7), layout="constrained")
    for i, piece in enumerate(pieces):
        axes = figure.add_subplot(1, len(pieces), i + 1)
        axes.plot(*piece.edges[0].points.T, color=INK, linewidth=1.5, label="lower edge")
        axes.plot(*piece.edges[1].points.T, color=INK, linewidth=1.5, linestyle=":", label="upper edge")
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - room, high[0] + room)
        axes.set_ylim(low[1] - room, high[1] + room)
        _mm_axes(axes, _unit_label("v", unit), _unit_label("w", unit))
        axes.set_title(piece.name, fontsize=11)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    _suptitle(figure, title)
    return figure


def _draw_cup(axes: Axes, edges: ndarray, points: ndarray | None, chosen: ndarray, columns: list[int]) -> None:
    """Into axes of two or three dimensions: those columns of the coordinates."""
    if points is not None:
        shown = points[:: max(1, len(points) // 1000)][:, columns].T
        axes.plot(*shown, linestyle="none", marker=".", markersize=2.2, color="#7a8ca3", label="points", zorder=1)
    for panel in range(len(edges) - 1):
        for k in chosen:
            ruling = edges[panel : panel + 2, k][:, columns].T
            label = "rulings" if panel == 0 and k == chosen[0] else "_"
            axes.plot(*ruling, color="#b4460f", linewidth=0.8, linestyle="--", label=label, zorder=2)
    for i, edge in enumerate(edges[1:]):
        axes.plot(*edge[:, columns].T, color=SOFT, linewidth=0.9, label="_" if i else "other edges", zorder=3)
    axes.plot(*edges[0][:, columns].T, color="#0b3d70", linewidth=2.2, label="wire", zorder=4)


def _mm_axes(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, color=INK)
    axes.set_ylabel(y, color=INK)
    axes.grid(color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.spines[["right", "top"]].set_visible(False)
    axes.tick_params(colors=SOFT)


def _unit_label(name: str, unit: str) -> str:
    return f"{name} / {unit}" if unit else name


def _suptitle(figure: Figure, title: str) -> None:
    _plain(figure.suptitle(_one_line(title), fontsize=13, fontweight="bold", color=INK))


def _plain(text: Text) -> None:
    """Names may hold dollar signs: no mathematics in them."""
    text.set_parse_math(False)


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())
