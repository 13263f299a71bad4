"""The fit of a batch of scans: starts, solver, choice of the best start, measurement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import Wire
from brafit.fitting.certainty import Alternative, Alternatives, deviations, outline_spread
from brafit.fitting.condition import measured_conditions
from brafit.fitting.measure import (
    Bend,
    figures_of,
    in_millimetres,
    seam_to_apex,
    tight_bends,
    upper_edge_gap,
    wire_places,
)
from brafit.fitting.neckline import Neckline
from brafit.fitting.objective import APEX, SEAM_LIMIT, Conditions, Objective, Pressure
from brafit.fitting.result import ResultCode, Survey
from brafit.fitting.shards import in_shards
from brafit.fitting.solver import Callback, Solution, Solver
from brafit.fitting.start import nearest_ridges, start_cups
from brafit.fitting.targets import Target, Targets
from brafit.geometry.development import FlatPanel
from brafit.remarks import Remark

TWIST_LIMIT = 0.01
"""Largest twist, in degrees, of panels that are to be developable."""
MARGIN_TOLERANCE = 0.005
"""How far the regularity margin may be below its bound."""
REFINEMENTS = 2
"""How often the grid of the output is refined where panels twist more."""
ISOMETRY_LIMIT = 1.0
"""Largest difference of lengths in space and in the pattern, in mm, of anything that is a cup at all."""
REMEDY = "Try more starts (restarts=6) or another number of panels (cup.panels)"
"""What helps where a fit is no cup."""
ONE_PANEL = "A breast bends both ways, a panel only one: set cup.panels to 2 or more"
TRIALS = 2
"""Ridges that are tried where one is to run through the apex: of several the nearest is not always the best."""
UNCERTAIN = 2.0
"""Largest standard deviation (mm) of an outline's place without a warning."""
TIGHT = 10.0
"""Least radius (mm) of a flat edge without a warning."""
FAR, FAR_SHARE = 5.0, 0.05
"""A warning is due if more than this share of the points is further than this from the cup, mm."""


@dataclass(frozen=True)
class CupFit:
    """A fitted cup.

    Attributes:
        name: name of the target.
        code, reason: how the fit ended.
        shape: the cup in its cup frame, mm, float64 on the CPU, no batch dimension.
        panels: its panels laid flat, mm, from the wire upwards.
        distances: signed distance of each point of the target, mm, positive outside the cup.
        figures: the measured figures by their names in `fit.json`.
        parameters: the cup's parameters by name, solver units.
        iterations: evaluations of the objective by the start that won.
        seconds: this scan's share of the batch's time.
        warnings: what is uncertain about the fit.
        alternatives: cups a standard deviation away, see `brafit.fitting.certainty`; none where that is not known.
        conditions: of each condition of another kind (`Conditions.extra`) what was measured, by its name.
        notes: what was found out by fitting, such as what one more panel would bring.
        choice: the same as numbers, for fit.json.
        uncovered_share: share of the cup without data near it (`brafit.report.uncovered`); nan: nobody measured it.
        survey: what is measured of it and its alternatives, where that was done for a whole batch.
        wire: the smooth wire that the cup lies on; None: not known.
    """

    name: str
    code: ResultCode
    reason: str
    shape: CupShape
    panels: list[FlatPanel]
    distances: Float[np.ndarray, " n"]
    figures: dict[str, float]
    parameters: dict[str, list]
    iterations: int
    seconds: float
    warnings: tuple[Remark, ...] = ()
    alternatives: Sequence[Alternative] = ()
    conditions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    notes: tuple[Remark, ...] = ()
    choice: Mapping[str, Any] = field(default_factory=dict)
    uncovered_share: float = float("nan")
    survey: Survey | None = None
    wire: Wire | None = None


