"""Drawings of patterns, fits and cups, as matplotlib figures that belong to no window."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import PathPatch
from matplotlib.text import Text
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Affine2D
from mpl_toolkits.mplot3d import Axes3D
from numpy import ndarray

from brafit.atomic import replacing
from brafit.cup.shape import CupShape
from brafit.pattern.finish import Pattern
from brafit.pattern.piece import Kind, Piece, Side, layout
from brafit.report.colour import PANELS, distance_colours, distance_limit
from brafit.report.mesh import cup_mesh
from brafit.report.view import Picture, View

LINES: dict[Kind, dict] = {
    "wire": {"color": "#0b5394", "linewidth": 2.2, "linestyle": "-", "label": "wire"},
    "ridge": {"color": "#b4460f", "linewidth": 1.5, "linestyle": (0, (6, 1.5)), "label": "ridge (seam)"},
    "upper": {"color": "#2e6b34", "linewidth": 1.5, "linestyle": (0, (1.4, 1.2)), "label": "upper edge"},
}
"""The same lines as in the SVG patterns."""

INK, SOFT, FAINT = "#222222", "#666666", "#dddddd"


def pattern_figure(pattern: Pattern, title: str) -> Figure:
    """Finished pieces with their texts as the pattern files show them, both axes in mm at one scale."""
    sheet = layout(pattern.pieces, gap=10.0)
    width = 9.0
    figure = Figure(figsize=(width, 1.5 + width * 0.9 * sheet.height / sheet.width), layout="constrained")
    axes = figure.add_subplot()
    seen: set[str] = set()
    for piece in sheet.pieces:
        axes.fill(*piece.cut_outline().T, facecolor="#fbf8f4", edgecolor=INK, linewidth=0.8, zorder=1)
        axes.fill(*piece.sew_outline().T, facecolor="#f4ede3", edgecolor="none", zorder=2)
        for line in piece.sew:
            style = LINES[line.kind]
            label = "_" if line.kind in seen else style["label"]
            axes.plot(*line.curve.polyline().T, **{**style, "label": label}, solid_capstyle="round", zorder=3)
            seen.add(line.kind)
        for tick in (tick for notch in piece.notches for tick in notch.ticks):
            axes.plot(*tick.T, color=INK, linewidth=1.2, zorder=4)
        for hole in piece.holes:
            axes.plot(*hole.point, marker="+", markersize=9, color=INK, zorder=4)
        axes.annotate("", *piece.grain, arrowprops={"arrowstyle": "<->", "color": SOFT, "linewidth": 0.9})
        label = piece.label
        for row, words in enumerate(label.all_lines):
            colour = "#c00000" if row >= len(label.lines) else INK
            _true_size(axes, words, label.middle(row), label.angle, label.size, label.is_bold(row), colour)
        for caption in piece.captions:
            _true_size(axes, caption.words, caption.at, caption.angle, caption.size)
            if caption.leader is not None:
                axes.plot(*caption.leader.T, color=INK, linewidth=0.4, zorder=4)
    _mm_axes(axes, "mm", "mm")
    axes.set_aspect("equal")
    axes.margins(0.03)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=3, frameon=False, fontsize=10)
    _title(axes, title)
    return figure


def _true_size(
    axes: Axes,
    words: str,
    at: Float[ndarray, "2"],
    angle: float,
    size: float,
    bold: bool = False,
    colour: str = INK,
) -> None:
    """A line of text about a point, its letters as high in the drawing's mm as in the pattern files."""
    font = FontProperties(weight="bold" if bold else "normal")
    path = TextPath((0, 0), words.replace("$", r"\$"), size=size, prop=font)
    width = path.get_extents().width if len(path.vertices) else 0.0
    place = Affine2D().translate(-width / 2, -0.35 * size).rotate_deg(angle).translate(*at)
    axes.add_patch(PathPatch(place.transform_path(path), facecolor=colour, linewidth=0, zorder=5))


def fit_figure(
    points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"], shape: CupShape, title: str, side: Side = "left"
) -> Figure:
    """A cup and its scan's points, coloured by signed distance: obliquely, from the front and from the outer side.

    Args:
        points: cup frame, mm.
        distances: mm, positive outside the cup.
        shape: the cup, cup frame, mm.
        side: right cups, which are fitted as left ones, are drawn as they are worn.
    """
    limit = distance_limit(distances)
    outward = -1.0 if side == "right" else 1.0
    views = {
        "obliquely from below": View.of((0.42, 0.55 * outward, 0.72), (-1, 0, 0)),
        "from the front": View.of((0, 0, 1), (-1, 0, 0)),
        "from the outer side": View.of((0, outward, 0), (-1, 0, 0)),
    }
    figure = Figure(figsize=(13.5, 6.4), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 0.2))
    axes = figure.add_subplot(grid[0])
    pictures = [_fit_picture(view, points, distances, shape, limit, outward) for view in views.values()]
    _side_by_side(axes, pictures, list(views))
    _histogram(figure.add_subplot(grid[1]), distances, limit)
    _suptitle(figure, title)
    return figure


