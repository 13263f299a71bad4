"""From loaded scans to their fits and results: one road, for the command and for `brafit.fit`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from brafit.fitting import CupFit, Target
from brafit.fitting.certainty import Alternatives, shapes_of
from brafit.fitting.loop import Winners
from brafit.fitting.objective import APEX
from brafit.fitting.result import Survey
from brafit.fitting.solver import Callback
from brafit.pattern import Side
from brafit.pattern.cloth import cloth_words
from brafit.remarks import Remark
from brafit.report.dimensions import surveys
from brafit.report.measures import Cups
from brafit.report.uncovered import uncovered_share
from brafit.result import Result
from brafit.run.choice import chosen
from brafit.run.course import Course
from brafit.run.likeness import judged
from brafit.run.recipe import Recipe
from brafit.scan import Scan
from brafit.scan.middle import middle_of
from brafit.surface import point_weights

GUESS = "the scan's point farthest from the wire's plane"
"""What stands for a bust point that nobody marked, in words."""
SURVEYED = 4
"""Fits that are surveyed at once: more take no less time, but more memory."""


def target_of(scan: Scan) -> Target:
    """What the fit is told of a scan: its points, marks and assumed places, and what each of them weighs."""
    target = _unweighted(scan)
    spacing = None if len(scan.assumed) else scan.spacing
    return replace(target, weights=point_weights(target.seen, scan.curve, spacing))


def _unweighted(scan: Scan) -> Target:
    """Without the weights, which take time and which only the fit asks for."""
    return Target(
        name=scan.name,
        points=scan.points,
        wire=scan.wire,
        neckline=scan.neckline,
        strap_point=scan.strap_point,
        apex=scan.apex,
        assumed=scan.assumed,
    )


def fitted(recipe: Recipe, scans: Sequence[Scan], callback: Callback | None = None) -> list[CupFit]:
    """The fits of a batch, in its order, judged by what a cup of a breast can be.

    Args:
        recipe: how to fit.
        scans: of the batch.
        callback: called with a `Step` after every step.
    """
    scans = [middle_of(scan, _thickness(recipe)) for scan in scans]
    targets, course = _targets(recipe, scans), Course(callback)

    def some(own: Recipe, places: Sequence[int], name: str) -> list[CupFit]:
        fits = own.fit([targets[k] for k in places], course.of(places, name))
        return [judged(fit, scans[k]) for fit, k in zip(fits, places, strict=True)]

    fits = chosen(recipe, len(scans), some)
    return [_with_facts(fit, scan) for fit, scan in zip(fits, scans, strict=True)]


def solved(recipe: Recipe, scans: Sequence[Scan], callback: Callback | None = None) -> list[Winners]:
    """Where the fits of a batch ended, of each scan on its own: `measured` makes fits of them. The arguments are those
    of `fitted`; the recipe compares no fits.
    """
    targets = _targets(recipe, [middle_of(scan, _thickness(recipe)) for scan in scans])
    return recipe.solve(targets, callback).parts(1)


def measured(recipe: Recipe, scan: Scan, won: Winners) -> CupFit:
    """What `fitted` gives of a scan, from where its fit ended.

    Args:
        recipe: how it was fitted.
        scan: as it was loaded.
        won: its part of what `solved` gave.
    """
    scan = middle_of(scan, _thickness(recipe))
    (fit,) = recipe.measure(won)
    return _with_facts(judged(fit, scan), scan)


def _targets(recipe: Recipe, scans: Sequence[Scan]) -> list[Target]:
    targets = [target_of(scan) for scan in scans]
    if recipe.condition.seam == APEX:
        return [replace(target, apex=target.bust_point) for target in targets]
    return targets


def _with_facts(fit: CupFit, scan: Scan) -> CupFit:
    """The fit with what the scan has to say of it."""
    notes = fit.notes
    if scan.apex is None:
        words = f"no bust point is marked: it is taken to be {GUESS}"
        remedy = "mark it (landmarks.apex) where that is another"
        notes = (*notes, Remark("bust_point_guessed", words, fit.name, remedy))
    return replace(fit, notes=notes, uncovered_share=uncovered_share(fit.shape, scan.dense))


def with_surveys(recipe: Recipe, scans: Sequence[Scan], fits: Sequence[CupFit]) -> list[CupFit]:
    """The fits, in their order, with what is measured of each and its alternatives: of many at once, in less time.

    Args:
        recipe: what is asked for.
        scans: of the fits.
        fits: of `fitted`.
    """
    alike: dict[tuple[int, int, int, bool], list[int]] = {}
    for k, (scan, fit) in enumerate(zip(scans, fits, strict=True)):
        if fit.code.is_cup:
            kind = (fit.shape.panels, len(fit.shape.stations), len(fit.alternatives), scan.strap_point is None)
            alike.setdefault(kind, []).append(k)
    found = list(fits)
    for same in alike.values():
        for first in range(0, len(same), SURVEYED):
            some = same[first : first + SURVEYED]
            surveyed = _surveys(recipe, [scans[k] for k in some], [fits[k] for k in some])
            for k, survey in zip(some, surveyed, strict=True):
                found[k] = replace(fits[k], survey=survey)
    return found


def _surveys(recipe: Recipe, scans: Sequence[Scan], fits: Sequence[CupFit]) -> list[Survey]:
    """Of fits with as many panels, stations and alternatives, of scans that all have a strap point or none."""
    cups = Cups.of([[fit] for fit in fits])
    several = [fit.alternatives for fit in fits if isinstance(fit.alternatives, Alternatives)]
    if several:
        cups = cups.beside(Cups.varied(*shapes_of(several)))
    apexes = [_unweighted(scan).bust_point for scan in scans]
    straps = [scan.strap_point for scan in scans if scan.strap_point is not None]
    return surveys(cups, np.stack(apexes), np.stack(straps) if straps else None, recipe.pattern.report)


def result_of(recipe: Recipe, scan: Scan, fit: CupFit) -> Result:
    """The fit of a scan with all that can be made of it.

    Args:
        recipe: patterns, names and settings.
        scan: as it was loaded.
        fit: its cup, of `fitted`.
    """
    turned = ", from its outer end: turned" * scan.origin.wire_turned
    sources = {
        "points": f"{scan.path.name}, {len(scan.points)} used",
        "wire": f"{scan.origin.wire} ({len(scan.wire)} points){turned}",
        "side": f"{scan.origin.marks} ({scan.side})",
        "neckline": "none: only the points say where the cup ends" if scan.neckline is None else scan.origin.neckline,
        "strap point": "none" if scan.strap_point is None else scan.origin.marks,
        "apex": f"not given: {GUESS}" if scan.apex is None else scan.origin.marks,
    }
    words = cloth_words(recipe.pattern)
    if thickness := _thickness(recipe):
        words[0] += f": the cup is its middle, {thickness / 2:.1f} mm outside of the skin"
    sources |= {"cloth": "; ".join(words)} if words else {}
    side: Side = "right" if scan.side == "right" else "left"
    facts = scan_facts(scan, fit) | {"settings": recipe.settings}
    return Result(fit, _unweighted(scan), side, scan.frame, recipe.pattern, sources, recipe.model, facts)


def _thickness(recipe: Recipe) -> float:
    return recipe.pattern.cloth["thickness"]


def scan_facts(scan: Scan, fit: CupFit) -> dict[str, Any]:
    """What became of the scan before the fit, and how much of the cup has no data."""
    return {
        "cleaning": asdict(scan.cleaning),
        "units": asdict(scan.units),
        "origin": asdict(scan.origin),
        "notes": [str(note) for note in (*scan.notes, *fit.notes)],
        "note_codes": [note.code for note in (*scan.notes, *fit.notes)],
        "uncovered_share": fit.uncovered_share,
        "assumed_points": len(scan.assumed),
        "landmarks": {
            "wire_points": len(scan.wire),
            "neckline_points": 0 if scan.neckline is None else len(scan.neckline),
            "strap_point": scan.strap_point,
            "apex": scan.apex,
            "bust_point": _unweighted(scan).bust_point,
        },
    }
