"""Patterns as PDF at true size: page by page on A4 or Letter, on one large sheet, and for projectors.

Each kind of line is a layer that viewers switch on and off (an optional content group), and so it is of each size.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from reportlab import rl_config
from reportlab.lib.colors import Color, toColor
from reportlab.lib.units import mm
from reportlab.pdfbase.pdfdoc import PDFArray, PDFDictionary, PDFPage, PDFResourceDictionary, PDFString
from reportlab.pdfgen.canvas import Canvas

from brafit import __version__
from brafit.atomic import replacing
from brafit.pattern.curve import Curve
from brafit.pattern.drawing import INFO, LAYERS, PENS, Item, Page, Stroke, Words
from brafit.pattern.finish import Pattern
from brafit.pattern.font import drawable, face
from brafit.pattern.pages import paper_pages
from brafit.pattern.sheet import sheet_page

_BOLD = 2.5
"""Lines for projectors are so many times as wide."""


def write_pdf_sheet(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write patterns at true size as a single page that is as large as they need.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        patterns: side by side if there are several.
        title: usually the scan's name; any text.
        note: a second line, such as the cup's side and model.
    """
    write_pages(path, [sheet_page(patterns, title, note)], title)


def write_pdf_projector(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write the single page of `write_pdf_sheet` with lines that a projector shows well; with its arguments."""
    write_pages(path, [sheet_page(patterns, title, note)], title, _BOLD)


def write_pdf_tiles(path: str | Path, patterns: Sequence[Pattern], title: str, note: str = "") -> None:
    """Write patterns at true size onto pages of `pattern.paper`, see `brafit.pattern.pages`; with the arguments of
    `write_pdf_sheet`."""
    write_pages(path, paper_pages(patterns, title, note), title)


def write_pages(path: str | Path, pages: Sequence[Page], title: str, bold: float = 1.0) -> None:
    """Write pages at true size, with a layer for each kind of line of each size.

    Args:
        path: the file; missing folders are made, and it is never there in part.
        pages: in their order.
        title: of the document, any text.
        bold: what widths of lines are multiplied with.
    """
    with _canvas(path, title) as canvas:
        layers = _Layers(canvas)
        for page in pages:
            canvas.setPageSize((page.width * mm, page.height * mm))
            canvas.scale(mm, mm)
            if page.frame is not None:
                canvas.saveState()
                frame = canvas.beginPath()
                frame.rect(*page.frame)
                canvas.clipPath(frame, stroke=0, fill=0)
                _items(canvas, layers, page.within, bold)
                canvas.restoreState()
            _items(canvas, layers, page.items, bold)
            canvas.showPage()
        layers.close()


@contextmanager
def _canvas(path: str | Path, title: str) -> Iterator[Canvas]:
    """An empty file, drawn to in mm, that is written at the end."""
    # reportlab would write all streams as printable letters, which is slow and serves nobody any more
    before, rl_config.useA85 = rl_config.useA85, 0  # type: ignore[attr-defined]
    try:
        with replacing(path) as temporary:
            canvas = Canvas(str(temporary), pageCompression=1, initialFontName=face(), pdfVersion=(1, 5))  # type: ignore[arg-type]
            canvas.setTitle(_plain(title))
            canvas.setCreator(f"brafit {__version__}")
            canvas.setSubject("bra cup patterns at true size; print at 100 %")
            canvas.setViewerPreference("PrintScaling", "None")
            yield canvas
            canvas.save()
    finally:
        rl_config.useA85 = before  # type: ignore[attr-defined]


@dataclass
class _Layers:
    """The optional content groups of a file; reportlab has none, so its page and document dictionaries get them."""

    canvas: Any  # reportlab keeps what is needed here to itself
    groups: dict[str, object] = field(default_factory=dict)

    def begin(self, name: str) -> None:
        """What is drawn from here on belongs to a layer."""
        if name not in self.groups:
            group = PDFDictionary({"Type": "/OCG", "Name": PDFString(_plain(name))})
            self.groups[name] = self.canvas._doc.Reference(group)
        self.canvas._code.append(f"/OC /L{list(self.groups).index(name)} BDC")

    def end(self) -> None:
        self.canvas._code.append("EMC")

    def close(self) -> None:
        """Tell the document of its layers: all shown at first."""
        document = self.canvas._doc
        properties = {f"L{i}": group for i, group in enumerate(self.groups.values())}
        for page in [entry for entry in document.idToObject.values() if isinstance(entry, PDFPage)]:
            page.Resources = PDFResourceDictionary(Properties=dict(properties))
            page.Resources.basicFonts()
        groups = list(self.groups.values())
        shown = PDFDictionary({"Order": PDFArray(groups), "ON": PDFArray(groups)})
        catalog = document.Catalog
        catalog.__NoDefault__ = [*catalog.__NoDefault__, "OCProperties"]
        catalog.OCProperties = PDFDictionary({"OCGs": PDFArray(groups), "D": shown})


def _items(canvas: Canvas, layers: _Layers, items: Iterable[Item], bold: float) -> None:
    """Draw items, those of a layer together."""
    sorted_items: dict[str, list[Item]] = {}
    order = {layer: i for i, layer in enumerate((*LAYERS, INFO))}
    for item in sorted(items, key=lambda item: (item.series, order[item.layer])):
        sorted_items.setdefault(f"{item.series} {item.layer}".strip(), []).append(item)
    for name, own in sorted_items.items():
        layers.begin(name)
        for item in own:
            if isinstance(item, Words):
                _words(canvas, item)
            else:
                _stroke(canvas, item, bold)
        layers.end()


def _stroke(canvas: Canvas, stroke: Stroke, bold: float) -> None:
    pen = PENS[stroke.pen]
    canvas.setStrokeColor(_colour(stroke.ink))
    canvas.setLineWidth(pen.width * bold)
    canvas.setDash([float(part) for part in pen.dashes])
    if stroke.fill:
        canvas.setFillColor(_colour(stroke.fill))
    for path in stroke.paths:
        canvas.drawPath(_Path(path, stroke.closed), stroke=1, fill=int(bool(stroke.fill)))  # type: ignore[arg-type]


def _words(canvas: Canvas, words: Words) -> None:
    """A line of text about its middle or from its start."""
    letters = drawable(_plain(words.text), words.bold)
    canvas.saveState()
    canvas.translate(*words.at)
    canvas.rotate(words.angle)
    canvas.setFont(face(words.bold), words.size)
    canvas.setFillColor(_colour(words.colour))
    (canvas.drawCentredString if words.centred else canvas.drawString)(0, -0.35 * words.size, letters)
    canvas.restoreState()


@cache
def _colour(name: str) -> Color:
    """Read once: reportlab would read it for every line."""
    return toColor(name)


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


def _plain(words: str) -> str:
    """One line of printable characters."""
    return " ".join("".join(c if c.isprintable() else " " for c in words).split())
