"""A typeface with Latin, Greek, Cyrillic and many more letters, for PDF files and pictures.

It is DejaVu Sans as matplotlib ships it; matplotlib itself is not imported, which would cost half a second.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

PLAIN, BOLD = "DejaVuSans", "DejaVuSans-Bold"


@cache
def typeface(name: str) -> Path:
    """The file of `PLAIN` or `BOLD`."""
    spec = find_spec("matplotlib")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf" / f"{name}.ttf"
