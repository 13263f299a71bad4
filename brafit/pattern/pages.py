"""Patterns on paper, page by page: a piece that fits on a page is not cut; one that does not is tiled by itself."""

from __future__ import annotations

import string
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from shapely import Polygon, box

from brafit.pattern.drawing import INFO, RED, Item, Page, Stroke, Words, drawn, line_of, shifted
from brafit.pattern.finish import CutPiece, Pattern, warnings_of
from brafit.pattern.label import text_width
from brafit.pattern.lettering import LEAST, PITCH, shortened, text, wrapped
from brafit.pattern.options import PAPERS
from brafit.pattern.piece import Sheet, layout
from brafit.pattern.sheet import CONTROL, ROW, TEXT, control_square, heading, legend, named_pieces, warned_lines

MARGIN, OVERLAP, GAP = 10.0, 10.0, 6.0
"""Free border of a page, overlap of neighbouring tiles, distance of pieces on a page; mm."""
_STEP = 3.0
"""Degrees by which a piece is turned at a time until it fits."""
_MAP = 45.0
"""Height of the little pages on the cover, mm."""
_PAPER_GREY = "#ebebeb"


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


Named = tuple[CutPiece, str, str]
"""A piece, its name among all pieces, and its size where there are several."""


@dataclass(frozen=True)
class Whole:
    """A page with whole pieces, in place on the paper as it lies."""

    width: float
    height: float
    pieces: tuple[Named, ...]

    @property
    def names(self) -> list[str]:
        """Of its pieces, which are names among all pieces."""
        return [name for _, name, _ in self.pieces]


@dataclass(frozen=True)
class Tiled:
    """A piece that is larger than the paper, alone on a sheet that is cut into pages."""

    sheet: Sheet[CutPiece]
    piece: Named
    tiling: Tiling

    @property
    def names(self) -> list[str]:
        """Of its piece, as of those of a whole page."""
        return [self.piece[1]]


def paper_pages(patterns: Sequence[Pattern], title: str, note: str = "") -> list[Page]:
    """A cover with control square, map, finished dimensions and warnings, on more pages if need be; then the pieces."""
    paper = patterns[0].options.paper
    parts = arrange(named_pieces(patterns), paper)
    pages = _covers(patterns, parts, title, note)
    total = len(pages) + _count(parts)
    for part in parts:
        if isinstance(part, Whole):
            items = [item for named in part.pieces for item in drawn(*named)]
            foot = _foot(part.width, title, len(pages) + 1, total)
            pages.append(Page(part.width, part.height, (*items, *foot)))
            continue
        for tile in part.tiling.tiles:
            foot = _foot(part.tiling.width, title, len(pages) + 1, total, f": {part.piece[1]}, {tile.name}")
            pages.append(_tile(part, tile, foot))
    return pages


def _count(parts: Sequence[Whole | Tiled]) -> int:
    """Of their pages."""
    return sum(len(part.tiling.tiles) if isinstance(part, Tiled) else 1 for part in parts)


def arrange(pieces: Sequence[Named], paper: str) -> list[Whole | Tiled]:
    """Pieces onto as few upright or lying pages as simple packing finds; pages in the order of their first pieces."""
    upright = PAPERS[paper]
    fitting: list[Named] = []
    large: list[Named] = []
    for piece, name, series in pieces:
        turned = fitted_piece(piece, upright)
        (fitting if turned is not None else large).append((piece if turned is None else turned, name, series))
    parts: list[Whole | Tiled] = []
    while fitting:
        pages = [_filled(fitting, *size) for size in (upright, upright[::-1])]
        best = max(pages, key=lambda page: len(page.pieces))
        parts.append(best)
        done = set(best.names)
        fitting = [named for named in fitting if named[1] not in done]
    for named in large:
        sheet = layout([named[0]])
        parts.append(Tiled(sheet, named, tile(sheet, paper)))
    place = {name: k for k, (_, name, _) in enumerate(pieces)}
    return sorted(parts, key=lambda part: min(place[name] for name in part.names))


def fitted_piece(piece: CutPiece, paper: tuple[float, float]) -> CutPiece | None:
    """The piece turned no farther than it must be to fit on the paper, upright or lying; None where it does not."""
    corners = piece.corners
    rooms = [np.array(size) - 2 * MARGIN for size in (paper, paper[::-1])]
    for angle in sorted(np.arange(-87.0, 90.1, _STEP), key=abs):
        turn = _turn(angle)
        size = np.ptp(corners @ turn, axis=0)
        if any((size <= room).all() for room in rooms):
            return piece if angle == 0 else piece.map(lambda points, turn=turn: points @ turn)
    return None


def _turn(degrees: float) -> Float[ndarray, "2 2"]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array(((c, s), (-s, c)))


