"""What web pages of results have in common: their frame, their words for figures, and how numbers look in them."""

from __future__ import annotations

import math
from functools import cache
from html import escape
from importlib import resources
from typing import Any
from urllib.parse import quote

from brafit import __version__

MEANINGS: dict[str, tuple[str, str]] = {
    "points": ("points of the fit", ""),
    "rms_mm": ("distance of the points from the cup: root mean square", "mm"),
    "mean_mm": ("mean", "mm"),
    "p95_mm": ("95th percentile", "mm"),
    "max_mm": ("largest", "mm"),
    "upper_edge_mm": ("upper edge off the neckline as given, mean", "mm"),
    "neckline_smoothing_mm": ("given neckline off the smooth one that the cup follows, at most", "mm"),
    "seam_to_apex_mm": ("nearest seam and bust point apart", "mm"),
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
    "seconds": ("time of the fit", "s"),
}
"""Figures of a fit that the pages show: what they mean, and their unit."""


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


def short(value: float) -> str:
    """Four digits at most, and no powers of ten for what is as good as nothing."""
    return "< 0.001" if 0 < abs(value) < 0.001 else f"{value:.4g}"


def text(words: Any) -> str:
    """Words as they stand in a page; nothing for None."""
    return escape(str("" if words is None else words))


def link(file: str) -> str:
    """The address of a file beside the page."""
    return escape(quote(file))
