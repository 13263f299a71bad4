"""What web pages of results have in common: their frame, their words for figures, and how numbers look in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib import resources
from typing import Any
from urllib.parse import quote

from brafit import __version__

MEANINGS: dict[str, tuple[str, str]] = {
    "points": ("points of the fit", ""),
    "rms_mm": ("distance of the points from the cup: root mean square", "mm"),
    "mean_mm": ("mean of these distances", "mm"),
    "p95_mm": ("95 % of these distances are smaller", "mm"),
    "max_mm": ("largest of these distances", "mm"),
    "upper_edge_mm": ("upper edge off the neckline as given, mean", "mm"),
    "neckline_smoothing_mm": ("given neckline off the smooth one that the cup follows, at most", "mm"),
    "seam_to_apex_mm": ("seam to bust point: how far the nearest seam is from it", "mm"),
    "outline_sd_mm": ("standard deviation of the sewing lines' place if the breast were scanned again, at most", "mm"),
    "tightest_radius_mm": ("tightest bend of a flat edge (radius), the strap's corner apart", "mm"),
    "wire_length_mm": ("length of the wire line", "mm"),
    "wire_smoothing_mm": ("given wire points off the smooth wire line, at most", "mm"),
    "wire_drift_mm": ("wire edge of the cup off the smooth wire line, at most", "mm"),
    "twist_deg_max": ("twist along a ruling, at most (0: truly developable)", "degrees"),
    "regularity_min": ("smallest regularity margin (above 0: rulings do not cross)", ""),
    "isometry_mm": ("lengths in the cup and in the flat pattern differ by, at most", "mm"),
    "seam_mismatch_mm": ("before ease and stretch, the two sides of a seam differ in length by, at most", "mm"),
    "iterations": ("evaluations of the objective", ""),
    "seconds": ("time of the fit, a scan: that of its batch by the number of its scans", "s"),
}
"""Figures of a fit that the pages show: what they mean, and their unit."""
HEADS = {
    "seam_to_apex_mm": "seam to bust point",
    "outline_sd_mm": "outlines ±",
    "twist_deg_max": "twist",
    "seconds": "seconds a scan",
}
"""What columns are called, where their keys do not say it."""
PLACES = {"points": 0, "iterations": 0, "wire_length_mm": 1, "seconds": 1}
"""Decimal places of figures that have not two: a hundredth of a millimetre is what cloth is cut to at best."""


def page(title: str, body: str, wide: bool = False) -> str:
    """A whole page that needs no other file."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="brafit {__version__}">\n<title>{text(title)}</title>\n'
        f"<style>\n{asset('page.css')}</style>\n</head>\n<body{' class=wide' * wide}>\n{body}\n</body>\n</html>\n"
    )


@cache
def asset(name: str) -> str:
    """A style sheet or script of this package."""
    return resources.files("brafit.report").joinpath(name).read_text(encoding="utf-8")


def number(value: Any) -> float | None:
    """A finite number, or None."""
    if value is None or isinstance(value, str) or not math.isfinite(float(value)):
        return None
    return float(value)


def fixed(value: float, places: int = 2) -> str:
    """A number with so many decimal places, so that those of a column align; of what is as good as nothing a bound."""
    least = 10.0**-places
    return f"< {least:.{places}f}" if 0 < abs(value) < least / 2 else f"{value:.{places}f}"


def figure(key: str, value: float) -> str:
    """A figure of a fit with as many decimal places as it always has."""
    return fixed(value, PLACES.get(key, 2))


def head(key: str) -> str:
    """What the column of a figure is called."""
    return HEADS.get(key, key.removesuffix("_mm").replace("_", " "))


def text(words: Any) -> str:
    """Words as they stand in a page; nothing for None."""
    return escape(str("" if words is None else words))


def warned(warnings: Sequence[str]) -> str:
    """Warnings as a box that is not overlooked; nothing without any."""
    lines = "".join(f"<li>{text(words)}</li>" for words in warnings)
    return f'<div class="warnings"><b>Warnings</b><ul>{lines}</ul></div>' if lines else ""


def link(file: str) -> str:
    """The address of a file beside the page."""
    return escape(quote(file))
