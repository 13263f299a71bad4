"""Texts on a page: none is smaller than paper shows well; names that are too long are shortened, sentences wrapped."""

from __future__ import annotations

import textwrap

import numpy as np

from brafit.pattern.drawing import BLACK, INFO, Words
from brafit.pattern.label import text_width

LEAST = 2.5
"""Height in mm of the smallest letters on a page, those on the pieces apart."""
PITCH = 1.4
"""Distance of the lines of a wrapped text, in heights of its letters."""


def text(
    words: str,
    x: float,
    y: float,
    size: float,
    *,
    room: float | None = None,
    bold: bool = False,
    colour: str = BLACK,
    centred: bool = False,
    name: str = "",
) -> Words:
    """A line of text half way up at y, its letters `size` mm high.

    Where it would be longer than `room`, its letters are smaller, down to LEAST; where that does not do, its middle is
    left out.
    """
    if room is not None:
        size = max(min(size, room / max(text_width(words, 1.0, bold), 0.1)), min(size, LEAST))
        words = shortened(words, size, room, bold)
    return Words(words, np.array((x, y), float), size, bold=bold, colour=colour, centred=centred, layer=INFO, name=name)


def paragraph(
    words: str, x: float, y: float, size: float, *, room: float, bold: bool = False, colour: str = BLACK
) -> list[Words]:
    """Lines of text, the first half way up at y, with letters of that size: as many as it takes to keep to `room`."""
    lines = wrapped(words, size, room, bold)
    return [text(line, x, y - PITCH * size * k, size, bold=bold, colour=colour) for k, line in enumerate(lines)]


def wrapped(words: str, size: float, room: float, bold: bool = False) -> list[str]:
    """A sentence in lines that are not longer than `room` mm; a word that is longer is broken."""
    letter = max((text_width(one, size, bold) for one in {*words, "x"}), default=1.0)
    return textwrap.wrap(words, max(int(room / letter), 1)) or [""]


def shortened(words: str, size: float, room: float, bold: bool = False) -> str:
    """Words without their middle, as far as they are longer than `room` mm."""
    kept = words
    for left in range(len(words) - 1, 1, -1):
        if text_width(kept, size, bold) <= room + 1e-9:
            break
        kept = f"{words[: left - left // 2]}…{words[len(words) - left // 2 :]}"
    return kept


def one_line(words: str) -> str:
    """Text without line breaks."""
    return " ".join(words.split())
