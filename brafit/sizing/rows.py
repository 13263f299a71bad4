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
                "folder": str(fit.folder),
            }
        )
    return rows


def member_rows(found: Sizes, fits: Sequence[StoredFit], gap: Sequence[Worn]) -> list[dict[str, Any]]:
    """A row for each member: her size, how far it is from her own cup (mm), and the size that is next best."""
    names = size_names(len(found.medoids))
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
            "folder": str(fit.folder),
        }
        for k, fit in enumerate(fits)
    ]


def graded_rows(found: Sizes, fits: Sequence[StoredFit]) -> list[dict[str, Any]]:
    """A row for each finished dimension (part, name, unit, as cut or as worn), with its value in each size."""
    names = size_names(len(found.medoids))
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, member in zip(names, found.medoids, strict=True):
        for part, what, value, unit, *_ in fits[member].dimensions:
            head = {"part": part, "dimension": what, "unit": unit, "measured": measured_on(part, what)}
            row = rows.setdefault((part, what), head | dict.fromkeys(names))
            row[name] = value
    return list(rows.values())
