"""Is a fitted cup a likeness of a breast? Bounds from scans of which that is known.

Lengths are taken as shares of the wire's. Measured on 21 shared and bundled scans (real and parametric bodies, wires of
186 to 290 mm) with 2, 3 and 4 panels, and on both sides of five torsos with proposed landmarks:

| | measured | warned of | refused |
| --- | --- | --- | --- |
| RMS of the distances | 0.003 to 0.027 | above 0.035 | above 0.06 |
| 95 % of the distances below | 0.006 to 0.058 | above 0.075 | above 0.12 |
| largest distance | 0.008 to 0.081 | above 0.12 | |
| depth of the points before the wire's plane | 0.20 to 0.42 | below 0.1, above 0.6 | below 0.04, above 1 |
| points farther behind that plane than 0.05 | none | above 2 % | above 20 % |
| length of the wire | 186 to 290 mm | below 150, above 350 mm | below 80, above 600 mm |
| wire that was marked off the skin between the points, RMS | 0.00, scan_02 0.017 | above 0.025 | as the next |
| upper line that was marked off them | 0.00 | above 0.02 | see `brafit.landmarks.plausibility` |
| a marked point off them | 0.00 to 0.012, scan_08 0.038 | above 0.06 | the same |
| height of the marked bust point over that of the breast | 0.92 to 0.99 | below 0.75, above 1.25 | |
| cup more than 0.1 away from all points, of landmarks proposed or mirrored | not above 15 % | above 15 % | above 30 % |
| surface between wire and upper line without points | 0 to 4 %, scan_02 22 % | above 10 % | see `brafit.scan.load` |

For comparison, points on the faces of a box give an RMS of 0.17. The largest distance refuses nothing, since a single
stray point is no reason to lose a good cup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from brafit.anatomy.confidence import Bound, warning
from brafit.fitting import CupFit, ResultCode
from brafit.fitting.loop import FAR
from brafit.geometry.polyline import polyline_length
from brafit.landmarks.fields import POINT_NAMES
from brafit.landmarks.plausibility import WIRE_LENGTH
from brafit.remarks import Remark
from brafit.report.uncovered import uncovered_share
from brafit.scan import Scan
from brafit.scan.wiring import size_laid
from brafit.underwires.nearest import chosen_wire

AWAY = 0.1
"""A place of the cup has no data if every point is farther away than this many wire lengths: more than a cup of two
panels can be off a breast."""
BEHIND = 0.05
"""A point farther than this many wire lengths behind the wire's plane is no breast's."""
ROUGH = 1.8
"""Scatter (mm) of cleaned points that alone puts a twentieth of them FAR from a cup (`brafit.fitting.loop`)."""
LOOK = "look at the points and the lines with brafit-inspect"
LOOK_OR_PANELS = f"{LOOK}: they may not be one breast's, or the cup needs more panels (cup.panels)"
_TRACED = f"check that the landmark file is this scan's, and mark on its skin: {LOOK}"


BOUNDS: Mapping[str, Bound] = {
    "rms": Bound(
        "the cup is far from the points: RMS {value}",
        usual=(0.0, 0.035),
        possible=(0.0, 0.06),
        remedy=LOOK_OR_PANELS,
    ),
    "p95": Bound(
        "a twentieth of the points is farther from the cup than {value}",
        usual=(0.0, 0.075),
        possible=(0.0, 0.12),
        remedy=LOOK_OR_PANELS,
    ),
    "max": Bound(
        "a point is {value} from the cup",
        usual=(0.0, 0.12),
        remedy=f"{LOOK}: it may be none of the breast's; a smaller scan.outliers takes strays out",
    ),
    "depth": Bound(
        "the points reach {value} out of the wire's plane, which is not like a breast",
        usual=(0.1, 0.6),
        possible=(0.04, 1.0),
        remedy=f"check that wire and points belong together and have the same unit: {LOOK}",
    ),
    "behind": Bound(
        "{value} of the points lie behind the wire's plane, where the chest is",
        usual=(0.0, 0.02),
        possible=(0.0, 0.2),
        remedy=f"check wire, upper line and side: {LOOK}",
    ),
    "wire": Bound(
        "the wire line is {value} long, wires are 150 to 350 mm",
        usual=(150.0, 350.0),
        possible=WIRE_LENGTH,
        remedy="check the landmarks and their unit (scan.units): brafit-inspect draws them",
    ),
    "wire_off": Bound(
        "the wire line is {value} off the skin that was scanned (root mean square)",
        usual=(0.0, 0.025),
        remedy=_TRACED,
    ),
    "upper_off": Bound(
        "the upper line is {value} off the skin that was scanned (root mean square)",
        usual=(0.0, 0.02),
        remedy=_TRACED,
    ),
    "marks_off": Bound("{side} is {value} off the skin that was scanned", usual=(0.0, 0.06), remedy=_TRACED),
    "apex": Bound(
        "the marked bust point is {value} as far out of the wire's plane as the breast is",
        usual=(0.75, 1.25),
        remedy=f"correct it, or leave it out: {LOOK}",
    ),
    "uncovered": Bound(
        "the landmarks that nobody looked at are not plausible: {value} of their cup lies away from all points",
        usual=(0.0, 0.15),
        possible=(0.0, 0.3),
        remedy=f"{LOOK}, and mark by hand what is wrong",
    ),
    "gap": Bound(
        "{value} of the surface between wire and upper line has no points, the cup is a guess there",
        usual=(0.0, 0.1),
        remedy="scan the breast again, from below as well, or check wire and upper line with brafit-inspect",
    ),
}
_SHARES = ("behind", "gap", "uncovered", "apex")
_DISTANCES = ("rms", "p95", "max")
_MARKED = {
    "wire_off": ("wire",),
    "upper_off": ("upper_line",),
    "marks_off": tuple(f"landmarks.{name}" for name in POINT_NAMES),
}
"""Of each measure of what was marked by hand, the names in `Scan.away`."""
_POINTS = {
    "inner_end": "inner end of the wire",
    "outer_end": "outer end of the wire",
    "wire_bottom": "lowest point of the wire",
    "apex": "bust point",
    "strap_point": "strap point",
}
"""What the marked points are called in words."""


def measures(fit: CupFit, scan: Scan) -> dict[str, float]:
    """The measures that `BOUNDS` judges: lengths over the wire's length, but for the wire's own (mm).

    Args:
        fit: the cup.
        scan: as it was fitted.
    """
    length = polyline_length(scan.wire)
    height = scan.points[:, 2] / length
    found = {key: fit.figures[f"{key}_mm"] / length for key in _DISTANCES}
    found |= {"depth": float(height.max()), "behind": float((height < -BEHIND).mean()), "wire": length}
    found |= {key: max(off) / length for key, names in _MARKED.items() if (off := _away(scan, names))}
    if scan.origin.marks == "given" and scan.apex is not None:
        found["apex"] = float(scan.apex[2] / max(scan.dense[:, 2].max(), 1e-9))
    if scan.confidence is not None:
        found["uncovered"] = uncovered_share(fit.shape, scan.dense, AWAY * length)
    return found if scan.gap_share is None else found | {"gap": scan.gap_share}


def _farthest(scan: Scan) -> str:
    """The marked point that is farthest off the skin, in words."""
    found = {name: scan.away[key] for name in POINT_NAMES if (key := f"landmarks.{name}") in scan.away}
    return f"the marked {_POINTS[max(found, key=lambda name: found[name])]}" if found else "a marked point"


def _away(scan: Scan, names: Sequence[str]) -> list[float]:
    return [away for name, away in scan.away.items() if name in names]


def code_of(key: str) -> str:
    """The code of the warning of a measure of `BOUNDS` that is unusual."""
    return f"unlike_{key}"


_COSTS = "the seam through the bust point costs "
_TAKE = "take more panels (cup.panels), or leave the seam where it is closest (condition.seam=closest)"
_MULTIPLIED = 2.0
"""A distance, or the share of far points, is the seam's doing if it is more than so many times that without it."""


