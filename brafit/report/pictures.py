"""Pictures of a result as PNG files: its finished pieces, its cup with the cloud, and a thumbnail."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.pattern.drawing import RED, Words, drawn
from brafit.pattern.finish import CutPiece, Move, Pattern
from brafit.pattern.piece import Side, layout
from brafit.report.canvas import FAINT, INK, SOFT, Canvas, Colour
from brafit.report.colour import PANELS, STEPS, distance_colours, distance_limit
from brafit.report.view import Picture, View

_LINES: dict[str, tuple[str, Colour, float, tuple[float, float] | None]] = {
    "wire": ("wire", (11, 83, 148), 3.0, None),
    "ridge": ("seam", (180, 70, 15), 2.1, (12.5, 3.1)),
    "upper": ("upper edge", (46, 107, 52), 2.1, (2.9, 2.5)),
}
"""Of each kind of edge: what the key calls it, colour, width and dashes in pixels; lines as in the SVG patterns."""
_CLOTH, _ALLOWANCE, _WARNING = (244, 237, 227), (251, 248, 244), (192, 0, 0)
_EDGE = (64, 51, 43)
_STRIPS, _STEP = 4, 2
"""Facets across each panel, so that points find their places between them, and stations along each."""
_THUMBNAIL = (264, 176)
_THUMBNAIL_POINTS = 800
_OBLIQUE = (0.42, 0.55, 0.72)
_UP = (-1.0, 0.0, 0.0)


def pattern_picture(pattern: Pattern, title: str) -> bytes:
    """Finished pieces with their texts as the pattern files show them, both axes in mm at one scale."""
    sheet = layout(pattern.pieces, gap=10.0)
    width, left, right, top, bottom = 900, 62, 14, 34, 92
    scale = (width - left - right) / (1.06 * sheet.width)
    inner = round(scale * (sheet.height + 0.06 * sheet.width))
    canvas = Canvas(width, top + inner + bottom)
    origin = np.array((left + 0.03 * sheet.width * scale, top + inner - 0.03 * sheet.width * scale))

    def place(points: ndarray) -> ndarray:
        return origin + points * (scale, -scale)

    axes = np.array(((left, top), (left, top + inner), (width - right, top + inner)), float)
    _rules(canvas, axes, origin, scale)
    for piece in sheet.pieces:
        _piece(canvas, piece, place, scale)
    canvas.text("mm", axes[1:].mean(0) + np.array((0, 34)), 13)
    canvas.text("mm", (14, top + inner / 2), 13, angle=90.0)
    canvas.text(title, (width / 2, top / 2), 18, bold=True)
    _key(canvas, [kind for kind in _LINES if any(line.kind == kind for p in sheet.pieces for line in p.sew)],
         canvas.height - 20)  # fmt: skip
    return canvas.png()


def fit_picture(
    points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"], shape: CupShape, title: str, side: Side = "left"
) -> bytes:
    """A cup and its scan's points, coloured by signed distance: obliquely, from the front and from the outer side.

    Args:
        points: cup frame, mm.
        distances: mm, positive outside the cup.
        shape: the cup, cup frame, mm.
        title: above the picture.
        side: right cups, which are fitted as left ones, are drawn as they are worn.
    """
    out = -1.0 if side == "right" else 1.0
    views = {
        "obliquely from below": View.of((_OBLIQUE[0], out * _OBLIQUE[1], _OBLIQUE[2]), _UP),
        "from the front": View.of((0, 0, 1), _UP),
        "from the outer side": View.of((0, out, 0), _UP),
    }
    canvas = Canvas(1350, 640)
    canvas.text(title, (canvas.width / 2, 14), 18, bold=True)
    pictures = {name: _view(view, points, distances, shape, out) for name, view in views.items()}
    _side_by_side(canvas, pictures, (60.0, 420.0), 456.0)
    _histogram(canvas, distances)
    return canvas.png()


def thumbnail(
    points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"], shape: CupShape, side: Side = "left"
) -> bytes:
    """A small picture of cup and cloud without any text; arguments as for `fit_picture`."""
    out = -1.0 if side == "right" else 1.0
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), _THUMBNAIL_POINTS)).astype(int))
    view = View.of((_OBLIQUE[0], out * _OBLIQUE[1], _OBLIQUE[2]), _UP)
    picture = _view(view, points[chosen], distances[chosen], shape, out)
    low, high = picture.bounds
    canvas = Canvas(*_THUMBNAIL, finer=4)
    room = np.array(_THUMBNAIL) - 4
    scale = float((room / (high - low)).min())
    corner = (np.array(_THUMBNAIL) - scale * (high - low)) / 2
    picture.paint(canvas, (float(corner[0]), float(corner[1])), scale)
    return canvas.png()


def _piece(canvas: Canvas, piece: CutPiece, place: Move, scale: float) -> None:
    cut, sewn = place(piece.cut_outline()), place(piece.sew_outline())
    canvas.fill(cut, _ALLOWANCE)
    canvas.fill(sewn, _CLOTH)
    canvas.line(np.vstack((cut, cut[:1])), INK, 1.0)
    for item in drawn(piece, piece.name):
        if isinstance(item, Words):
            colour = _WARNING if item.colour == RED else INK
            canvas.text(item.text, place(item.at), scale * item.size, angle=item.angle, bold=item.bold, colour=colour)
        elif item.layer != "cut":
            _, colour, width, dashes = _LINES.get(item.pen, ("", INK, 0.6 if item.pen == "leader" else 1.5, None))
            for curve in (curve for path in item.paths for curve in path):
                canvas.line(place(curve.polyline(0.1)), colour, width, dashes)


def _rules(canvas: Canvas, axes: Float[ndarray, "3 2"], origin: Float[ndarray, "2"], scale: float) -> None:
    """Axes along the left and the lower side, with numbers and a grid in mm."""
    (left, top), (_, bottom), (right, _) = axes
    step = next(step for step in (10, 20, 50, 100, 200, 500, 1000, 5000) if scale * step >= 90)
    for k in range(int((right - origin[0]) / scale / step) + 1):
        x = origin[0] + k * step * scale
        canvas.line(np.array(((x, top), (x, bottom))), FAINT, 1.0)
        canvas.line(np.array(((x, bottom), (x, bottom + 5))), INK, 1.0)
        canvas.text(f"{k * step}", (x, bottom + 15), 13, colour=SOFT)
    for k in range(int((origin[1] - top) / scale / step) + 1):
        y = origin[1] - k * step * scale
        canvas.line(np.array(((left, y), (right, y))), FAINT, 1.0)
        canvas.line(np.array(((left - 5, y), (left, y))), INK, 1.0)
        canvas.text(f"{k * step}", (left - 9, y), 13, anchor="rm", colour=SOFT)
    canvas.line(axes, INK, 1.2)


def _key(canvas: Canvas, kinds: list[str], y: float) -> None:
    """What the lines mean, in one row."""
    widths = [34 + 8 + 8 * len(_LINES[kind][0]) + 26 for kind in kinds]
    x = (canvas.width - sum(widths)) / 2
    for kind, width in zip(kinds, widths, strict=True):
        words, colour, thick, dashes = _LINES[kind]
        canvas.line(np.array(((x, y), (x + 28, y))), colour, thick, dashes)
        canvas.text(words, (x + 38, y), 14, anchor="lm")
        x += width


def _view(view: View, points: ndarray, distances: ndarray, shape: CupShape, out: float) -> Picture:
    """Cup and points in one view; `out`: -1 mirrors them."""
    worn = np.array((1.0, out, 1.0))
    edges, normals = (tensor.detach().cpu().double().numpy() for tensor in (shape.edges, shape.normals))
    edges, normals = edges * worn, normals * worn
    size = float(np.ptp(edges.reshape(-1, 3), axis=0).max())
    radius = size * float(np.clip(0.22 / np.sqrt(max(len(points), 1)), 0.003, 0.009))
    picture = Picture(view, radius)
    share = np.linspace(0, 1, _STRIPS + 1)[:, None, None]
    kept = np.unique(np.append(np.arange(0, edges.shape[1], _STEP), edges.shape[1] - 1))
    for i, normal in enumerate(normals[:, kept]):
        grid = (1 - share) * edges[i, kept] + share * edges[i + 1, kept]
        corners = np.stack((grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]), axis=2)
        each = np.broadcast_to((normal[:-1] + normal[1:]) / 2, (*corners.shape[:2], 3))
        picture.facets(corners.reshape(-1, 4, 3), each.reshape(-1, 3), PANELS[i % len(PANELS)].astype(float))
    for edge in edges:
        picture.line(edge, _EDGE, 0.007 * size, lift=0.01 * size)
    # lifted by the colour scale, so that points just inside the cup show through it, and those on its far side do not
    picture.dots(points * worn, distance_colours(distances).astype(float), lift=float(STEPS[-1]) + 0.015 * size)
    return picture


def _side_by_side(canvas: Canvas, pictures: dict[str, Picture], rows: tuple[float, float], caption: float) -> None:
    """Pictures at one scale between two rows of pixels, with captions in a third, and a scale bar."""
    sizes = [np.subtract(*picture.bounds[::-1]) for picture in pictures.values()]
    gap = 0.14 * max(size[0] for size in sizes)
    total = sum(size[0] for size in sizes) + gap * (len(sizes) - 1)
    tallest = max(size[1] for size in sizes)
    scale = float(min((rows[1] - rows[0]) / tallest, (canvas.width - 40) / total))
    x = (canvas.width - scale * total) / 2
    length = max(step for step in (1, 2, 5, 10, 20, 50, 100, 200) if step <= max(total / 8, 1))
    canvas.line(np.array(((x, 41.0), (x + scale * length, 41.0))), INK, 3.0)
    canvas.text(f"{length} mm", (x + scale * length + 10, 41), 14, anchor="lm")
    for (words, picture), size in zip(pictures.items(), sizes, strict=True):
        width, height = scale * size
        picture.paint(canvas, (float(x), float((rows[0] + rows[1] - height) / 2)), scale)
        canvas.text(words, (x + width / 2, caption), 14, colour=SOFT)
        x += width + scale * gap


def _histogram(canvas: Canvas, distances: Float[ndarray, " n"]) -> None:
    """The distances' distribution in their own colours, which is also the colours' key."""
    left, right, top, bottom, key = 26.0, canvas.width - 20.0, 508.0, 576.0, 592.0
    finite, limit = distances[np.isfinite(distances)], distance_limit(distances)
    bounds = np.linspace(-limit, limit, 81)
    counts, _ = np.histogram(np.clip(finite, -limit, limit), bounds)
    x = np.linspace(left, right, len(bounds))
    colours = distance_colours((bounds[1:] + bounds[:-1]) / 2).astype(int)
    heights = (bottom - top) * counts / max(int(counts.max()), 1)
    for low, high, height, colour in zip(x[:-1], x[1:], heights, colours.tolist(), strict=True):
        canvas.fill(np.array(((low, bottom - height), (high, bottom - height), (high, key), (low, key))), tuple(colour))
    canvas.line(np.array(((left, key), (right, key))), INK, 1.0)
    for share in np.linspace(-1, 1, 9):
        place = left + (right - left) * (share + 1) / 2
        canvas.line(np.array(((place, key), (place, key + 5))), INK, 1.0)
        canvas.text(f"{limit * share:g}", (place, key + 14), 13)
    words = "distance of the points from the cup in mm (negative: inside, positive: outside)"
    canvas.text(words, (canvas.width / 2, key + 35), 14)
    if len(finite):
        size = np.abs(finite)
        rms, p95 = np.sqrt(np.mean(size**2)), np.percentile(size, 95)
        numbers = f"RMS {rms:.2f}, mean {size.mean():.2f}, p95 {p95:.2f}, max {size.max():.2f} mm"
        canvas.text(f"{len(finite)} points: {numbers}", (canvas.width / 2, 489), 14.5)
