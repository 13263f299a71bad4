"""Flat patterns: pieces of cloth in true millimetres, and writers for them.

piece    pieces with named edges (the sewing lines), made of developed panels, and their places on a sheet
marks    where landmarks lie on a cup
curve    smooth curves of few Bezier arcs
options  what is added to the sewing lines, and which files are written
finish   pieces as they are cut, and their checks: with allowance, notch, grain, label, caption
drawing  what is drawn of a piece, in one neutral form
sheet    all pieces on one page, key, control square; pages: page by page on paper
writers  which files are written, and by what
svg, dxf, pdf  the writers, which translate the drawing; each is imported by itself, so that it costs only what it needs
"""

from brafit.pattern.finish import CutPiece, Pattern, finish
from brafit.pattern.marks import marks_on
from brafit.pattern.options import PatternOptions
from brafit.pattern.piece import CupMark, Edge, Kind, Piece, Sheet, Side, layout, layout_columns, pieces_from_panels
from brafit.pattern.svg import write_svg
from brafit.pattern.writers import WRITERS, PatternWriter, write_patterns

__all__ = [
    "WRITERS",
    "CupMark",
    "CutPiece",
    "Edge",
    "Kind",
    "Pattern",
    "PatternOptions",
    "PatternWriter",
    "Piece",
    "Sheet",
    "Side",
    "finish",
    "layout",
    "layout_columns",
    "marks_on",
    "pieces_from_panels",
    "write_patterns",
    "write_svg",
]
