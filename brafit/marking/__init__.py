"""Pages on which a person marks a scan by hand: what they are told, and how they are written."""

from brafit.marking.page import MarkingPage, marking_page

__all__ = ["MarkingPage", "marking_page"]
