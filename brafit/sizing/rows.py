"""Rows of the tables of sizes: of each size, of each member, and of each finished dimension."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from brafit.cup.shape import CupShape
from brafit.report.dimensions import measured_on
from brafit.sizing.service import NEAR, Sizes, Worn, worn
from brafit.sizing.stored import StoredFit
from brafit.sizing.units import in_unit
from brafit.underwires.nearest import FAR

NAMED = 5
"""Wearers that a warning names; the table has all."""
FAR_WORDS = f"more than a size ({FAR:g} mm)"


def size_names(count: int) -> list[str]:
    """Of sizes, the shortest wire first: 1, 2, ... with as many digits as the last has."""
    return [f"{k + 1:0{len(str(count))}d}" for k in range(count)]


def gaps(
    found: Sizes,
    shapes: Sequence[CupShape],
    points: Float[ndarray, "n places 3"],
    weights: Float[ndarray, " places"],
) -> list[Worn]:
    """How each member's own cup lies to that of her size.

    Args:
        found: the sizes.
        shapes: their cups.
        points: of all members' cups, at corresponding places.
        weights: of the places.
    """
    told: list[Worn | None] = [None] * len(points)
    for size, (member, shape) in enumerate(zip(found.medoids, shapes, strict=True)):
        own = found.members(size)
        for k, one in zip(own, worn(shape, points[member], points[own], weights), strict=True):
            told[k] = one
    return [one for one in told if one is not None]


def size_rows(
    found: Sizes, fits: Sequence[StoredFit], shapes: Sequence[CupShape], gap: Sequence[Worn]
) -> list[dict[str, Any]]:
    """A row for each size: whose cup it is, how many it serves how well, its wire and its measures (mm)."""
    rows = []
    for size, (name, member, shape) in enumerate(zip(size_names(len(shapes)), found.medoids, shapes, strict=True)):
        own, fit = found.members(size), fits[member]
        errors, edges, wires = found.error[own], shape.edges.numpy(), [fits[k].wire_length for k in own]
        far = sum(abs(longer) > FAR for longer in fit.wire_length - np.array(wires))
        rows.append(
            {
                "size": name,
                "scan": fit.name,
                "members": len(own),
                "mean_mm": float(errors.mean()),
                "p95_mm": float(np.percentile(errors, 95)),
                "within_3mm_percent": 100 * float((errors <= NEAR).mean()),
                "gap_mm": float(np.mean([gap[k].rms for k in own])),
                "surface_within_3mm_percent": 100 * float(np.mean([gap[k].near for k in own])),
                "wire_mm": fit.wire_length,
                "span_mm": float(np.linalg.norm(edges[0, -1] - edges[0, 0])),
                "depth_mm": float(edges[..., 2].max()),
                "nearest_wire": fit.wire_name,
                "members_wire_mm": f"{min(wires):.0f} to {max(wires):.0f}",
                "members_far_wire": int(far),
                "folder": str(fit.folder),
            }
        )
    return rows


def member_rows(found: Sizes, fits: Sequence[StoredFit], gap: Sequence[Worn]) -> list[dict[str, Any]]:
    """A row for each member: her size, how far it is from her own cup (mm), the size that is next best, and how much
    longer the wire of her size is than her own, with a warning where that is more than FAR.
    """
    names = size_names(len(found.medoids))
    longer = _longer(found, fits)
    return [
        {
            "scan": fit.name,
            "side": fit.side,
            "size": names[found.size[k]],
            "error_mm": found.error[k],
            "gap_mm": gap[k].rms,
            "gap_p95_mm": gap[k].p95,
            "surface_within_3mm_percent": 100 * gap[k].near,
            "second": names[found.second[k]] if found.second[k] >= 0 else "",
            "second_error_mm": found.second_error[k],
            "wire_mm": fit.wire_length,
            "nearest_wire": fit.wire_name,
            "size_wire_diff_mm": longer[k],
            "warning": _far_words(longer[k]),
            "folder": str(fit.folder),
        }
        for k, fit in enumerate(fits)
    ]


def _longer(found: Sizes, fits: Sequence[StoredFit]) -> list[float]:
    """By how much (mm) the wire of each member's size is longer than her own; negative: shorter."""
    lengths = np.array([fit.wire_length for fit in fits])
    return (lengths[found.medoids[found.size]] - lengths).tolist()


def _differs(longer: float) -> str:
    return f"{abs(longer):.0f} mm {'longer' if longer > 0 else 'shorter'}"


def _far_words(longer: float) -> str:
    return f"the wire of her size is {_differs(longer)} than her own, {FAR_WORDS}" if abs(longer) > FAR else ""


def far_wires(found: Sizes, fits: Sequence[StoredFit]) -> list[str]:
    """A warning where the size that serves members best has a wire that differs from their own by more than FAR, which
    is what wires differ by from size to size: cups are compared all over, and the wire is but an edge of them.
    """
    longer = _longer(found, fits)
    far = sorted((k for k in range(len(fits)) if abs(longer[k]) > FAR), key=lambda k: -abs(longer[k]))
    if not far:
        return []
    named = [f"{fits[k].name}, {_differs(longer[k])}" for k in far[:NAMED]]
    others = f"; and {len(far) - NAMED} more" * (len(far) > NAMED)
    return [
        f"{len(far)} of {len(fits)} wearers get a wire {FAR_WORDS} longer or shorter than their own: "
        f"{'; '.join(named)}{others} (members.csv). Ask for more sizes, or cut these cups from their own patterns"
    ]


def graded_rows(found: Sizes, fits: Sequence[StoredFit], units: str = "mm") -> list[dict[str, Any]]:
    """A row for each finished dimension (part, name, unit, as cut or as worn), with its value in each size.

    Args:
        found: the sizes.
        fits: of the members.
        units: of `brafit.pattern.options.UNITS`.
    """
    names = size_names(len(found.medoids))
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, member in zip(names, found.medoids, strict=True):
        for part, what, value, unit, *_ in fits[member].dimensions:
            own, unit = in_unit(value, unit, units)
            head = {"part": part, "dimension": what, "unit": unit, "measured": measured_on(part, what)}
            row = rows.setdefault((part, what), head | dict.fromkeys(names))
            row[name] = own
    return list(rows.values())
