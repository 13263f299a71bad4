"""The picture at the top of the README: python scripts/make_picture.py [--scan FILE] [--panels 3] [--out FILE]

A scan with its wire line, the cup that brafit fits to it, and the flat pieces, side by side. Panels have the same
colour and the same rulings on the cup and on the pieces. Everything drawn comes from one fit.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from PIL import Image
from scipy.spatial import KDTree

import brafit
from brafit.atomic import write_bytes
from brafit.cloud import read_cloud
from brafit.pattern.drawing import PENS, Stroke, drawn
from brafit.pattern.finish import CutPiece
from brafit.report.canvas import INK, SOFT, Canvas, Colour
from brafit.report.view import LIGHT, Picture, View
from brafit.result import Result
from brafit.samples import sample_paths

OUT = Path(__file__).parents[1] / "docs" / "images" / "overview.png"
WIDTH, HEIGHT, FINER = 1800, 760, 3
MIDDLES, ROWS = (262.0, 832.0, 1444.0), (130.0, 690.0)
"""Middles of the three columns, and between which rows the drawings lie; pixels."""
ROOM = (440.0, 440.0, 600.0)
"""How wide the drawings may be, pixels."""
SKIN, MARGIN = np.array((226.0, 178.0, 152.0)), np.array((226.0, 219.0, 213.0))
PANELS = np.array(((240, 190, 165), (244, 220, 178), (190, 217, 198), (192, 207, 231)), float)
ALLOWANCE = (250, 247, 243)
VIEWER, UP = (0.46, 0.5, 0.76), (-1.0, 0.0, 0.0)
"""Cup frame: from in front, the outer side and a little from below."""
COLOURS: dict[str, Colour] = {
    name: tuple(int(pen.colour[i : i + 2], 16) for i in (1, 3, 5)) for name, pen in PENS.items()
}  # type: ignore[misc]
RULINGS = 12
"""A ruling is drawn at every so many stations."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scan", type=Path, default=sample_paths()[1], help="a left breast; default: a bundled one")
    parser.add_argument("--panels", type=int, default=3, help="panels of the cup (3)")
    parser.add_argument("--out", type=Path, default=OUT, help="the PNG file")
    asked = parser.parse_args()
    result = brafit.fit(asked.scan, settings=[f"cup.panels={asked.panels}"])
    write_bytes(asked.out, small(picture(asked.scan, result)))
    print(f"{asked.out}: {asked.out.stat().st_size / 1000:.0f} kB")


def picture(path: Path, result: Result) -> Canvas:
    """All three columns."""
    canvas = Canvas(WIDTH, HEIGHT, FINER)
    count = len(result.pieces)
    heads = (
        ("A 3D scan and a wire line", f"{len(read_cloud(path).points):,} points"),
        (f"A cup of {count} developable panels", f"RMS {result.figures['rms_mm']:.2f} mm from the points"),
        ("Flat pieces to cut and sew", "true to 0.01 mm, with allowances and notches"),
    )
    for middle, (head, below) in zip(MIDDLES, heads, strict=True):
        canvas.text(head, (middle, 40), 29, bold=True)
        canvas.text(below, (middle, 79), 22, colour=SOFT)
    views = [scan_view(path, result), cup_view(result)]
    spans = [np.subtract(*view.bounds[::-1]) for view in views]
    scale = min(min(room / span[0], (ROWS[1] - ROWS[0]) / span[1]) for room, span in zip(ROOM, spans, strict=False))
    for middle, view, span in zip(MIDDLES, views, spans, strict=False):
        corner = (middle - scale * span[0] / 2, sum(ROWS) / 2 - scale * span[1] / 2)
        view.paint(canvas, corner, scale)
    pieces(canvas, result)
    for place in ((MIDDLES[0] + MIDDLES[1]) / 2, (MIDDLES[1] + MIDDLES[2]) / 2 - 40):
        arrow(canvas, (place, sum(ROWS) / 2))
    key(canvas)
    return canvas


