"""Patterns as PDF at true size: one large sheet, or tiled onto A4 or Letter with marks for gluing pages together."""

from __future__ import annotations

import string
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from reportlab import rl_config
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas
from shapely import Polygon, box

from brafit import __version__
from brafit.atomic import replacing
from brafit.pattern.curve import Curve
from brafit.pattern.finish import CutPiece, Pattern, warnings_of
from brafit.pattern.font import drawable, face
from brafit.pattern.options import PAPERS, PatternOptions
from brafit.pattern.piece import Kind, Sheet, layout_columns
from brafit.pattern.svg import LEGEND, STROKES, UNIT_WORDS, arrow_head

MARGIN, OVERLAP, GAP, CONTROL = 10.0, 10.0, 10.0, 100.0
"""Free border of a page, overlap of neighbouring tiles, distance of pieces, side of the control square; mm."""
_SHEET = "sheet"
"""Name of the drawing of all pieces that the tiles show parts of."""


@dataclass(frozen=True)
class Tile:
    """One page of a tiled sheet: its row from the top and column, and the lower left corner of what it shows."""

    row: int
    column: int
    x: float
    y: float

    @property
    def name(self) -> str:
        """Column letter and row number, as in a spreadsheet."""
        letters, column = "", self.column
        while column >= 0:
            letters, column = string.ascii_uppercase[column % 26] + letters, column // 26 - 1
        return f"{letters}{self.row + 1}"


@dataclass(frozen=True)
class Tiling:
    """How a sheet is cut into pages.

    Attributes:
        width, height: of the paper, as it lies, mm.
        columns, rows: of the grid of pages.
        tiles: those that show something.
    """

    width: float
    height: float
    columns: int
    rows: int
    tiles: tuple[Tile, ...]


