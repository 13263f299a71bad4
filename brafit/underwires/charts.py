"""Charts of underwires that are sold: lengths by maker and size, and the diameter of a size.

All charts of lengths are straight lines in the size's number, and have no diameters. Diameters are those of the table
"underwire size" in Wikipedia's article "Bra size" (after B. Johnson, The Bra-makers Manual): size 30 (32A, 30B, 28C) is
3 5/6 inches across, each further size of two a third of an inch more; an independent chart has the same to a
millimetre. It is taken that all makers number their wires so.
"""

from __future__ import annotations

import difflib
import statistics
from dataclasses import dataclass

from brafit.errors import ConfigError

INCH = 25.4
DIAMETER, STEP = 3 + 5 / 6, 1 / 6
"""Inches: of size 30, and more for each number above it."""
STYLES = REGULAR, SHORT = ("regular", "short")


@dataclass(frozen=True)
class Chart:
    """A maker's wires of one style: lengths in mm, a straight line in the size.

    Attributes:
        maker: the wire's name, as `scan.wire` has it.
        style: one of `STYLES`.
        source: who published the chart.
        smallest, largest: sizes that are sold; all are even.
        length: of the smallest size.
        growth: more length for each number above it.
    """

    maker: str
    style: str
    source: str
    smallest: int
    largest: int
    length: float
    growth: float

    @property
    def sizes(self) -> range:
        """The sizes that are sold."""
        return range(self.smallest, self.largest + 1, 2)

    def length_of(self, size: int) -> float:
        """Length of a wire, mm."""
        return self.length + self.growth * (size - self.smallest)

    def name_of(self, size: int) -> str:
        """A wire as `scan.wire` names it."""
        return f"{self.maker}:{size}{'' if self.style == REGULAR else f'/{self.style}'}"

    def __str__(self) -> str:
        return f"{self.maker} {self.smallest} to {self.largest}{'' if self.style == REGULAR else f' ({self.style})'}"


CHARTS = (
    Chart("orange", REGULAR, "Emerald Erin, 17 May 2023 ('Orange', long regular)", 30, 52, 173.0, 7.5),
    Chart("harriet", REGULAR, "Cloth Habit ('Harriet', regular)", 30, 58, 165.0, 7.45),
    Chart("flexlite", REGULAR, "shop chart ('FlexLite', regular), rounded, unconfirmed", 44, 60, 267.0, 8.3),
    Chart("france", SHORT, "Emerald Erin, 17 May 2023 ('France', short)", 30, 50, 127.0, 7.5),
)  # fmt: skip
"""Every chart at hand."""


def diameter(size: int) -> float:
    """Width of a wire of this size, mm."""
    return (DIAMETER + STEP * (size - 30)) * INCH


def sold() -> str:
    """The makers and their sizes, in words."""
    return f"even sizes of {', '.join(map(str, CHARTS))}"


def usual_length(size: int, style: str) -> float:
    """Length of a size where no maker is named: the median of those that sell it in this style, mm.

    Raises:
        ConfigError: nobody sells it.
    """
    lengths = [chart.length_of(size) for chart in CHARTS if chart.style == style and size in chart.sizes]
    if not lengths:
        raise ConfigError(f"nobody sells a {style} wire of size {size}; known are {sold()}")
    return statistics.median(lengths)


def chart_of(maker: str, style: str | None, size: int) -> Chart:
    """The chart of a maker that has this wire.

    Args:
        maker: as `scan.wire` has it.
        style: one of `STYLES`; None: the maker's only one, or else its regular one.
        size: an even number, 30 to 60.

    Raises:
        ConfigError: it does not sell such a wire.
    """
    own = [chart for chart in CHARTS if chart.maker == maker]
    if not own:
        meant = difflib.get_close_matches(maker, [chart.maker for chart in CHARTS], n=1)
        hint = f"did you mean {meant[0]}:{size}? " if meant else ""
        raise ConfigError(f"no maker {maker} is known; {hint}known are {sold()}")
    fit = [chart for chart in own if style in (None, chart.style) and size in chart.sizes]
    if not fit:
        words = f"a {style} wire" if style else "a wire"
        raise ConfigError(f"{maker} does not sell {words} of size {size}; known are {sold()}")
    return min(fit, key=lambda chart: STYLES.index(chart.style))
