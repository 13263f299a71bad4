"""Everything about the pieces on a page: the sheet that shows all of them, legend, control square, title, warnings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.pattern.cloth import cloth_words
from brafit.pattern.drawing import (
    INFO,
    RED,
    SEWING,
    Item,
    Page,
    Stroke,
    arrow,
    drawn,
    hole_mark,
    line_of,
    notch_mark,
    shifted,
)
from brafit.pattern.finish import CutPiece, Pattern, warnings_of
from brafit.pattern.grain import grain_name
from brafit.pattern.instructions import allowance_words, cut_words
from brafit.pattern.lettering import PITCH, one_line, paragraph, text, wrapped
from brafit.pattern.marks import BUST_POINT, MATCH_POINT
from brafit.pattern.notch import Notch
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import Hole, Kind, layout_columns

MARGIN, GAP, CONTROL = 12.0, 10.0, 100.0
"""Free border of a sheet, distance of pieces, side of the control square; mm."""
ROOM = 96.0
"""Width that the legend needs, mm."""
TEXT, _ROW = 3.4, 5.6
"""Height of the legend's letters and distance of its rows, mm."""
ROW = PITCH * TEXT
"""Distance of the lines of a wrapped text, mm."""
_UNITS = {"mm": "units: mm, true size (1:1)", "inch": "lengths in inches, true size (1:1)"}


def named_pieces(patterns: Sequence[Pattern]) -> list[tuple[CutPiece, str, str]]:
    """All pieces that files show, each with a name of its own and with its size where there are several."""
    several = len({pattern.name for pattern in patterns}) > 1
    sides = several or any(pattern.options.pair for pattern in patterns)
    found = []
    for pattern in patterns:
        for piece in (piece for column in pattern.drawn for piece in column):
            name = " ".join(words for words in (pattern.name, f"{piece.side} cup", piece.name) if words)
            found.append((piece, name if sides else piece.name, pattern.size if several else ""))
    return found


def sheet_page(patterns: Sequence[Pattern], title: str, note: str = "") -> Page:
    """All pieces side by side on one page as large as they need."""
    sheet = layout_columns([column for pattern in patterns for column in pattern.drawn], GAP)
    head = 12.0 + 6.0 * bool(note)
    inner = max(sheet.width, CONTROL + GAP + ROOM)
    below, legend_height = legend(patterns, np.zeros(2))
    told, told_height = told_below(warnings_of(patterns), inner)
    foot = max(CONTROL, legend_height) + told_height
    width, height = inner + 2 * MARGIN, head + sheet.height + GAP + foot + 2 * MARGIN
    corner = np.array(((width - sheet.width) / 2, MARGIN + foot + GAP))
    items: list[Item] = []
    for piece, (_, name, series) in zip(sheet.pieces, named_pieces(patterns), strict=True):
        placed = piece.map(lambda points: points + corner)
        items += drawn(placed, name, series)
    items += heading(title, note, MARGIN, height - MARGIN, inner)
    top = MARGIN + foot
    items += control_square(MARGIN, top - CONTROL, patterns[0].options)
    left = MARGIN + CONTROL + GAP
    items += shifted(below, (left, top))
    items += shifted(told, (MARGIN, MARGIN))
    return Page(width, height, tuple(items))


def heading(title: str, note: str, x: float, top: float, room: float) -> list[Item]:
    """Title and a second line below a page's upper border."""
    items: list[Item] = [text(one_line(title), x, top - 4, 6.0, room=room, bold=True, name="title")]
    return items + [text(one_line(note), x, top - 10.7, 3.6, room=room, name="note")] * bool(note)


def warned_lines(warnings: Sequence[str], room: float) -> list[str]:
    """Warnings in full, in lines of bold letters of the size TEXT that are not longer than `room` mm."""
    return [line for words in warnings for line in wrapped(f"WARNING: {words}", TEXT, room, bold=True)]


def told_below(warnings: Sequence[str], room: float) -> tuple[list[Item], float]:
    """Warnings in full, to stand at the foot of a sheet, from (0, 0) upwards; and the height that they take, mm."""
    lines = warned_lines(warnings, room)
    items: list[Item] = [
        text(line, 0.0, ROW * (len(lines) - row - 0.5), TEXT, bold=True, colour=RED) for row, line in enumerate(lines)
    ]
    return items, ROW * len(lines) + 4.0 * bool(lines)


def control_square(x: float, y: float, options: PatternOptions) -> list[Item]:
    """A square of 100 mm and, for users of inches, in its corner one of an inch, who may have no other ruler."""
    middle = x + CONTROL / 2
    items = [_square(x, y, CONTROL)]
    items += [text("control square 100 mm x 100 mm", middle, y + CONTROL / 2 + 3, 4.0, centred=True)]
    items += [text("measure it on the print before cutting", middle, y + CONTROL / 2 - 3, 3.2, centred=True)]
    if options.units == "inch":
        words = "or the small one, with a ruler in inches"
        items += [text(words, middle, y + CONTROL / 2 - 8, 3.2, centred=True)]
        items += [_square(x + 5, y + 5, 25.4), text("1 in x 1 in", x + 5 + 12.7, y + 5 + 12.7, 3.2, centred=True)]
    return [replace(item, group="control-square") for item in items]


def _square(x: float, y: float, side: float) -> Item:
    corners = np.array((x, y)) + side * np.array(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0)))
    return Stroke(INFO, "frame", "square", (line_of(corners),), closed=True)