def write_pdf_sheet(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write patterns at true size as a single page that is as large as they need.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        patterns: side by side if there are several.
        title: usually the scan's name; any text.
        note: a second line, such as the cup's side and model.
    """
    sheet = layout_columns([column for pattern in patterns for column in pattern.drawn], GAP)
    warnings = warnings_of(patterns)
    foot = max(CONTROL, 50.0 + 5.0 * len(warnings))
    width = max(sheet.width, CONTROL + GAP + 90.0) + 2 * MARGIN
    height = sheet.height + GAP + foot + 16.0 + 2 * MARGIN
    with _canvas(path, width, height, title) as canvas:
        _text(canvas, title, MARGIN, height - MARGIN - 6, 6, bold=True, room=width - 2 * MARGIN)
        _text(canvas, note, MARGIN, height - MARGIN - 12, 3.6, room=width - 2 * MARGIN)
        canvas.saveState()
        canvas.translate((width - sheet.width) / 2, MARGIN + foot + GAP)
        _pieces(canvas, sheet.pieces)
        canvas.restoreState()
        _control_square(canvas, MARGIN, MARGIN + foot - CONTROL, patterns[0].options)
        kinds = {line.kind for piece in sheet.pieces for line in piece.sew}
        left = MARGIN + CONTROL + GAP
        level = _legend(canvas, left, MARGIN + foot, kinds, patterns[0].options)
        _warnings(canvas, warnings, left, level - 6, width - MARGIN - left)
        canvas.showPage()


def write_pdf_tiles(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write patterns at true size onto pages of `pattern.paper`.

    The first page has the control square, a map of the pages, finished dimensions and warnings. The others show their
    part of the sheet within a frame; neighbours overlap by 10 mm, and glued so that the frames and crosses meet they
    make the sheet.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        patterns: one after the other.
        title: usually the scan's name; any text.
        note: a second line, such as the cup's side and model.
    """
    options = patterns[0].options
    sheet = layout_columns([column for pattern in patterns for column in pattern.drawn], GAP)
    tiling = tile(sheet, options.paper)
    with _canvas(path, *PAPERS[options.paper], title) as canvas:
        canvas.beginForm(_SHEET, *(int(v) for v in (-GAP, -GAP, sheet.width + 2 * GAP, sheet.height + 2 * GAP)))
        _pieces(canvas, sheet.pieces)
        canvas.endForm()
        _cover(canvas, patterns, sheet, tiling, title, note)
        canvas.showPage()
        for number, page in enumerate(tiling.tiles, start=2):
            canvas.setPageSize((tiling.width * mm, tiling.height * mm))
            canvas.scale(mm, mm)
            _tile(canvas, page, tiling, f"{title}   page {number} of {len(tiling.tiles) + 1}")
            canvas.showPage()


def tile(sheet: Sheet[CutPiece], paper: str) -> Tiling:
    """The pages that a sheet needs on a paper, upright or lying, whichever takes fewer."""
    upright = PAPERS[paper]
    choices = [_tiling(sheet, *size) for size in (upright, upright[::-1])]
    return min(choices, key=lambda tiling: len(tiling.tiles))


def _tiling(sheet: Sheet[CutPiece], width: float, height: float) -> Tiling:
    """Pages side by side, the sheet in the middle of all."""
    seen = np.array((width, height)) - 2 * MARGIN
    step = seen - OVERLAP
    size = np.array((sheet.width, sheet.height))
    columns, rows = (max(1, int(n)) for n in np.ceil((size - OVERLAP) / step - 1e-9))
    low = (size - (np.array((columns, rows)) * step + OVERLAP)) / 2
    shapes = [Polygon(piece.cut_outline()) for piece in sheet.pieces]
    tiles = []
    for row in range(rows):
        for column in range(columns):
            x, y = low + step * (column, rows - 1 - row)
            frame = box(x, y, x + seen[0], y + seen[1])
            if any(shape.intersects(frame) for shape in shapes):
                tiles.append(Tile(row, column, float(x), float(y)))
    return Tiling(width, height, columns, rows, tuple(tiles))


@contextmanager
def _canvas(path: str | Path, width: float, height: float, title: str) -> Iterator[Canvas]:
    """An empty file, drawn to in mm, that is written at the end."""
    # reportlab would write all streams as printable letters, which is slow and serves nobody any more
    before, rl_config.useA85 = rl_config.useA85, 0  # type: ignore[attr-defined]
    try:
        with replacing(path) as temporary:
            size = (width * mm, height * mm)
            canvas = Canvas(str(temporary), pagesize=size, pageCompression=1, initialFontName=face())  # type: ignore[arg-type]
            canvas.setTitle(_plain(title))
            canvas.setCreator(f"brafit {__version__}")
            canvas.setSubject("bra cup patterns at true size; print at 100 %")
            canvas.setViewerPreference("PrintScaling", "None")
            canvas.scale(mm, mm)
            yield canvas
            canvas.save()
    finally:
        rl_config.useA85 = before  # type: ignore[attr-defined]


def _cover(
    canvas: Canvas, patterns: Sequence[Pattern], sheet: Sheet[CutPiece], tiling: Tiling, title: str, note: str
) -> None:
    options = patterns[0].options
    width, height = PAPERS[options.paper]
    inner = width - 2 * MARGIN
    _text(canvas, title, MARGIN, height - MARGIN - 7, 7, bold=True, room=inner)
    _text(canvas, note, MARGIN, height - MARGIN - 13, 3.6, room=inner)
    _text(
        canvas, "Print at 100 % (actual size, no scaling), then measure the square.", MARGIN, height - MARGIN - 19, 3.6
    )
    top = height - MARGIN - 24
    _control_square(canvas, MARGIN, top - CONTROL, options)
    left = MARGIN + CONTROL + 8
    kinds = {line.kind for piece in sheet.pieces for line in piece.sew}
    level = _legend(canvas, left, top, kinds, options)
    for words in (
        f"Glue {len(tiling.tiles)} page{'s' * (len(tiling.tiles) > 1)} together",
        f"as the map shows; they overlap by {OVERLAP:g} mm:",
        "cut one of two neighbours along its frame,",
        "lay it onto the other's frame, crosses on crosses.",
    ):
        level -= 5
        _text(canvas, words, left, level, 3.2)
    bottom = _page_map(canvas, sheet, tiling, MARGIN, top - CONTROL - 8, inner, 60.0)
    level = bottom - 8
    _text(canvas, "finished dimensions (sewing lines)", MARGIN, level, 3.8, bold=True)
    for pattern in patterns:
        for piece in pattern.pieces:
            level -= 5
            lengths = ", ".join(f"{line.name} {options.length(line.length)}" for line in piece.sew)
            _text(canvas, f"{pattern.name}, {piece.name}: {lengths}", MARGIN, level, 3.2, room=inner)
    _warnings(canvas, warnings_of(patterns), MARGIN, level - 7, inner)


def _page_map(
    canvas: Canvas, sheet: Sheet[CutPiece], tiling: Tiling, x: float, top: float, width: float, height: float
) -> float:
    """The pages in small with their names over the pieces; returns its lower end."""
    seen = np.array((tiling.width, tiling.height)) - 2 * MARGIN
    step = seen - OVERLAP
    total = np.array((tiling.columns, tiling.rows)) * step + OVERLAP
    low = (np.array((sheet.width, sheet.height)) - total) / 2
    scale = min(width / total[0], height / total[1])
    canvas.saveState()
    canvas.translate(x, top - total[1] * scale)
    canvas.scale(scale, scale)
    canvas.translate(-low[0], -low[1])
    canvas.setLineWidth(0.25 / scale)
    canvas.setStrokeColor("#000000")
    canvas.setFillGray(0.92)
    for piece in sheet.pieces:
        canvas.drawPath(_Path(piece.cut, closed=True), stroke=1, fill=1)  # type: ignore[arg-type]
    for page in tiling.tiles:
        canvas.setStrokeGray(0.45)
        canvas.rect(page.x, page.y, seen[0], seen[1], stroke=1, fill=0)
        _text(canvas, page.name, page.x + seen[0] / 2, page.y + seen[1] / 2, 7 / scale, centred=True, bold=True)
    canvas.restoreState()
    return float(top - total[1] * scale)


def _tile(canvas: Canvas, page: Tile, tiling: Tiling, words: str) -> None:
    seen = np.array((tiling.width, tiling.height)) - 2 * MARGIN
    canvas.saveState()
    frame = canvas.beginPath()
    frame.rect(MARGIN, MARGIN, seen[0], seen[1])
    canvas.clipPath(frame, stroke=0, fill=0)
    canvas.translate(MARGIN - page.x, MARGIN - page.y)
    canvas.doForm(_SHEET)
    canvas.restoreState()
    canvas.setStrokeGray(0.5)
    canvas.setLineWidth(0.15)
    canvas.rect(MARGIN, MARGIN, seen[0], seen[1], stroke=1, fill=0)
    # The neighbours' frames, dashed, and crosses where they meet this one: the same crosses are on the neighbour.
    for axis, (first, last) in enumerate(((0, tiling.columns - 1), (0, tiling.rows - 1))):
        index = page.column if axis == 0 else tiling.rows - 1 - page.row
        for beyond, exists in ((MARGIN + OVERLAP, index > first), (MARGIN + seen[axis] - OVERLAP, index < last)):
            if not exists:
                continue
            ends = np.array(((beyond, MARGIN), (beyond, MARGIN + seen[1 - axis])))
            ends = ends if axis == 0 else ends[:, ::-1]
            canvas.setDash(2, 2)
            canvas.line(*ends[0], *ends[1])
            canvas.setDash()
            outer = MARGIN if beyond < MARGIN + seen[axis] / 2 else MARGIN + seen[axis]
            for share in (0.25, 0.5, 0.75):
                along = MARGIN + share * seen[1 - axis]
                centre = np.array((outer, along) if axis == 0 else (along, outer))
                _cross(canvas, centre)
                inner = np.array((beyond, along) if axis == 0 else (along, beyond))
                _cross(canvas, inner)
    _text(canvas, page.name, MARGIN + 2, MARGIN + 2.5, 9, bold=True, grey=0.55)
    _text(canvas, words, MARGIN, MARGIN - 5, 3, room=seen[0] - 60)
    _text(canvas, "true size, print at 100 %", MARGIN + seen[0] - 40, MARGIN - 5, 3)


def _cross(canvas: Canvas, centre: Float[ndarray, "2"]) -> None:
    x, y = centre
    canvas.line(x - 2, y, x + 2, y)
    canvas.line(x, y - 2, x, y + 2)


def _pieces(canvas: Canvas, pieces: Sequence[CutPiece]) -> None:
    for piece in pieces:
        canvas.setStrokeColor("#000000")
        canvas.setLineWidth(0.3)
        canvas.drawPath(_Path(piece.cut, closed=True))  # type: ignore[arg-type]
        for line in piece.sew:
            _stroke(canvas, line.kind)
            canvas.drawPath(_Path([line.curve]))  # type: ignore[arg-type]
        canvas.setDash()
        canvas.setStrokeColor("#000000")
        canvas.setLineWidth(0.35)
        for notch in piece.notches:
            for a, b in notch.ticks:
                canvas.line(*a, *b)
        for hole in piece.holes:
            x, y = hole.point
            canvas.circle(x, y, 1.5)
            canvas.line(x - 3, y, x + 3, y)
            canvas.line(x, y - 3, x, y + 3)
        _grain(canvas, piece)
        _label(canvas, piece)


def _grain(canvas: Canvas, piece: CutPiece) -> None:
    a, b = piece.grain
    size = float(np.linalg.norm(b - a))
    canvas.line(*a, *b)
    for tip, tail in ((a, b), (b, a)):
        p, q, r = arrow_head(tip, tail, min(3.0, size / 4))
        canvas.line(*p, *q)
        canvas.line(*q, *r)


def _label(canvas: Canvas, piece: CutPiece) -> None:
    label = piece.label
    for row, words in enumerate(label.all_lines):
        warning = row >= len(label.lines)
        _turned(canvas, words, label.middle(row), label.angle, label.size, bold=label.is_bold(row), red=warning)
    canvas.setLineWidth(0.15)
    for caption in piece.captions:
        if caption.leader is not None:
            canvas.line(*caption.leader[0], *caption.leader[1])
        _turned(canvas, caption.words, caption.at, caption.angle, caption.size)


def _turned(
    canvas: Canvas,
    words: str,
    at: Float[ndarray, "2"],
    angle: float,
    size: float,
    bold: bool = False,
    red: bool = False,
) -> None:
    """A line of text about a point."""
    canvas.saveState()
    canvas.translate(*at)
    canvas.rotate(angle)
    _text(canvas, words, 0, -0.35 * size, size, bold=bold, centred=True, red=red)
    canvas.restoreState()


class _Path:
    """What `Canvas.drawPath` draws: curves one after another, joined by straight lines."""

    def __init__(self, curves: Sequence[Curve], closed: bool = False):
        self._curves, self._closed = curves, closed

    def getCode(self) -> str:  # noqa: N802 (reportlab's name)
        """The operators of the path."""
        parts = []
        for i, curve in enumerate(self._curves):
            numbers = (*curve.start, *curve.controls[:, 1:].ravel().tolist())
            parts.append(f"%.4f %.4f {'l' if i else 'm'} " + "%.4f %.4f %.4f %.4f %.4f %.4f c " * len(curve.controls))
            parts[-1] %= numbers
        return "".join(parts) + "h " * self._closed


def _stroke(canvas: Canvas, kind: Kind) -> None:
    style = STROKES[kind]
    canvas.setStrokeColor(style["stroke"])
    canvas.setLineWidth(float(style["stroke-width"]))
    canvas.setDash([float(part) for part in style.get("stroke-dasharray", "").split()])


def _control_square(canvas: Canvas, x: float, y: float, options: PatternOptions) -> None:
    canvas.setStrokeColor("#000000")
    canvas.setLineWidth(0.2)
    canvas.rect(x, y, CONTROL, CONTROL, stroke=1, fill=0)
    middle = x + CONTROL / 2
    _text(canvas, "control square 100 mm x 100 mm", middle, y + CONTROL / 2 + 3, 4, centred=True)
    _text(canvas, "measure it on the print before cutting", middle, y + CONTROL / 2 - 3, 3.2, centred=True)
    if options.units == "inch":
        canvas.rect(x + 5, y + 5, 25.4, 25.4, stroke=1, fill=0)
        _text(canvas, "1 in x 1 in", x + 5 + 12.7, y + 16.5, 3.2, centred=True)


def _legend(canvas: Canvas, x: float, top: float, kinds: Container[str], options: PatternOptions) -> float:
    """Returns its lower end."""
    _text(canvas, UNIT_WORDS[options.units], x, top - 4, 3.4, bold=True)
    canvas.setStrokeColor("#000000")
    canvas.setLineWidth(0.3)
    level = top - 11
    canvas.line(x, level, x + 16, level)
    _text(canvas, "cut line", x + 19, level - 1.1, 3.2)
    shown: list[Kind] = [kind for kind in LEGEND if kind in kinds]
    for kind in shown:
        level -= 6
        _stroke(canvas, kind)
        canvas.line(x, level, x + 16, level)
        canvas.setDash()
        _text(canvas, f"sewing line: {LEGEND[kind]}", x + 19, level - 1.1, 3.2)
    _text(canvas, "right side of the cloth up", x, level - 8, 3.2)
    return level - 9


def _warnings(canvas: Canvas, warnings: Sequence[str], x: float, top: float, room: float) -> None:
    for row, words in enumerate(warnings):
        _text(canvas, f"WARNING: {words}", x, top - 5 * row, 3.4, bold=True, room=room, red=True)


def _text(
    canvas: Canvas,
    words: str,
    x: float,
    y: float,
    size: float,
    *,
    bold: bool = False,
    centred: bool = False,
    room: float | None = None,
    red: bool = False,
    grey: float = 0.0,
) -> None:
    """A line of text, its letters `size` mm high; smaller where it would be longer than `room`."""
    words = drawable(_plain(words), bold)
    if room is not None:
        size = min(size, size * room / max(canvas.stringWidth(words, face(bold), size), 1e-6))
    canvas.setFont(face(bold), size)
    if red:
        canvas.setFillColorRGB(0.75, 0, 0)
    else:
        canvas.setFillGray(grey)
    (canvas.drawCentredString if centred else canvas.drawString)(x, y, words)


def _plain(words: str) -> str:
    """One line of printable characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in words).split())