def fit_targets(
    targets: Sequence[Target],
    cup: Callable[[Wire], Cup],
    solver: Solver,
    condition: Conditions,
    *,
    restarts: int = 1,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    threads: int = 1,
    callback: Callback | None = None,
) -> list[CupFit]:
    """Fit one batch of scans; each result is the same as if its scan were alone.

    Args:
        targets: the scans.
        cup: makes the cup model from its wires, e.g. `functools.partial(FramesCup, panels=2)`.
        solver: e.g. `Anneal`.
        condition: what is asked of the cups.
        restarts: starts per scan; the one with the lowest objective wins.
        dtype: precision of the fit; results are float64.
        device: of the fit; results are on the CPU.
        threads: processor cores that share the scans.
        callback: told of every step.

    Raises:
        ValueError: a target without points or with a wire that is no curve (checked input has neither).
    """
    begun = time.perf_counter()
    given = {"cup": cup, "solver": solver, "condition": condition, "restarts": restarts, "dtype": dtype}
    shards = threads if torch.device(device).type == "cpu" else 1
    fits = in_shards(partial(_fit_together, **given, device=device), targets, shards, callback)
    seconds = (time.perf_counter() - begun) / max(1, len(targets))
    return [replace(fit, seconds=seconds) for fit in fits]


def _fit_together(
    targets: Sequence[Target],
    callback: Callback | None,
    *,
    cup: Callable[[Wire], Cup],
    solver: Solver,
    condition: Conditions,
    restarts: int,
    dtype: torch.dtype,
    device: torch.device | str,
) -> list[CupFit]:
    """All scans as one batch."""
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    objective = starting_problems(targets, wires, cup, condition, restarts, dtype, device)
    solution = solver.solve(objective, objective.cup.flatten().detach(), callback)
    won = winners(objective, solution, wires)
    flat, rows = won.cup.flatten().detach(), won.rows
    named, steps = won.cup.split(flat), solution.iterations.tolist()
    changes, spread = certainty(won, condition)
    asked = measured_conditions(condition.extra, won.cup, won.targets)
    results = []
    for k, (row, target, measured) in enumerate(zip(rows, targets, measured_cups(won.cup, targets), strict=True)):
        parameters = {name: value[k].tolist() for name, value in named.items()}
        line = target.smooth_neckline(condition.neckline_wave)
        bends = tight_bends(measured.shape, measured.panels, target.strap_point)
        known = bool(spread[k].isfinite())
        wire = wires.select(torch.tensor([k]))
        alternatives = Alternatives(cup, wire, flat[k], changes[k], len(measured.shape.stations))
        figures = {
            "neckline_smoothing_mm": math.nan if line is None else line.smoothing,
            "outline_sd_mm": spread[k].item() if known else math.nan,
            "tightest_radius_mm": min(bend.radius for bend in bends),
        }
        fit = CupFit(
            name=target.name,
            code=solution.codes[row],
            reason=solution.codes[row].value,
            shape=measured.shape,
            panels=measured.panels,
            distances=measured.distances.numpy(),
            figures=measured.figures | figures,
            parameters=parameters,
            iterations=steps[row],
            seconds=0.0,
            alternatives=alternatives if known else (),
            conditions=asked[k],
            wire=wire,
        )
        told = solution.warnings[row] if solution.warnings else ()
        results.append(_judged(fit, line, bends, won.cup, condition, told))
    return results


@dataclass(frozen=True)
class Winners:
    """The best start of every scan, in double precision on the CPU, whatever the fit computed with.

    Attributes:
        cup: with the parameters that were found.
        targets: of the scans.
        pressure: with the weights that the fits ended with.
        rows: which problems they are.
    """

    cup: Cup
    targets: Targets
    pressure: Pressure
    rows: list[int]


def winners(objective: Objective, solution: Solution, wires: Wire) -> Winners:
    """Those of a solution. `wires`: of the scans, in double precision."""
    best = _best(objective, solution)
    cup = objective.cup.select(best).on(wires)
    cup.load_flat(solution.flat[best].to(wires.scale))
    pressure = solution.pressure.select(best)
    own = (pressure.barrier, pressure.neckline, pressure.seam)
    barrier, neckline, seam = (f.to(wires.scale) if isinstance(f, Tensor) else f for f in own)
    targets = objective.targets.select(best).to(wires.scale)
    return Winners(cup, targets, Pressure(pressure.penalty, {}, barrier, neckline, seam), best.tolist())


