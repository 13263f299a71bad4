"""Matplotlib figures in files: what commands draw with it looks alike."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from matplotlib.figure import Figure

from brafit.atomic import replacing

INK, SOFT, FAINT = "#222222", "#666666", "#dddddd"
"""Colours of texts, of what matters less, and of grids."""


def save_figure(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write a figure; the suffix chooses the format (png, pdf, svg)."""
    with replacing(path) as temporary, _any_script():
        figure.savefig(temporary, dpi=dpi)


@contextmanager
def _any_script() -> Iterator[None]:
    """Draw boxes, without a warning each, for letters that matplotlib's own font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from font", category=UserWarning)
        yield