def seam_blamed(fit: CupFit, free: CupFit) -> CupFit:
    """A fit whose warnings and faults of distances name the seam through the bust point as their cause, if the cup
    without it has none like them, or is much closer. What helps is said once.

    Args:
        fit: of a cup whose seam was led through the bust point.
        free: to the same points, its seams where they are closest.
    """
    if not free.code.is_cup:
        return fit
    own, other, anyway = _distances(fit), _distances(free), {one.code for one in free.warnings}
    multiplied = {code for code in own if own[code] > _MULTIPLIED * other[code]}
    # A share that is large without the seam cannot double: there the root mean square says whose doing it is.
    blamed = own.keys() if code_of("rms") in multiplied else multiplied | (own.keys() - anyway)

    def costs(one: Remark) -> str:
        return f"{_COSTS}{'most of that' if one.code in anyway else 'that'}"

    def told(remarks: Sequence[Remark]) -> tuple[Remark, ...]:
        first = next((one for one in remarks if one.code in blamed), None)
        return tuple(
            replace(one, remedy=f"{costs(one)}: {_TAKE}" if one is first else f"{costs(one)} too")
            if one.code in blamed
            else one
            for one in remarks
        )

    faults = [replace(one, remedy=f"{costs(one)}: {_TAKE}") if one.code in blamed else one for one in fit.faults]
    fit = replace(fit, warnings=told(fit.warnings), faults=tuple(faults))
    return replace(fit, reason=_unlike(fit.faults)) if fit.code is ResultCode.UNLIKE else fit