def certainty(won: Winners, condition: Conditions) -> tuple[Float[Tensor, "scans count size"], Float[Tensor, " scans"]]:
    """`deviations` of the winners, and the largest standard deviation (mm) of their outlines. None and nan for cups
    with constraints, which would have to be fulfilled anew for each.
    """
    flat = won.cup.flatten().detach()
    changes = flat.new_zeros(len(flat), 0, flat.shape[1])
    if not won.cup.constrained:
        changes = deviations(Objective(won.cup, won.targets, condition), flat, won.pressure)
    return changes, outline_spread(won.cup, flat, changes) * won.cup.wire.scale


def starting_problems(
    targets: Sequence[Target],
    wires: Wire,
    cup: Callable[[Wire], Cup],
    condition: Conditions,
    restarts: int,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    trials: int = TRIALS,
) -> Objective:
    """The objective of all starts of all scans, scan by scan, its cups at their starts.

    Where a ridge is to run through the apex (`Conditions.seam`), the nearest ones are tried in turn: each of them has
    as many starts.

    Args:
        targets: the scans.
        wires: of the scans, in their order.
        cup: makes the cup model from its wires.
        condition: what is asked of the cups.
        restarts: starts per scan.
        dtype: precision of the problems.
        device: where they are computed.
        trials: how many ridges are tried, at most.
    """
    one = cup(wires.select(torch.arange(len(targets))).to(device=device, dtype=dtype))
    trials = min(trials, one.panels - 1) if condition.seam == APEX and not one.constrained and one.panels > 1 else 1
    each = restarts * trials
    repeated = torch.arange(len(targets), device=device).repeat_interleave(each)
    model = one.select(repeated) if each > 1 else one
    batch = Targets.stack(targets, one.wire.scale, neckline_wave=condition.neckline_wave).select(repeated)
    tried = [target for target in targets for _ in range(trials)]
    curves = start_cups(model, tried, restarts)
    ridges = None
    if trials > 1:
        nearest = nearest_ridges(targets, curves[::each])[:, :trials]
        ridges = torch.from_numpy(nearest).to(device).flatten().repeat_interleave(restarts)
    # Cups of the paper's model start as arcs of the right size; without points they lose their way.
    guides = torch.as_tensor(curves, dtype=dtype, device=device) / batch.scale[:, None, None, None]
    guides = None if model.constrained else guides
    return Objective(model, batch, condition, repeated, guides, ridges)


def _best(objective: Objective, solution: Solution) -> Int[Tensor, " scans"]:
    """The start with the lowest objective of every scan, among those that were not dropped."""
    dropped = torch.tensor([code is ResultCode.DROPPED for code in solution.codes], device=solution.flat.device)
    left = (~dropped).nonzero()[:, 0]
    groups = objective.groups
    if len(left) > len(groups.unique()):
        value = objective.select(left).value(solution.flat[left], Pressure(solution.pressure.penalty))
        value = torch.where(value.isfinite(), value, torch.inf)
        order = value.argsort(stable=True)
        left = left[order][groups[left][order].argsort(stable=True)]  # by scan, the best first
    own = groups[left]
    first = torch.ones_like(own, dtype=torch.bool)
    first[1:] = own[1:] != own[:-1]
    return left[first]