def thumbnail_figure(
    points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"], shape: CupShape, side: Side = "left"
) -> Figure:
    """A small picture of cup and cloud without any text; arguments as for `fit_figure`."""
    outward = -1.0 if side == "right" else 1.0
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), 800)).astype(int))
    view = View.of((0.42, 0.55 * outward, 0.72), (-1, 0, 0))
    limit = distance_limit(distances)
    picture = _fit_picture(view, points[chosen], distances[chosen], shape, limit, outward)
    figure = Figure(figsize=(2.64, 1.76))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    low, high = picture.bounds
    picture.paint(axes, np.zeros(2))
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.margins(0.04)
    axes.axis("off")
    return figure


def cup_figure(shape: CupShape, points: Float[ndarray, "n 3"] | None, title: str, unit: str = "") -> Figure:
    """A cup as the paper draws it (Figs 9, 11): wire solid, rulings dashed, points dots; in space and in three planes.

    Args:
        shape: the cup, cup frame.
        points: data in the same frame and unit, if any.
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


def figure_image(figure: Figure, dpi: int = 100) -> UInt8[ndarray, "height width 3"]:
    """The figure as pixels."""
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    with _any_script():
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def save_figure(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write a figure; the suffix chooses the format (png, pdf, svg)."""
    with replacing(path) as temporary, _any_script():
        figure.savefig(temporary, dpi=dpi)


def _fit_picture(
    view: View, points: ndarray, distances: ndarray, shape: CupShape, limit: float, outward: float
) -> Picture:
    def place(x: ndarray) -> ndarray:
        return x * (1.0, outward, 1.0)

    picture = Picture(view)
    mesh = cup_mesh(shape, strips=6, place=place)
    picture.triangles(mesh.vertices, mesh.normals, mesh.faces, PANELS[mesh.panel % len(PANELS)] / 255)
    edges = shape.edges.detach().cpu().double().numpy()
    size = float(np.ptp(edges.reshape(-1, 3), axis=0).max())
    for edge in edges:
        picture.line(place(edge), (0.25, 0.2, 0.17), 0.007 * size, lift=0.01 * size)
    # lifted by the colour scale, so that points just inside the cup show through it, and those on its far side do not
    radius = size * float(np.clip(0.22 / np.sqrt(max(len(points), 1)), 0.003, 0.009))
    picture.dots(place(points), distance_colours(distances, limit) / 255, radius, lift=limit + 0.015 * size)
    return picture


def _side_by_side(axes: Axes, pictures: Sequence[Picture], captions: Sequence[str]) -> None:
    """Pictures at one scale on a common ground line, with captions and a scale bar."""
    sizes = [np.subtract(*picture.bounds[::-1]) for picture in pictures]
    gap = 0.14 * max(size[0] for size in sizes)
    tallest = max(size[1] for size in sizes)
    x = 0.0
    for picture, caption, size in zip(pictures, captions, sizes, strict=True):
        picture.paint(axes, np.array((x, (tallest - size[1]) / 2)) - picture.bounds[0])
        axes.text(x + size[0] / 2, -0.09 * tallest, caption, ha="center", va="top", color=SOFT)
        x += size[0] + gap
    width = x - gap
    length = max(step for step in (1, 2, 5, 10, 20, 50, 100, 200) if step <= max(width / 8, 1))
    axes.plot([0, length], [tallest * 1.05] * 2, color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(length + 0.01 * width, tallest * 1.05, f"{length:g} mm", va="center", color=INK)
    axes.set_aspect("equal")
    axes.set_xlim(-0.01 * width, 1.01 * width)
    axes.set_ylim(-0.16 * tallest, 1.08 * tallest)
    axes.axis("off")


def _histogram(axes: Axes, distances: ndarray, limit: float) -> None:
    """The distances' distribution in their own colours, which is also the colours' key."""
    finite = distances[np.isfinite(distances)]
    bounds = np.linspace(-limit, limit, 81)
    counts, _ = np.histogram(np.clip(finite, -limit, limit), bounds)
    middles = (bounds[1:] + bounds[:-1]) / 2
    colours = distance_colours(middles, limit) / 255
    axes.bar(middles, counts, width=bounds[1] - bounds[0], color=colours)
    tallest = max(int(counts.max()), 1)
    axes.imshow(colours[None], extent=(-limit, limit, -0.22 * tallest, 0), aspect="auto", interpolation="bilinear")
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-0.22 * tallest, 1.08 * tallest)
    axes.set_yticks([])
    axes.set_xlabel("distance of the points from the cup in mm   (negative: inside, positive: outside)", color=INK)
    axes.spines[["left", "right", "top"]].set_visible(False)
    if len(finite):
        size = np.abs(finite)
        rms, p95 = np.sqrt(np.mean(size**2)), np.percentile(size, 95)
        numbers = f"RMS {rms:.2f}   mean {size.mean():.2f}   p95 {p95:.2f}   max {size.max():.2f} mm"
        axes.set_title(f"{len(finite)} points:   {numbers}", fontsize=10.5, color=INK)


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


def _title(axes: Axes, title: str) -> None:
    _plain(axes.set_title(_one_line(title), fontsize=13, fontweight="bold", color=INK, pad=10))


def _suptitle(figure: Figure, title: str) -> None:
    _plain(figure.suptitle(_one_line(title), fontsize=13, fontweight="bold", color=INK))


def _plain(text: Text) -> None:
    """Names may hold dollar signs: no mathematics in them."""
    text.set_parse_math(False)


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


@contextmanager
def _any_script() -> Iterator[None]:
    """Draw boxes, without a warning each, for letters that matplotlib's own font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from font", category=UserWarning)
        yield
