"""The fit of a batch of scans: starts, solver, choice of the best start, measurement.

Solving runs where the fit is asked to; measuring, scan by scan and in double precision, always on the processor.
"""

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

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import Wire
from brafit.fitting.certainty import Alternative, Alternatives, deviations, outline_spread
from brafit.fitting.condition import measured_conditions
from brafit.fitting.measure import TWIST_LIMIT, Bend, measured_cups, tight_bends, upper_edge_gap
from brafit.fitting.neckline import Neckline
from brafit.fitting.objective import APEX, SEAM_LIMIT, Conditions, Objective, Pressure
from brafit.fitting.result import ResultCode, Survey
from brafit.fitting.shards import in_shards
from brafit.fitting.solver import Callback, Solution, Solver
from brafit.fitting.start import nearest_ridges, start_cups
from brafit.fitting.targets import Target, Targets
from brafit.geometry.development import FlatPanel
from brafit.remarks import Remark

MARGIN_TOLERANCE = 0.005
"""How far the regularity margin may be below its bound."""
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
MEASURED = 16
"""Fits measured at once: more take no less time, but more memory."""


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
        faults: why it is no likeness of the points (`brafit.run.likeness`).
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
    faults: tuple[Remark, ...] = ()
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
        threads: processor cores that share the scans; with another device, what is measured of their fits.
        callback: told of every step.

    Raises:
        ValueError: a target without points or with a wire that is no curve (checked input has neither).
    """
    begun = time.perf_counter()
    solve = partial(solved, cup=cup, solver=solver, condition=condition, restarts=restarts, dtype=dtype, device=device)
    if torch.device(device).type == "cpu":
        work = partial(_together, solve=solve, finish=partial(finished, cup=cup, condition=condition))
        fits = in_shards(work, targets, threads, callback)
    else:
        fits = finished(solve(targets, callback=callback), cup, condition, threads)
    seconds = (time.perf_counter() - begun) / max(1, len(targets))
    return [replace(fit, seconds=seconds) for fit in fits]


def _together(
    targets: Sequence[Target],
    callback: Callback | None,
    *,
    solve: Callable[..., Winners],
    finish: Callable[[Winners], list[CupFit]],
) -> list[CupFit]:
    """Solved and measured in one process."""
    return finish(solve(targets, callback=callback))


def finished(won: Winners, cup: Callable[[Wire], Cup], condition: Conditions, threads: int = 1) -> list[CupFit]:
    """The fits of a batch that was solved, here or on another device, measured on the processor and judged.

    Args:
        won: where the fits ended.
        cup: makes the cup model from its wires.
        condition: what is asked of the cups.
        threads: processor cores that share them.
    """
    work = partial(_in_turn, cup=cup, condition=condition)
    return [fit for some in in_shards(work, won.parts(MEASURED), threads) for fit in some]


def _in_turn(
    parts: Sequence[Winners], _: Callback | None, *, cup: Callable[[Wire], Cup], condition: Conditions
) -> list[list[CupFit]]:
    return [_finished(part, cup=cup, condition=condition) for part in parts]


@dataclass(frozen=True)
class Winners:
    """The best start of every scan, in double precision on the CPU, whatever the fit computed with.

    Attributes:
        given: the scans.
        cup: with the parameters that were found.
        targets: of the scans.
        pressure: with the weights that the fits ended with.
        codes: how the fits ended.
        steps: evaluations of the objective.
        told: what the solver has to say about each.
        seconds: a scan's share of the batch's time.
    """

    given: Sequence[Target]
    cup: Cup
    targets: Targets
    pressure: Pressure
    codes: Sequence[ResultCode]
    steps: Sequence[int]
    told: Sequence[Sequence[Remark]]
    seconds: float = 0.0

    def parts(self, size: int) -> list[Winners]:
        """So many scans at a time."""
        return [self._of(range(k, min(k + size, len(self.given)))) for k in range(0, len(self.given), size)]

    def _of(self, rows: range) -> Winners:
        index, some = torch.tensor(rows), slice(rows.start, rows.stop)
        cup, targets, pressure = (one.select(index) for one in (self.cup, self.targets, self.pressure))
        lists = {name: getattr(self, name)[some] for name in ("given", "codes", "steps", "told")}
        return replace(self, cup=cup, targets=targets, pressure=pressure, **lists)


def solved(
    targets: Sequence[Target],
    cup: Callable[[Wire], Cup],
    solver: Solver,
    condition: Conditions,
    *,
    restarts: int = 1,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    callback: Callback | None = None,
) -> Winners:
    """Where the fits of a batch end, not measured yet. The arguments are those of `fit_targets`."""
    begun = time.perf_counter()
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    objective = starting_problems(targets, wires, cup, condition, restarts, dtype, device)
    won = winners(objective, solver.solve(objective, objective.cup.flatten().detach(), callback), targets, wires)
    return replace(won, seconds=(time.perf_counter() - begun) / max(1, len(targets)))


def winners(objective: Objective, solution: Solution, targets: Sequence[Target], wires: Wire) -> Winners:
    """Those of a solution.

    Args:
        objective: what was solved.
        solution: where it ended.
        targets: the scans.
        wires: of the scans, in double precision.
    """
    best = _best(objective, solution)
    cup = objective.cup.select(best).on(wires)
    cup.load_flat(solution.flat[best].to(wires.scale))
    pressure = solution.pressure.select(best)
    own = (pressure.barrier, pressure.neckline, pressure.seam)
    barrier, neckline, seam = (f.to(wires.scale) if isinstance(f, Tensor) else f for f in own)
    rows, steps = best.tolist(), solution.iterations.tolist()
    return Winners(
        given=targets,
        cup=cup,
        targets=objective.targets.select(best).to(wires.scale),
        pressure=Pressure(pressure.penalty, {}, barrier, neckline, seam),
        codes=[solution.codes[row] for row in rows],
        steps=[steps[row] for row in rows],
        told=[solution.warnings[row] if solution.warnings else () for row in rows],
    )


def _finished(won: Winners, *, cup: Callable[[Wire], Cup], condition: Conditions) -> list[CupFit]:
    """Measured and judged. `cup`: makes the cup model from its wires."""
    flat = won.cup.flatten().detach()
    named = won.cup.split(flat)
    changes, spread = certainty(won, condition)
    asked = measured_conditions(condition.extra, won.cup, won.targets)
    results = []
    for k, (target, measured) in enumerate(zip(won.given, measured_cups(won.cup, won.given), strict=True)):
        line = target.smooth_neckline(condition.neckline_wave)
        bends = tight_bends(measured.shape, measured.panels, target.strap_point)
        known = bool(spread[k].isfinite())
        wire = won.cup.wire.select(torch.tensor([k]))
        alternatives = Alternatives(cup, wire, flat[k], changes[k], len(measured.shape.stations))
        figures = {
            "neckline_smoothing_mm": math.nan if line is None else line.smoothing,
            "outline_sd_mm": spread[k].item() if known else math.nan,
            "tightest_radius_mm": min(bend.radius for bend in bends),
        }
        fit = CupFit(
            name=target.name,
            code=won.codes[k],
            reason=won.codes[k].value,
            shape=measured.shape,
            panels=measured.panels,
            distances=measured.distances.numpy(),
            figures=measured.figures | figures,
            parameters={name: value[k].tolist() for name, value in named.items()},
            iterations=won.steps[k],
            seconds=won.seconds,
            alternatives=alternatives if known else (),
            conditions=asked[k],
            wire=wire,
        )
        results.append(_judged(fit, line, bends, won.cup, condition, won.told[k]))
    return results


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
    if fit.code is ResultCode.STEP_LIMIT and all(one.code != "step_limit" for one in told):
        warnings.append(Remark("step_limit", "the fit stopped at its step limit, perhaps short of the best cup"))
    if far > FAR_SHARE:
        cause = f"{100 * far:.1f} % of the points are more than {FAR:g} mm from the cup"
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
