"""The plain cup: how the rulings of a cup of strips lie where data say little, (69) of docs/formulation.md.

Deep breasts want other cups than shallow ones. So a plain cup depends on one number of the breast: the mean height of
its surface over the wire's plane, which no noise and no choice of points moves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

HEIGHT = 0.5
"""A usual mean height of a breast over the wire's plane, in solver units: the wire's length is pi."""


class Line(NamedTuple):
    """First coefficients of a series: at HEIGHT, and their change with the height."""

    at: tuple[float, ...]
    by_height: tuple[float, ...]


class Panel(NamedTuple):
    """The series of a plain cup's panel; `length` is of lengths times the number of panels."""

    rib: Line
    length: Line


TWO = (
    Panel(
        Line((-0.02, 0.17, 0.03, -0.04, 0.01), (0.09, 0.52, 0.3, 0.16, -0.19)),
        Line((0.76, -0.16, 0.1, 0.01, -0.04), (0.98, -0.21, -0.85, 0.45, 0.04)),
    ),
    Panel(
        Line((-0.28, -1.63, 0.1, 0.06, -0.05), (0.41, -0.27, -0.07, 0.79, -0.38)),
        Line((1.54, 0.06, 0.18, 0.02, 0.01), (0.21, -0.1, -0.43, -0.02, 0.01)),
    ),
)
THREE = (
    Panel(
        Line((-0.07, 0.29, -0.05, -0.06, 0.01), (0.23, 0.67, 0.26, 0.09, -0.1)),
        Line((0.72, -0.08, 0.08, -0.04, -0.04), (0.17, -0.08, -0.55, 0.22, 0.0)),
    ),
    Panel(
        Line((-0.09, -0.3, -0.03, 0.01, -0.01), (-0.08, 0.14, 0.11, 0.19, 0.06)),
        Line((0.54, -0.15, 0.1, -0.01, 0.0), (1.88, -0.41, -0.94, 0.1, -0.04)),
    ),
    Panel(
        Line((-0.27, -1.58, 0.08, -0.03, -0.05), (0.63, 0.01, -0.34, 0.28, -0.23)),
        Line((1.65, 0.02, 0.08, -0.01, 0.02), (-0.11, -0.24, -0.38, 0.07, -0.09)),
    ),
)
"""Of fits to 14 scanned and 111 made breasts with two and three panels: straight lines through their coefficients over
the breasts' heights. The height alone accounts for half of what their squares vary by."""
ORDER = 5.0
"""From about this order on terms count ever more."""


def panel_of(number: int, panels: int) -> Panel:
    """The plain panel of that number, from 0 at the wire. Of more than three, all between first and last are alike."""
    usual = TWO if panels <= 2 else THREE
    from_last = panels - 1 - number
    return usual[-1] if from_last == 0 else usual[0] if number == 0 else usual[1]


def term_counts(terms: int) -> Float[Tensor, " terms"]:
    """How much a term of a series counts: (1 + (k / ORDER)^6)^(1/2), low orders alike, high orders as third derivatives
    of the edges would count them.
    """
    order = torch.arange(terms, dtype=torch.float64)
    return (1 + (order / ORDER) ** 6).sqrt()


def lines(panels: int, terms: int) -> dict[str, tuple[Float[Tensor, "panels terms"], Float[Tensor, "panels terms"]]]:
    """For the series `rib` and `length` of all panels: the coefficients at HEIGHT, and their change with the height."""
    result = {}
    for name in Panel._fields:
        series = [getattr(panel_of(i, panels), name) for i in range(panels)]
        both = [torch.zeros(panels, terms, dtype=torch.float64) for _ in Line._fields]
        for row, line in enumerate(series):
            for values, told in zip(both, line, strict=True):
                values[row, : len(told)] = torch.tensor(told[:terms], dtype=torch.float64)
        result[name] = tuple(both)
    result["length"][0][:, 0] -= math.log(panels)
    return result
