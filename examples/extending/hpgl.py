"""A writer: HP-GL, which cutters and plotters of pattern rooms read. Pen 1 draws the sewing lines, pen 2 cuts.

brafit 'pattern.formats=[dxf, {_target_: hpgl.HpglWriter}]'
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from brafit.atomic import write_text
from brafit.pattern import CutPiece, Pattern, PatternWriter, layout_columns

UNIT = 0.025
"""Of HP-GL, mm."""
TOLERANCE = 0.01
"""Of curves drawn as chords, mm."""


class HpglWriter(PatternWriter):
    """Writes patterns.plt.

    Args:
        gap: between pieces, mm.
    """

    files = ("patterns.plt",)

    def __init__(self, gap: float = 12.0):
        self.gap = gap

    def write(self, folder: Path, patterns: Sequence[Pattern], title: str, note: str) -> None:
        sheet = layout_columns([column for pattern in patterns for column in pattern.drawn], self.gap)
        drawn = [line for piece in sheet.pieces for line in _drawn(piece)]
        cut = [piece.cut_outline(TOLERANCE) for piece in sheet.pieces]
        lines = ["IN;DF;", "SP1;", *map(_stroke, drawn), "SP2;", *(_stroke(np.vstack((c, c[:1]))) for c in cut), "SP0;"]
        write_text(folder / "patterns.plt", "\n".join(lines) + "\n")


def _drawn(piece: CutPiece) -> Iterator[np.ndarray]:
    yield from (line.curve.polyline(TOLERANCE) for line in piece.sew)
    yield from (tick for notch in piece.notches for tick in notch.ticks)
    yield piece.grain


def _stroke(points: np.ndarray) -> str:
    first, *rest = (f"{x},{y}" for x, y in np.rint(points / UNIT).astype(int))
    return f"PU{first};PD{','.join(rest)};"