def _judged(
    fit: CupFit,
    line: Neckline | None,
    bends: Sequence[Bend],
    cup: Cup,
    condition: Conditions,
    told: Sequence[Remark],
) -> CupFit:
    """The fit with its warnings; unresolved, if the model makes developable panels and these are not, or if it is no
    cup.
    """
    margin, twist = fit.figures["regularity_min"], fit.figures["twist_deg_max"]
    warnings, faults = list(told), list[Remark]()
    if margin < condition.margin - MARGIN_TOLERANCE:
        faults.append(Remark("margin", f"the regularity margin is {margin:.3f}, below {condition.margin:g}"))
    far = float((np.abs(fit.distances) > FAR).mean())
    if fit.code is ResultCode.STEP_LIMIT:
        warnings.append(Remark("step_limit", "the fit stopped at its step limit, perhaps short of the best cup"))
    if far > FAR_SHARE:
        cause = f"{far:.1%} of the points are more than {FAR:g} mm from the cup"
        warnings.append(Remark("far_points", cause, remedy="more panels follow it closer"))
    if fit.figures["outline_sd_mm"] > UNCERTAIN:
        sd = fit.figures["outline_sd_mm"]
        words = f"another scan of this breast would move the outlines by {sd:.1f} mm (standard deviation)"
        warnings.append(Remark("uncertain_outline", words))
    if cup.developable:
        warnings += [Remark("tight_bend", str(bend)) for bend in bends if bend.radius < TIGHT]
    limit = condition.neckline_limit
    off = 0.0 if line is None else upper_edge_gap(fit.shape.edges[-1], torch.as_tensor(np.concatenate(line.sides)))
    if not cup.constrained and limit is not None and off > 1.1 * limit:
        cause = (
            f"the upper edge is {off:.2f} mm off the smoothed neckline (mean), condition.neckline_limit is {limit:g}"
        )
        remedy = "a larger condition.neckline or a smaller condition.fairness brings it nearer"
        warnings.append(Remark("upper_edge_off", cause, remedy=remedy))
    if condition.seam == APEX and fit.figures["seam_to_apex_mm"] > SEAM_LIMIT:
        cause = f"the seam passes the bust point at {fit.figures['seam_to_apex_mm']:.1f} mm"
        cause = f"{cause}, {SEAM_LIMIT:g} mm are asked for"
        remedy = "a larger condition.ridge_apex brings it nearer"
        warnings.append(Remark("seam_off_bust_point", cause, remedy=remedy))
    if cup.developable and not twist <= TWIST_LIMIT:
        words = f"a ruling's normals differ by {twist:.3g} degrees, more than {TWIST_LIMIT:g}"
        faults.append(Remark("twist", words))
    torn = not fit.figures["isometry_mm"] <= ISOMETRY_LIMIT
    if torn:
        words = f"lengths in the cup and in its patterns differ by {fit.figures['isometry_mm']:.3g} mm"
        faults.append(Remark("isometry", words))
    if (cup.developable or torn) and faults and fit.code is not ResultCode.DIVERGED:
        code = ResultCode.UNRESOLVED
        remedy = REMEDY if fit.shape.panels > 1 else ONE_PANEL
        reason = f"{code.value}: {'; '.join(map(str, faults))}. {remedy}"
        return replace(fit, code=code, reason=reason, warnings=(*warnings, *faults))
    return replace(fit, warnings=(*warnings, *faults))


@dataclass(frozen=True)
class Measured:
    """One cup: shape in mm, flat panels, distances and figures."""

    shape: CupShape
    panels: list[FlatPanel]
    distances: Tensor
    figures: dict[str, float]


@torch.no_grad()
def measured_cups(cup: Cup, targets: Sequence[Target], refinements: int = REFINEMENTS) -> list[Measured]:
    """The cups of a batch; those whose panels are to be developable and are not yet, on finer grids.

    Args:
        cup: one cup for each target.
        targets: the scans.
        refinements: how often the grid of the output may yet be refined.
    """
    wire, flat = cup.wire, cup.flatten()
    units = cup.shape_of(flat)
    points = [torch.as_tensor(t.points, dtype=torch.float64) / s for t, s in zip(targets, wire.scale, strict=True)]
    distances = units.distances(pad_sequence(points, batch_first=True), coarse=cup.sketch(flat))
    distances = distances * wire.scale[:, None]
    smooth = wire.sample(wire_places(units.stations))
    results = []
    for k, target in enumerate(targets):
        scale = wire.scale[k].item()
        shape = in_millimetres(units.map(partial(torch.select, dim=0, index=k)), scale)
        flat, own = shape.flat(), distances[k, : len(target.points)]
        neckline = None if target.neckline is None else torch.as_tensor(target.neckline, dtype=torch.float64)
        figures = figures_of(shape, flat, own, neckline, smooth[k] * scale, wire.smoothing[k].item())
        figures["seam_to_apex_mm"] = seam_to_apex(shape, target.bust_point)
        panels = [FlatPanel(*edges) for edges in zip(flat.lower, flat.upper, strict=True)]
        results.append(Measured(shape, panels, own, figures))
    twisted = [k for k, one in enumerate(results) if not one.figures["twist_deg_max"] <= TWIST_LIMIT]
    if cup.developable and twisted and refinements:
        finer = cup.select(torch.tensor(twisted)).refined()
        for k, one in zip(twisted, measured_cups(finer, [targets[k] for k in twisted], refinements - 1), strict=True):
            results[k] = one
    return results
