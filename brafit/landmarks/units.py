"""Which unit a scan is in: said by a setting or the landmark file, or found from the wire or the body, never guessed.

A length between two bounds that lie closer together than two units do can only be in one of them. Where a second unit
would do as well, the scan is refused with the setting that decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from brafit.errors import InputError
from brafit.surface.neighbours import distances_to

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
"""Units that are read, and how many millimetres each is."""
NAMES = {"mm": "millimetres", "cm": "centimetres", "in": "inches", "m": "metres"}
WIRE_POSSIBLE, WIRE_USUAL = (80.0, 600.0), (140.0, 330.0)
"""Lengths of a wire, mm: of any that can be worn; of most."""
LENGTH_OVER_SPAN = 1.5
"""Length of a wire over the distance between its ends: 1.44 to 1.70 of 14."""
DEPTH_POSSIBLE, DEPTH_USUAL = (130.0, 450.0), (190.0, 345.0)
"""Depth of a torso, mm: the smallest extent of a scan of one, arms and legs included or not."""
DEPTH_RARE = (130.0, 480.0)
"""The largest bodies are this deep. More is not taken for one: a breast alone, 60 mm deep, would be a body in cm."""
NEAR = 30.0
"""Median distance (mm) within which marks lie on their cloud."""
DISTINCT = 3.0
"""A unit is certain if every other one puts the marks this many times as far from the cloud."""


@dataclass(frozen=True)
class Units:
    """Units of a scan's files, and whether they were said or found.

    Attributes:
        cloud, marks: one of `MILLIMETRES`.
        found: what they were found from; empty if they were said.
    """

    cloud: str
    marks: str
    found: str = ""


def unit_of(
    value: float,
    possible: tuple[float, float],
    usual: tuple[float, float],
    rare: tuple[float, float] | None = None,
) -> str | None:
    """The only unit in which a length lies within the bounds, or the only usual one; where it lies within them in no
    unit, the only one for rare cases; None if that is not clear.

    Args:
        value: a length in a unit that is not known.
        possible: least and largest length, mm.
        usual: least and largest usual length, mm.
        rare: least and largest length of any case, mm.
    """

    def fitting(bounds: tuple[float, float]) -> list[str]:
        return [unit for unit, factor in MILLIMETRES.items() if bounds[0] <= value * factor <= bounds[1]]

    found = fitting(possible)
    if len(found) > 1:
        found = fitting(usual)
    elif not found and rare is not None:
        found = fitting(rare)
    return found[0] if len(found) == 1 else None


def wire_unit(file: Path, length: float) -> str:
    """The unit of a wire of this length.

    Raises:
        InputError: two would do, or none.
    """
    unit = unit_of(length, WIRE_POSSIBLE, WIRE_USUAL)
    if unit is None:
        raise InputError(file, f"units: a wire of length {length:.4g} can be in none or in two units", _remedy(file))
    return unit


def body_unit(file: Path, points: Float[np.ndarray, "n 3"]) -> str:
    """The unit of a scan of a torso or a body, from its depth.

    Args:
        file: named in the error.
        points: of the scan, in its own unit.

    Raises:
        InputError: two would do, or none.
    """
    depth = body_depth(points)
    unit = _of_depth(depth)
    if unit is None and _in_two(depth):
        raise InputError(file, f"units: nothing says them, and {_in_two(depth)}", _remedy(file))
    if unit is None:
        cause = f"units: nothing says them, and {_no_body(depth)}: it seems to be a part of one"
        raise InputError(file, cause, _remedy(file))
    return unit


def torso_unit(file: Path, points: Float[np.ndarray, "n 3"]) -> str:
    """The unit of a scan without a landmark file, on which landmarks are to be proposed. As `body_unit`, but a part of
    a body is told to be marked by hand: a unit alone would not help it.

    Raises:
        InputError: two would do, or none.
    """
    depth = body_depth(points)
    unit, choice = _of_depth(depth), ", ".join(MILLIMETRES)
    if unit is None and _in_two(depth):
        remedy = f"Say which: scan.units=UNIT, with UNIT one of {choice}"
        raise InputError(file, f"units: nothing says them, and {_in_two(depth)}", remedy)
    if unit is None:
        cause = f"it seems to be a part of a body, where landmarks cannot be proposed ({_no_body(depth)})"
        remedy = (
            f"Mark it by hand with brafit-mark. Only if it is a whole torso, say its unit: scan.units=UNIT, {choice}"
        )
        raise InputError(file, cause, remedy)
    return unit


def _of_depth(depth: float) -> str | None:
    return unit_of(depth, DEPTH_POSSIBLE, DEPTH_USUAL, DEPTH_RARE)


def _in_two(depth: float) -> str:
    """What is in doubt of a depth that a body can have in more than one unit; empty of any other."""
    fitting = [NAMES[unit] for unit, factor in MILLIMETRES.items() if DEPTH_RARE[0] <= depth * factor <= DEPTH_RARE[1]]
    return f"a body {depth:.4g} deep can be in {' or '.join(fitting)}" if len(fitting) > 1 else ""


def _no_body(depth: float) -> str:
    return f"it is {depth:.4g} units deep: too little or too much for a whole one in any unit"


def body_depth(points: Float[np.ndarray, "n 3"]) -> float:
    """Smallest extent along the principal axes, between the 1st and the 99th percentile."""
    centred = points - np.median(points, axis=0)
    # Stray points far away must not turn the axes.
    size = np.linalg.norm(centred, axis=1)
    core = centred[size <= 3 * np.median(size)]
    axes = np.linalg.eigh(core.T @ core)[1]
    low, high = np.quantile(core @ axes, (0.01, 0.99), axis=0)
    return float((high - low).min())


def cloud_unit(points: Float[np.ndarray, "n 3"], marks: Float[np.ndarray, "k 3"]) -> str | None:
    """The unit in which marks (millimetres) lie on a cloud; None if that is not clear."""
    away = {}
    for unit, factor in MILLIMETRES.items():
        # What is farther than this compares as what is infinitely far.
        distances = distances_to(points, marks / factor, DISTINCT * NEAR / factor)
        away[unit] = factor * float(np.median(distances))
    best, *others = sorted(away, key=lambda unit: away[unit])
    clear = away[best] < NEAR and all(away[unit] > max(DISTINCT * away[best], NEAR / 2) for unit in others)
    return best if clear else None


def _remedy(file: Path) -> str:
    choice = ", ".join(MILLIMETRES)
    return f'Say which: scan.units=UNIT, or "units": "UNIT" in the landmark file, with UNIT one of {choice}'