def _distances(fit: CupFit) -> dict[str, float]:
    """What is judged of a cup's distances, by the codes of the warnings."""
    far = float((np.abs(fit.distances) > FAR).mean())
    return {"far_points": far, **{code_of(key): fit.figures[f"{key}_mm"] for key in _DISTANCES}}


def judged(fit: CupFit, scan: Scan) -> CupFit:
    """The fit with warnings for what is unusual; unlike, if a measure is beyond what a breast's cup can have.

    A fit that failed by itself stays as it is; one whose cup is not regular says first if its points are no breast's,
    unless it has one panel, which is far from any breast's.
    """
    if not fit.code.is_cup:
        several = fit.code is ResultCode.UNRESOLVED and fit.shape.panels > 1
        faults = _judged(fit, scan)[1] if several else []
        return replace(fit, reason=f"{_unlike(faults)}. {fit.reason}") if faults else fit
    fit = replace(fit, warnings=tuple(_of_noise(told, scan) for told in fit.warnings))
    warnings = list[Remark]()
    if scan.confidence is not None:
        fit = replace(fit, figures=fit.figures | {"landmark_confidence": scan.confidence.value})
        doubts = warning(scan.confidence, scan.origin.marks)
        warnings += [] if doubts is None else [doubts]
    if scan.own_wire is not None:
        told, far = chosen_wire(size_laid(scan.origin.wire), scan.own_wire)
        words = f"{told}: take that (scan.wire), or check the wire line with brafit-inspect"
        warnings += [Remark("chosen_wire_far", words)] if far else []
    unusual, faults = _judged(fit, scan)
    if faults:
        fit = replace(fit, code=ResultCode.UNLIKE, reason=_unlike(faults), faults=tuple(faults))
    return replace(fit, warnings=(*fit.warnings, *warnings, *unusual))


def _of_noise(told: Remark, scan: Scan) -> Remark:
    """The warning of far points with the remedy that helps where the scan is noisy: no number of panels does."""
    scatter = scan.cleaning.scatter_mm
    if told.code != "far_points" or scatter is None or scatter < ROUGH:
        return told
    words = f"they scatter by {scatter:.1f} mm about their surface, which no number of panels follows"
    return replace(told, remedy=words)


def _judged(fit: CupFit, scan: Scan) -> tuple[list[Remark], list[Remark]]:
    """What is unusual about a cup's measures, and what no breast's cup has."""
    length, unusual, faults = polyline_length(scan.wire), list[Remark](), list[Remark]()
    for key, value in measures(fit, scan).items():
        bound = BOUNDS[key]
        scale = 1.0 if key == "wire" else length
        shown = f"{100 * value:.0f} %" if key in _SHARES else f"{scale * value:.1f} mm"
        cause = bound.cause(shown, _farthest(scan) if key == "marks_off" else "")
        if not bound.is_usual(value):
            beyond = unusual if bound.is_possible(value) else faults
            beyond.append(Remark(code_of(key), cause, remedy=bound.remedy))
    return unusual, faults


def _unlike(faults: Sequence[Remark]) -> str:
    """Why a cup is none of these points: causes with one remedy together."""
    remedies = dict.fromkeys(fault.remedy for fault in faults)
    alike = [(" and ".join(one.text for one in faults if one.remedy == remedy), remedy) for remedy in remedies]
    said = [f"{causes}; {remedy}" for causes, remedy in alike]
    return f"{ResultCode.UNLIKE.value}: {'. '.join([said[0], *(one[0].upper() + one[1:] for one in said[1:])])}"
