"""Flat patterns: pieces of cloth in true millimetres, and writers for them.

    piece   pieces with named edges, made of developed panels, and their places on a sheet
    svg     one drawing at true size, with a named group per piece

A piece is the sewing line, nothing more. What is added to it (allowances, marks) belongs in modules that take pieces
and give pieces; a new file format is one more writer beside `svg`.
"""

from brafit.pattern.piece import Edge, Kind, Piece, Sheet, Side, layout, pieces_from_panels
from brafit.pattern.svg import write_svg

__all__ = ["Edge", "Kind", "Piece", "Sheet", "Side", "layout", "pieces_from_panels", "write_svg"]