def legend(patterns: Sequence[Pattern], at: Float[ndarray, "2"], room: float = ROOM) -> tuple[list[Item], float]:
    """What lines and marks mean, from `at` to the right and down; and its height."""
    pieces = [piece for pattern in patterns for column in pattern.drawn for piece in column]
    options = patterns[0].options
    alike = len({pattern.options.units for pattern in patterns}) == 1
    units = _UNITS[options.units] if alike else "true size (1:1)"
    items: list[Item] = [text(units, 0, -2, TEXT, bold=True, room=room)]
    y = -9.0
    for sample, words in _rows(pieces, options):
        told = paragraph(words, 22, y, TEXT, room=room - 22)
        items += [sample(y), *told]
        y -= _ROW + ROW * (len(told) - 1)
    for words in ("right side of the cloth up", *_contents(patterns)):
        told = paragraph(words, 0, y, TEXT, room=room)
        items += told
        y -= _ROW + ROW * (len(told) - 1)
    return shifted((replace(item, layer=INFO, group="legend") for item in items), at), -y - _ROW / 2


def _contents(patterns: Sequence[Pattern]) -> list[str]:
    """Size, sides and number of the pieces that are drawn, how often each is cut, allowances, and of what cloth."""
    sizes = {pattern.options.size for pattern in patterns}
    columns = [column for pattern in patterns for column in pattern.drawn]
    sides = sorted({piece.side for column in columns for piece in column})
    count = sum(map(len, columns))
    words = f"{' and '.join(sides)} cup, {count} piece{'s' * (count > 1)}"
    own = [f"size {size}" for size in sizes if size and len(sizes) == 1] + [words]
    kinds: set[Kind] = {line.kind for column in columns for piece in column for line in piece.sew}
    own += _alike(patterns, cut_words) + _alike(patterns, lambda options: allowance_words(options, kinds))
    return own + _cloths(patterns)


def _alike(patterns: Sequence[Pattern], words: Callable[[PatternOptions], str]) -> list[str]:
    """What is said of patterns: once where it is the same of all of them, else of each."""
    told = [words(pattern.options) for pattern in patterns]
    if len(set(told)) == 1:
        return told[:1]
    return [f"{one_line(pattern.size)}: {one}" for pattern, one in zip(patterns, told, strict=True)]


def _cloths(patterns: Sequence[Pattern]) -> list[str]:
    """Of what cloth the pieces are cut; a line for each pattern, with its units, where they differ in either."""
    told = [(pattern.options.units, cloth_words(pattern.options)) for pattern in patterns]
    if all(one == told[0] for one in told):
        return told[0][1]
    units = len({unit for unit, _ in told}) > 1
    return [
        f"{one_line(pattern.size)}: {', '.join([unit] * units + (words or ['thin cloth without stretch']))}"
        for pattern, (unit, words) in zip(patterns, told, strict=True)
    ]


def _rows(pieces: Sequence[CutPiece], options: PatternOptions) -> list[tuple[Callable[[float], Item], str]]:
    """A sample of each line and mark that is there, and what it means."""
    kinds = {line.kind for piece in pieces for line in piece.sew}
    notches = [notch for piece in pieces for notch in piece.notches]
    names = {notch.name for notch in notches}
    rows = [(_key("cut", "key cut"), "cut line")]
    rows += [(_key(kind, f"key {kind}"), f"sewing line: {words}") for kind, words in SEWING.items() if kind in kinds]
    if any(piece.holes for piece in pieces):
        rows.append((lambda y: hole_mark(Hole("", np.array((10.0, y)))), f"{BUST_POINT}: drill hole"))
    for name, words in (
        (BUST_POINT, f"{BUST_POINT}, on the seam"),
        (MATCH_POINT, f"{MATCH_POINT}: where the seam is nearest to the {BUST_POINT}"),
        ("strap point", "strap point"),
        ("wire end", "wire end: the channel goes on"),
    ):
        if name in names:
            rows += _notch_rows([notch for notch in notches if notch.name == name], words, options)
    for count, words in ((1, "notch, nearer the centre front"), (2, "double notch, nearer the side seam")):
        own = [notch for notch in notches if not notch.name and len(notch.ticks) == count]
        rows += _notch_rows(own, words, options)
    words = "direction of greatest stretch" if options.by_stretch else grain_name(options)
    rows.append((lambda y: arrow(np.array(((0.0, y), (18.0, y))), INFO), words))
    return rows


def _key(pen: str, role: str) -> Callable[[float], Item]:
    return lambda y: Stroke(INFO, pen, role, (line_of(((0.0, y), (18.0, y))),))


def _notch_rows(
    notches: Sequence[Notch], words: str, options: PatternOptions
) -> list[tuple[Callable[[float], Item], str]]:
    """A row for each form that notches of one meaning have."""
    forms = {notch.form: notch for notch in notches}
    return [
        (_notch_key(notch, options.notch_depth), words if notch.is_cut else f"{words} (drawn, not cut)")
        for notch in forms.values()
    ]


def _notch_key(notch: Notch, depth: float) -> Callable[[float], Item]:
    def sample(y: float) -> Item:
        width, count = notch.width, len(notch.ticks)
        apart = (width + 3.0) / 2 if count > 1 else 0.0
        roots = np.array([(10.0 + x, y + 1.5) for x in ({-apart, apart})])
        ticks = np.stack((roots, roots - (0.0, min(depth, 3.0))), axis=1)
        return notch_mark(Notch("", "", 0.0, ticks, roots[0], notch.form, min(width, 5.0)))

    return sample
