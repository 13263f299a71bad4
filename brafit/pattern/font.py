"""A typeface with Latin, Greek, Cyrillic and many more letters, embedded in PDF files.

It is DejaVu Sans as matplotlib ships it; matplotlib itself is not imported, which would cost half a second.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont

PLAIN, BOLD = "DejaVuSans", "DejaVuSans-Bold"


def face(bold: bool = False) -> str:
    """The name by which reportlab knows the face."""
    return _registered(BOLD if bold else PLAIN).fontName


def drawable(words: str, bold: bool = False) -> str:
    """The words, with a replacement sign for each letter that the face lacks."""
    letters = _registered(BOLD if bold else PLAIN).face.charToGlyph  # type: ignore[attr-defined]
    return "".join(c if ord(c) in letters else "\ufffd" for c in words)


@cache
def _registered(name: str) -> TTFont:
    spec = find_spec("matplotlib")
    assert spec is not None
    assert spec.origin is not None
    font = TTFont(name, str(Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf" / f"{name}.ttf"))
    pdfmetrics.registerFont(font)
    return font
