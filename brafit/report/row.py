"""A scan's row: its line of summary.csv and the first entries of its fit.json. The only maker of rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from brafit.fitting.loop import CupFit
from brafit.naming import shown
from brafit.underwires.nearest import nearest_wire

NECKLINE = {"upper_edge_mm", "neckline_smoothing_mm"}
"""Figures of fits with a neckline."""
OPTIONAL = {"outline_sd_mm", "seam_to_apex_mm"}
"""Figures that not every fit has: no deviation is known of cups with constraints, and one panel has no seam."""


def failed_row(
    name: str, reason: str, model: Mapping[str, Any], side: str | None = None, points: int | None = None
) -> dict[str, Any]:
    """The row of a scan without a result.

    Args:
        name: of the scan.
        reason: one line with file, cause and remedy.
        model: cup, solver, panels and terms, by these keys.
        side: the wearer's `left` or `right` breast; None: not known.
        points: of the fit; None: it did not come to that.
    """
    row = {"scan": name, "status": "failed", "reason": shown(reason), **model, "side": side, "points": points}
    return {key: value for key, value in row.items() if value is not None}


def fitted_row(
    fit: CupFit,
    side: str,
    points: int,
    model: Mapping[str, Any],
    neckline: bool,
    wire: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """The row of a fit: `ok` if it is a cup and all its figures are numbers.

    Args:
        fit: the fit, with its code and figures.
        side: the wearer's `left` or `right` breast.
        points: of the scan.
        model: cup, solver, panels and terms, by these keys.
        neckline: whether the scan has one; without it there is no distance from it.
        wire: `play` and `spring` of the wire in its channel, see `brafit.pattern.PatternOptions`.
    """
    figures = {key: math.nan if value is None else float(value) for key, value in fit.figures.items()}
    row = failed_row(fit.name, fit.reason, model, side, points)
    row["panels"] = len(fit.panels)
    row |= figures | _wire_to_buy(fit, wire or {}) | {"iterations": fit.iterations, "seconds": fit.seconds}
    if not fit.code.is_cup:
        return row
    absent = OPTIONAL if neckline else OPTIONAL | NECKLINE
    missing = [key for key, value in figures.items() if key not in absent and not math.isfinite(value)]
    if missing:
        return row | {"reason": f"{fit.reason}, but not finite: {', '.join(missing)}"}
    return row | {"status": "ok"}


def _wire_to_buy(fit: CupFit, wire: Mapping[str, float]) -> dict[str, Any]:
    """The wire sold that comes nearest to the one that the cup's wire edge wants, and how it differs from that one.

    With play or spring that is not the wire edge itself.
    """
    line = fit.shape.edges[0].detach().cpu().double().numpy()
    if not np.isfinite(line).all():
        return {}
    near = nearest_wire(line, wire.get("play", 0.0), wire.get("spring", 0.0))
    differences = {"nearest_wire_length_diff_mm": near.length, "nearest_wire_span_diff_mm": near.span}
    return {"nearest_wire": near.wire.name, **differences}
