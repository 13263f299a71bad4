"""What the figures on a page are held against: the bounds that `brafit` itself has, and the wires that are sold."""

from __future__ import annotations

from typing import Any

from brafit.anatomy.confidence import BOUNDS as DOUBTS
from brafit.landmarks.cup_frame import END_TOLERANCE, LEAST_HEIGHT, LEAST_SPAN
from brafit.landmarks.plausibility import (
    BOW,
    COVERED,
    COVERED_WITH_MARGIN,
    MARK_DISTANCE,
    ONE_BREAST,
    WIRE_DISTANCE,
    WIRE_LENGTH,
)
from brafit.run.likeness import BOUNDS
from brafit.underwires.sizes import CATALOGUE


def bounds(flagged: bool) -> dict[str, Any]:
    """Bounds of the marks on a scan, lengths in mm.

    Args:
        flagged: the scan says which of its points are the cup's.
    """
    return {
        "wirePossible": WIRE_LENGTH,
        "wireUsual": BOUNDS["wire"].usual,
        "depthUsual": BOUNDS["depth"].usual,
        "depthPossible": BOUNDS["depth"].possible,
        "leastSpan": LEAST_SPAN,
        "leastHeight": LEAST_HEIGHT,
        "endTolerance": END_TOLERANCE,
        "wireDistance": WIRE_DISTANCE,
        "markDistance": MARK_DISTANCE,
        "endOff": DOUBTS["end_off"].usual[1],
        "covered": COVERED if flagged else COVERED_WITH_MARGIN,
        "bow": BOW,
        "oneBreast": ONE_BREAST,
    }


def catalogue() -> list[dict[str, Any]]:
    """Wires that are sold: maker, name, length and span in mm."""
    return [
        {"maker": wire.name.partition(":")[0], "name": wire.name, "length": wire.length, "span": wire.span}
        for wire in CATALOGUE
    ]