def scan_view(path: Path, result: Result) -> Picture:
    """The cloud as shaded dots, with the lines and points that were marked on it."""
    cloud = read_cloud(path)
    points = result.frame.to_cup(cloud.points)
    assert cloud.normals is not None
    normals = result.frame.to_cup(cloud.points + cloud.normals) - points
    view = View.of(VIEWER, UP)
    light = 0.66 + 0.42 * np.clip(normals @ (LIGHT @ np.stack((view.right, view.up, view.viewer))), 0, 1)
    seen = normals @ view.viewer > 0
    inside = np.ones(len(points), bool) if cloud.inside is None else cloud.inside
    drawing = Picture(view, radius=1.15)
    colours = np.where(inside[:, None], SKIN, MARGIN) * light[:, None]
    drawing.dots(points[seen], colours[seen], lift=0.0)
    for kind, line, width in (("wire", result.target.wire, 2.4), ("upper", result.target.neckline, 1.5)):
        if line is not None:
            for part in shown(line, points[seen], view):
                drawing.line(part, COLOURS[kind], width, lift=8.0)
    return drawing


def shown(line: Float[ndarray, "n 3"], points: Float[ndarray, "m 3"], view: View) -> list[Float[ndarray, "_ 3"]]:
    """The parts of a line that no points lie well in front of: through the gaps between dots it would be seen."""
    fine = np.concatenate([a + np.linspace(0, 1, 8, endpoint=False)[:, None] * (b - a) for a, b in pairwise(line)])
    near = KDTree(view.flat(points)).query_ball_point(view.flat(fine), 5.0)
    depth = points @ view.viewer
    front = np.array([max(depth[found], default=-np.inf) for found in near])
    hidden = np.flatnonzero(front > fine @ view.viewer + 25.0)
    return [part for part in np.split(fine, hidden) if len(part) > 2]


def cup_view(result: Result) -> Picture:
    """The panels with some of their rulings."""
    edges, normals = (tensor.detach().cpu().double().numpy() for tensor in (result.shape.edges, result.shape.normals))
    drawing = Picture(View.of(VIEWER, UP))
    share = np.linspace(0, 1, 11)[:, None, None]
    for i, normal in enumerate(normals):
        grid = (1 - share) * edges[i] + share * edges[i + 1]
        corners = np.stack((grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]), axis=2)
        each = np.broadcast_to((normal[:-1] + normal[1:]) / 2, (*corners.shape[:2], 3))
        drawing.facets(corners.reshape(-1, 4, 3), each.reshape(-1, 3), 1.06 * tint(i))
        for k in rulings(edges.shape[1]):
            along = edges[i, k] + np.linspace(0.02, 0.98, 12)[:, None] * (edges[i + 1, k] - edges[i, k])
            drawing.line(along, tuple(0.86 * tint(i)), 0.5, lift=3.4)
    for i, edge in enumerate(edges):
        kind = "wire" if i == 0 else "upper" if i == len(edges) - 1 else "ridge"
        drawing.line(edge, COLOURS[kind], 2.4 if kind == "wire" else 1.5, lift=6.0)
    return drawing


def pieces(canvas: Canvas, result: Result) -> None:
    """The finished pieces, one above the other, with the cup's rulings."""
    finished = result.patterns().pieces
    spans = [np.subtract(*piece.bounds[::-1]) for piece in finished]
    gap = 9.0
    height = sum(span[1] for span in spans) + gap * (len(spans) - 1)
    scale = min(ROOM[2] / max(span[0] for span in spans), (ROWS[1] - ROWS[0]) / height)
    base = sum(ROWS) / 2 + scale * height / 2
    for i, (piece, flat, span) in enumerate(zip(finished, result.pieces, spans, strict=True)):
        low = piece.bounds[0]

        def place(points: ndarray, low: ndarray = low, base: float = base, span: ndarray = span) -> ndarray:
            return np.array((MIDDLES[2] - scale * span[0] / 2, base)) + (points - low) * (scale, -scale)

        lower, upper = (edge.points for edge in flat.edges)
        canvas.fill(place(piece.cut_outline()), ALLOWANCE)
        canvas.fill(place(piece.sew_outline()), whole(tint(i)))
        for k in rulings(len(lower)):
            canvas.line(place(np.stack((lower[k], upper[-1 - k]))), whole(0.86 * tint(i)), 1.0)
        lines(canvas, piece, place)
        base -= scale * (span[1] + gap)
    bar(canvas, scale)


