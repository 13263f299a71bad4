"""A picture of how certain the outlines of the pieces are: a band of a standard deviation to either side, magnified."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.fitting.result import EdgeDeviations
from brafit.pattern.piece import Piece, layout

SHOWN = 4.0
"""Half width (mm) that the widest place of the band is to have in the picture, at most."""
_STEPS = (1, 2, 5, 10, 20, 50, 100)
_MARGIN = 8.0
_KEY = 3 * SHOWN
"""Height of the key below the pieces, mm."""


def magnification(deviation: Sequence[EdgeDeviations]) -> int:
    """How many times the band is magnified."""
    widest = max(float(edge.max()) for pair in deviation for edge in pair)
    return max((step for step in _STEPS if step * widest <= SHOWN), default=1)


def band_svg(pieces: Sequence[Piece], deviation: Sequence[EdgeDeviations]) -> str:
    """The pieces' outlines, in mm, each with its band."""
    factor = magnification(deviation)
    sheet = layout(pieces, gap=14.0)
    parts = []
    for piece, spread in zip(sheet.pieces, deviation, strict=True):
        # the second edge runs back along the upper edge
        for edge, own in zip(piece.edges, (spread[0], spread[1][::-1]), strict=True):
            parts.append(f'<path d="{_band(edge.points, factor * own)}" fill="#f4b183" fill-opacity="0.75"/>')
        outline = _path(piece.outline) + "Z"
        parts.append(f'<path d="{outline}" fill="none" stroke="#222" stroke-width="0.4"/>')
    width, height = sheet.width + 2 * _MARGIN, sheet.height + 2 * _MARGIN + _KEY
    foot = height - _MARGIN - _KEY
    flip = f"translate({_MARGIN},{foot}) scale(1,-1)"  # y runs down in SVG
    middles = [piece.middle * (1, -1) + (_MARGIN, foot) for piece in sheet.pieces]
    names = [_words(piece.name, x, y, "middle") for piece, (x, y) in zip(sheet.pieces, middles, strict=True)]
    return (
        f'<svg class="pieces" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.1f} {height:.1f}">'
        f'<g transform="{flip}">{"".join(parts)}</g>{"".join(names)}{_key(factor, height - _MARGIN)}</svg>'
    )


def _key(factor: int, y: float) -> str:
    """How wide the band is for a round deviation."""
    deviation = SHOWN / factor / 2
    half, y = factor * deviation, y - SHOWN
    size = f'x="{_MARGIN}" y="{y - half}" width="24" height="{2 * half}"'
    line = f'x1="{_MARGIN}" x2="{_MARGIN + 24}" y1="{y}" y2="{y}" stroke="#222" stroke-width="0.4"'
    words = _words(f"a standard deviation of {deviation:g} mm", _MARGIN + 28, y, "start")
    return f'<rect {size} fill="#f4b183" fill-opacity="0.75"/><line {line}/>{words}'


def _words(words: str, x: float, y: float, anchor: str) -> str:
    place = f'x="{x:.1f}" y="{y + 1.4:.1f}" font-size="4" font-family="sans-serif" text-anchor="{anchor}"'
    return f'<text {place} fill="#222">{escape(words)}</text>'


def _band(line: Float[ndarray, "n 2"], half: Float[ndarray, " n"]) -> str:
    tangent = np.gradient(line, axis=0)
    normal = tangent[:, ::-1] * (-1.0, 1.0) / np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    across = half[:, None] * normal
    return _path(np.concatenate([line + across, (line - across)[::-1]])) + "Z"


def _path(points: Float[ndarray, "n 2"]) -> str:
    return "M" + "L".join(["%.2f,%.2f"] * len(points)) % tuple(points.ravel().tolist())
