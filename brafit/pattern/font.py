"""The typeface as reportlab embeds it in PDF files."""

from __future__ import annotations

from functools import cache

from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont

from brafit.typeface import BOLD, PLAIN, typeface


def face(bold: bool = False) -> str:
    """The name by which reportlab knows the face."""
    return _registered(BOLD if bold else PLAIN).fontName


def drawable(words: str, bold: bool = False) -> str:
    """The words, with a replacement sign for each letter that the face lacks."""
    letters = _registered(BOLD if bold else PLAIN).face.charToGlyph  # type: ignore[attr-defined]
    return "".join(c if ord(c) in letters else "\ufffd" for c in words)


@cache
def _registered(name: str) -> TTFont:
    font = TTFont(name, str(typeface(name)))
    pdfmetrics.registerFont(font)
    return font