def lines(canvas: Canvas, piece: CutPiece, place: Callable[[ndarray], ndarray]) -> None:
    """Cut and sewing lines, notches and marks, and the piece's name beside its grain line, large enough to be read."""
    outline = place(piece.cut_outline(0.05))
    canvas.line(np.vstack((outline, outline[:1])), COLOURS["cut"], 1.6)
    for item in drawn(piece, piece.name):
        if isinstance(item, Stroke) and item.layer not in ("cut", "text"):
            width = {"wire": 4.6, "ridge": 3.0, "upper": 3.0}.get(item.pen, 2.0)
            for curve in (curve for path in item.paths for curve in path):
                canvas.line(place(curve.polyline(0.05)), COLOURS[item.pen], width)
    x, y = place(piece.grain.mean(0)[None])[0]
    on_right = piece.label.corners[:, 0].mean() > piece.grain[:, 0].mean()
    canvas.text(piece.name, (x + (14 if on_right else -14), y), 19.5, anchor="lm" if on_right else "rm", bold=True)


def arrow(canvas: Canvas, middle: tuple[float, float]) -> None:
    """To the next column."""
    x, y = middle
    corners = ((-26, -5), (4, -5), (4, -16), (28, 0), (4, 16), (4, 5), (-26, 5))
    canvas.fill(np.array([(x + dx, y + dy) for dx, dy in corners]), (196, 190, 184))


def key(canvas: Canvas) -> None:
    """What the colours of the lines mean."""
    x, y = 96.0, HEIGHT - 30.0
    for kind, words in (("wire", "wire"), ("ridge", "seam"), ("upper", "upper edge")):
        canvas.line(np.array(((x, y), (x + 40, y))), COLOURS[kind], 4.5)
        canvas.text(words, (x + 52, y), 21, anchor="lm")
        x += 92 + 13.5 * len(words)
    canvas.text("thin lines across a panel: its straight rulings, the same in space and laid flat",
                (x + 20, y), 21, anchor="lm", colour=SOFT)  # fmt: skip


def bar(canvas: Canvas, scale: float) -> None:
    """50 mm at the scale of the pieces."""
    x, y = WIDTH - 40.0, HEIGHT - 30.0
    canvas.line(np.array(((x - 50 * scale, y), (x, y))), INK, 3.0)
    canvas.text("50 mm", (x - 50 * scale - 14, y), 21, anchor="rm")


def rulings(stations: int) -> range:
    """The stations at which a ruling is drawn: none near the panels' tips."""
    return range(RULINGS, stations - RULINGS // 2, RULINGS)


def tint(panel: int) -> Float[ndarray, "3"]:
    """Colour of a panel, from the wire up."""
    return PANELS[panel % len(PANELS)]


def whole(colour: Float[ndarray, "3"]) -> Colour:
    """In whole numbers."""
    red, green, blue = np.clip(np.rint(colour), 0, 255).astype(int).tolist()
    return red, green, blue


def small(canvas: Canvas) -> bytes:
    """The picture as a PNG file of 128 colours."""
    image = Image.open(io.BytesIO(canvas.png())).convert("RGB")
    file = io.BytesIO()
    image.quantize(128, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    return file.getvalue()


if __name__ == "__main__":
    main()