def _filled(pieces: Sequence[Named], width: float, height: float) -> Whole:
    """A page with those of the pieces that find room on it: row by row upwards, as they are worn, from the left."""
    placed: list[Named] = []
    x, bottom, row = MARGIN, MARGIN, 0.0
    right, top = width - MARGIN + 1e-9, height - MARGIN + 1e-9
    for piece, name, series in pieces:
        low, high = piece.bounds
        size = high - low
        if x > MARGIN and (x + size[0] > right or bottom + size[1] > top):
            x, bottom, row = MARGIN, bottom + row + GAP, 0.0
        if x + size[0] > right or bottom + size[1] > top:
            continue
        shift = np.array((x, bottom)) - low
        placed.append((piece.map(lambda points, shift=shift: points + shift), name, series))
        x, row = x + size[0] + GAP, max(row, float(size[1]))
    if not placed:
        return Whole(width, height, ())
    corners = np.concatenate([np.stack(piece.bounds) for piece, *_ in placed])
    middle = np.array((width, height)) / 2 - (corners.min(0) + corners.max(0)) / 2
    return Whole(
        width, height, tuple((piece.map(lambda p: p + middle), name, series) for piece, name, series in placed)
    )


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


def _covers(patterns: Sequence[Pattern], parts: Sequence[Whole | Tiled], title: str, note: str) -> list[Page]:
    """The cover, and pages for what it has no room for."""
    width, height = PAPERS[patterns[0].options.paper]
    items, level = _cover(patterns, parts, title, note)
    texts = _flowed(_told(patterns, width - 2 * MARGIN), level - _MAP - 9, height - MARGIN - 4)
    count = len(texts)
    items += _map(parts, MARGIN, level, width - 2 * MARGIN, count + 1)
    pages = [Page(width, height, (*items, *texts[0]))]
    for number, own in enumerate(texts[1:], start=2):
        pages.append(Page(width, height, (*own, *_foot(width, title, number, count + _count(parts)))))
    return pages


_Block = list[tuple[float, Words]]
"""Lines that belong together, each with its distance from the line above, mm."""


def _told(patterns: Sequence[Pattern], room: float) -> list[_Block]:
    """Finished dimensions and warnings, a block for each piece and each warning."""
    cut = ", as cut" * any(pattern.reshaped for pattern in patterns)
    head = (0.0, text(f"finished dimensions (sewing lines{cut})", MARGIN, 0, 3.8, bold=True))
    blocks: list[_Block] = []
    for pattern in patterns:
        for piece in pattern.pieces:
            lengths = ", ".join(f"{line.name} {pattern.options.length(line.length)}" for line in piece.sew)
            lines = wrapped(f"{pattern.name}, {piece.name}: {lengths}", 3.2, room)
            blocks.append(_block([text(words, MARGIN, 0, 3.2) for words in lines], 5.0, 3.2 * PITCH))
    blocks[0].insert(0, head)
    for k, warning in enumerate(warnings_of(patterns)):
        lines = [text(words, MARGIN, 0, TEXT, bold=True, colour=RED) for words in warned_lines([warning], room)]
        blocks.append(_block(lines, ROW if k else 7.0, ROW))
    return blocks


def _block(lines: Sequence[Words], first: float, pitch: float) -> _Block:
    return [(pitch if row else first, line) for row, line in enumerate(lines)]


def _flowed(blocks: Sequence[_Block], level: float, top: float) -> list[list[Item]]:
    """Blocks from a level down, and from the top of further pages; none is broken but one too long for a page."""
    pages: list[list[Item]] = [[]]
    low = 2 * MARGIN
    for block in blocks:
        rest = sum(drop for drop, _ in block[1:])
        whole = level - block[0][0] - rest >= low or top - rest < low
        for row, (drop, line) in enumerate(block):
            level -= drop
            if level < low or not (whole or row):
                pages.append([])
                level = top
            pages[-1] += shifted([line], (0.0, level))
    return pages


def _cover(
    patterns: Sequence[Pattern], parts: Sequence[Whole | Tiled], title: str, note: str
) -> tuple[list[Item], float]:
    """What the cover always has but for the map of the pages, and where there is room for that."""
    options = patterns[0].options
    width, height = PAPERS[options.paper]
    inner = width - 2 * MARGIN
    items = heading(title, note, MARGIN, height - MARGIN, inner)
    words = "Print at 100 % (actual size, no scaling), then measure the control square."
    items.append(text(words, MARGIN, height - MARGIN - 17.5, 3.6, room=inner))
    top = height - MARGIN - 23
    items += control_square(MARGIN, top - CONTROL, options)
    left = MARGIN + CONTROL + 8
    key, depth = legend(patterns, np.array((left, top)), width - MARGIN - left)
    items += key
    tiled = [part for part in parts if isinstance(part, Tiled)]
    advice = [
        f"{len(tiled)} piece{'s are' if len(tiled) > 1 else ' is'} larger than the paper:",
        f"glue its pages, which overlap by {OVERLAP:g} mm: cut one of",
        "two neighbours along its frame and lay it onto the",
        "other's frame, crosses on crosses.",
    ]
    for row, line in enumerate(advice if tiled else ["Every piece is whole on one page: nothing to glue."]):
        items.append(text(line, left, top - depth - 4 - 4.6 * row, 3.0, room=width - MARGIN - left))
    level = min(top - CONTROL, top - depth - 4 - 4.6 * len(advice) * bool(tiled)) - 8
    return items, level


