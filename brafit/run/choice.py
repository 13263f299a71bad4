"""How many panels a scan gets where the settings leave that open, and what a seam through the bust point costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from brafit.fitting import CupFit
from brafit.fitting.objective import APEX, CLOSEST
from brafit.remarks import Remark
from brafit.run.likeness import seam_blamed
from brafit.run.recipe import FEWEST, MOST, Recipe

Fitter = Callable[[Recipe, Sequence[int], str], list[CupFit]]
"""Fits some scans, by their places in the batch, with a recipe; the text says what for."""


def chosen(recipe: Recipe, count: int, fit: Fitter) -> list[CupFit]:
    """The fits of a batch of scans, each with the number of panels that it needs, and with what that and the seam's
    place cost among its notes.

    Args:
        recipe: how to fit.
        count: of the scans.
        fit: fits some of them.
    """
    asked = recipe.tolerance
    fits = fit(recipe, range(count), "") if asked is None else _fewest(recipe, asked, count, fit)
    return _priced(recipe, fits, fit) if recipe.condition.seam == APEX else fits


def _fewest(recipe: Recipe, tolerance: float, count: int, fit: Fitter) -> list[CupFit]:
    """The fewest panels for every scan. One number more than that is fitted as well, to say what it would bring."""
    tried: list[dict[int, CupFit]] = [{} for _ in range(count)]
    left = list(range(count))
    for panels in range(FEWEST, MOST + 2):
        for k, found in zip(left, fit(recipe.with_panels(panels), left, f"{panels} panels"), strict=True):
            tried[k][panels] = found
        left = [k for k in left if panels == FEWEST or not _keeps(tried[k][panels - 1], tolerance)]
        if not left:
            break
    return [_taken(own, tolerance) for own in tried]


def _keeps(fit: CupFit, tolerance: float) -> bool:
    return fit.code.is_cup and fit.figures["rms_mm"] <= tolerance


def _taken(tried: Mapping[int, CupFit], tolerance: float) -> CupFit:
    """The fit with the fewest panels that keep the tolerance, else the closest; with the RMS of all."""
    allowed = [panels for panels in tried if panels <= MOST]
    kept = [panels for panels in allowed if _keeps(tried[panels], tolerance)]
    cups = [panels for panels in allowed if tried[panels].code.is_cup]
    closest = min(cups or allowed, key=lambda panels: tried[panels].figures["rms_mm"])
    panels = kept[0] if kept else closest
    taken, more = tried[panels], tried.get(panels + 1)
    words = f"{_panels(panels)}: {taken.figures['rms_mm']:.2f} mm"
    if more is not None:
        brings = f"would bring {more.figures['rms_mm']:.2f} mm" if more.code.is_cup else "would make no cup"
        words = f"{words}; {panels + 1} {brings}"
    warnings = taken.warnings
    if not kept:
        warnings = (*warnings, _missed(taken, panels, tried, tolerance))
    return replace(
        taken,
        warnings=warnings,
        notes=(*taken.notes, Remark("panels_chosen", words, taken.name)),
        seconds=sum(fit.seconds for fit in tried.values()),
        choice={
            **taken.choice,
            "tolerance_mm": tolerance,
            "rms_mm_by_panels": {str(n): _rms(fit) for n, fit in tried.items()},
            "panels": words,
        },
    )


def _missed(taken: CupFit, panels: int, tried: Mapping[int, CupFit], tolerance: float) -> Remark:
    """The warning of a scan whose tolerance no number of panels keeps: what is reached, and what would be kept."""
    cause = f"no cup of {FEWEST} to {MOST} panels keeps cup.tolerance={tolerance:g}"
    if not taken.code.is_cup:
        return Remark("tolerance_missed", f"{cause}: none of them makes a cup")
    reached = taken.figures["rms_mm"]
    remedy = f"cup.tolerance={math.ceil(100 * reached) / 100:g} is kept"
    beyond = [count for count in tried if count > MOST and _keeps(tried[count], tolerance)]
    if beyond:
        remedy += f", or set cup.panels={beyond[0]}: {tried[beyond[0]].figures['rms_mm']:.2f} mm"
    return Remark("tolerance_missed", f"{cause}: {panels} come closest, with {reached:.2f} mm RMS", remedy=remedy)


def _rms(fit: CupFit) -> float | None:
    return fit.figures["rms_mm"] if fit.code.is_cup else None


def _panels(count: int) -> str:
    return f"{count} panel{'s' * (count > 1)}"


def _priced(recipe: Recipe, fits: Sequence[CupFit], fit: Fitter) -> list[CupFit]:
    """The fits with what their seam through the bust point costs: the closest cups of as many panels, fitted too."""
    free = replace(recipe, condition=replace(recipe.condition, seam=CLOSEST))
    priced, counts = list(fits), [len(one.panels) for one in fits]
    for count in sorted(set(counts)):
        rows = [k for k, own in enumerate(counts) if own == count]
        wanted = free if recipe.tolerance is None else free.with_panels(count)
        for k, other in zip(rows, fit(wanted, rows, "closest"), strict=True):
            priced[k] = _price(fits[k], other)
    return priced


def _price(own: CupFit, other: CupFit) -> CupFit:
    """A cup with its seam through the bust point, beside the closest cup."""
    through, off = own.figures["rms_mm"], other.figures["rms_mm"]
    away = other.figures["seam_to_apex_mm"]
    words = f"seam through the bust point: {through:.2f} mm RMS; without it"
    words += f" {off:.2f} mm, and the seam is {away:.1f} mm from it" if other.code.is_cup else " there would be no cup"
    numbers = {"rms_mm": through, "closest_rms_mm": off, "closest_seam_to_apex_mm": away}
    return replace(
        seam_blamed(own, other),
        notes=(*own.notes, Remark("seam_price", words, own.name)),
        seconds=own.seconds + other.seconds,
        choice={**own.choice, "seam": words, "seam_price": numbers if other.code.is_cup else {"rms_mm": through}},
    )