def _map(parts: Sequence[Whole | Tiled], x: float, top: float, room: float, page: int) -> list[Item]:
    """The pages in small with their numbers, the first of them `page`, or the names of the tiles; and the pieces."""
    sizes = [
        np.ptp(_frames(part), axis=0) if isinstance(part, Tiled) else np.array((part.width, part.height))
        for part in parts
    ]
    total = float(sum(size[0] for size in sizes))
    scale = min((room - 4 * (len(parts) - 1)) / total, _MAP / max(float(size[1]) for size in sizes))
    items: list[Item] = []
    for part, size in zip(parts, sizes, strict=True):
        if isinstance(part, Whole):
            frames = np.array(((0.0, 0.0), (part.width, part.height)))[None]
            names, pieces = [str(page)], [piece for piece, *_ in part.pieces]
        else:
            seen = np.array((part.tiling.width, part.tiling.height)) - 2 * MARGIN
            frames = np.array([((t.x, t.y), (t.x + seen[0], t.y + seen[1])) for t in part.tiling.tiles])
            names, pieces = [t.name for t in part.tiling.tiles], list(part.sheet.pieces)
        corner = frames.reshape(-1, 2).min(0)
        place = np.array((x, top - scale * size[1]))

        def small(points: ndarray, corner: ndarray = corner, place: ndarray = place) -> ndarray:
            return place + scale * (points - corner)

        items += [_outline(small(piece.cut_outline(0.5)), _PAPER_GREY) for piece in pieces]
        for (low, high), name in zip(frames, names, strict=True):
            rim = np.array((low, (high[0], low[1]), high, (low[0], high[1]), low))
            middle = small((low + high) / 2)
            items += [
                _outline(small(rim), ""),
                text(name, float(middle[0]), float(middle[1]), 6.0, bold=True, centred=True),
            ]
        x += scale * float(size[0]) + 4
        page += len(names)
    return items


def _frames(part: Tiled) -> Float[ndarray, "n 2"]:
    """Corners of a tiling's pages."""
    seen = np.array((part.tiling.width, part.tiling.height)) - 2 * MARGIN
    lows = np.array([(t.x, t.y) for t in part.tiling.tiles])
    return np.vstack((lows, lows + seen))


def _outline(points: Float[ndarray, "n 2"], fill: str) -> Item:
    return Stroke(INFO, "leader", "map", (line_of(np.vstack((points, points[:1]))),), closed=True, fill=fill)


def _foot(width: float, title: str, number: int, total: int, more: str = "") -> list[Item]:
    room = width - 2 * MARGIN - 55
    words = f", page {number} of {total}{more}"
    name = shortened(title, LEAST, max(room - text_width(words, LEAST), 20.0))
    return [
        text(str(number), MARGIN, MARGIN - 4.5, 4.5, bold=True),
        text(f"{name}{words}", MARGIN + 12, MARGIN - 4.5, 3.0, room=room),
        text("true size, print at 100 %", width - MARGIN - 42, MARGIN - 4.5, 3.0),
    ]


def _tile(part: Tiled, page: Tile, foot: Sequence[Item]) -> Page:
    """A part of a piece within a frame; neighbours overlap, and crosses meet crosses."""
    tiling, seen = part.tiling, np.array((part.tiling.width, part.tiling.height)) - 2 * MARGIN
    shown = shifted(drawn(part.sheet.pieces[0], *part.piece[1:]), (MARGIN - page.x, MARGIN - page.y))
    frame = (MARGIN, MARGIN, float(seen[0]), float(seen[1]))
    rim = np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))) * seen + MARGIN
    items: list[Item] = [_glue(line_of(rim))]
    for axis, (first, last) in enumerate(((0, tiling.columns - 1), (0, tiling.rows - 1))):
        index = page.column if axis == 0 else tiling.rows - 1 - page.row
        for beyond, exists in ((MARGIN + OVERLAP, index > first), (MARGIN + seen[axis] - OVERLAP, index < last)):
            if not exists:
                continue
            ends = np.array(((beyond, MARGIN), (beyond, MARGIN + seen[1 - axis])))
            items.append(replace(_glue(line_of(ends if axis == 0 else ends[:, ::-1])), pen="fold"))
            outer = MARGIN if beyond < MARGIN + seen[axis] / 2 else MARGIN + seen[axis]
            for share in (0.25, 0.5, 0.75):
                along = MARGIN + share * seen[1 - axis]
                for level in (outer, beyond):
                    items.append(_cross(*((level, along) if axis == 0 else (along, level))))
    items.append(text(page.name, MARGIN + 2, MARGIN + 6, 9.0, bold=True, colour="#909090"))
    return Page(tiling.width, tiling.height, (*items, *foot), tuple(shown), frame)


def _glue(*paths: tuple) -> Stroke:
    return Stroke(INFO, "glue", "glue", paths)


def _cross(x: float, y: float) -> Item:
    return _glue(line_of(((x - 2, y), (x + 2, y))), line_of(((x, y - 2), (x, y + 2))))
