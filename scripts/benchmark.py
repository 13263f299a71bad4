"""Measures the strips cup and the lm solver: every figure of its table in docs/figures.md comes from one run.

    python scripts/benchmark.py FOLDER_OF_BREASTS            all parts but the slow ones
    python scripts/benchmark.py FOLDER --slow                with 100 starts and the paper's solver
    python scripts/benchmark.py FOLDER --only breasts,speed  some parts
    python scripts/benchmark.py FOLDER --gpu                 throughput on a GPU and where its time goes, nothing else

Times are CPU times of this process, so that a busy machine does not spoil ratios; the throughput is wall time as well.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rescans import write_rescans
from scipy.optimize import least_squares
from torch import Tensor

from brafit.cli.fit import cores
from brafit.cup import CupShape, FramesCup, StripsCup, Wire
from brafit.cup.corner import CORNER_SIZE
from brafit.fitting import LM, Conditions, LMStage, NelderMead, Target, fit_targets
from brafit.fitting.lm import minimise, staged
from brafit.fitting.loop import finished, starting_problems, winners
from brafit.fitting.measure import in_millimetres, measured_cups, upper_edge_gap
from brafit.fitting.objective import Objective, Pressure
from brafit.fitting.targets import Targets
from brafit.run.fitting import target_of
from brafit.run.recipe import recipe_of
from brafit.scan import find_scans, load_scan
from brafit.simulation.synthetic import on_panels, quarter_sphere

POINTS = 2000
RESTARTS = 3
"""Starts of a scan, where starts are compared; elsewhere as shipped, one."""
BATCHES = (16, 256, 4096)
"""Scans of the batches on a GPU."""
SMALL = 2
"""Scans where there is none."""
WIRE = 200.0
"""Length of the synthetic wires, mm."""


def shipped() -> tuple[LM, Conditions]:
    """Solver and conditions as `brafit cup=strips solver=lm` has them."""
    recipe = recipe_of(["cup=strips", "solver=lm"])
    return recipe.solver, recipe.condition


@cache
def breasts(folder: str, count: int = POINTS) -> list[Target]:
    """The scans of a folder, each with so many of its points: one drawn at random from each of as many equal stretches
    of the curve along which they come. So the density stays theirs, and RMS depends little on the draw (1 %; plain
    draws differ by up to 4 %).
    """
    targets = []
    for path in find_scans([folder]):
        scan = load_scan(path, points=None, outliers=None)
        bounds = np.arange(min(count, len(scan.points)) + 1) * max(len(scan.points) / count, 1.0)
        chosen = np.random.default_rng(0).uniform(bounds[:-1], bounds[1:]).astype(int)
        points = scan.points[chosen]
        targets.append(Target(scan.name, points, scan.wire, scan.neckline, scan.strap_point, scan.apex))
    return targets


def report_breasts(targets: list[Target]) -> None:
    """Figures of every scan with two and three panels."""
    solver, conditions = shipped()
    for panels in (2, 3):
        fits = fit_targets(targets, partial(StripsCup, panels=panels), solver, conditions)
        print(f"\n{panels} panels: RMS, p95, max, upper edge, margin, twist deg, isometry, seam, drift (mm), status")
        for fit in fits:
            f = fit.figures
            print(
                f"  {fit.name:12} {f['rms_mm']:6.2f} {f['p95_mm']:6.1f} {f['max_mm']:6.1f} {f['upper_edge_mm']:6.2f}"
                f" {f['regularity_min']:6.3f} {f['twist_deg_max']:8.1e} {f['isometry_mm']:8.1e}"
                f" {f['seam_mismatch_mm']:8.1e} {f['wire_drift_mm']:8.1e} {fit.code.name.lower()}"
            )
        print(f"  median RMS {np.median([fit.figures['rms_mm'] for fit in fits]):.2f} mm")


def report_unmarked(targets: list[Target]) -> None:
    """How far from the marked bust point the one lies that is guessed where none is marked."""
    print("\nguessed bust points, mm from the marked ones")
    off = [
        float(np.linalg.norm(replace(one, apex=None).bust_point - one.apex)) for one in targets if one.apex is not None
    ]
    print(f"  median {np.median(off):.1f}; each:", *(f"{away:.1f}" for away in sorted(off)))


def report_seam(targets: list[Target], counts: Sequence[int], at_once: int, starts: int = 8) -> None:
    """A seam through the bust point: how near it comes, what it costs, and whether one start finds what eight find with
    every ridge in turn.

    Args:
        targets: the breasts.
        counts: numbers of panels.
        at_once: breasts that are fitted as one batch. The figures do not depend on it, but with four panels each has 24
            problems of its own, and those of 14 in one batch wait for the slowest.
        starts: of each seam.
    """
    for panels in counts:
        each = starts * (panels - 1)
        print(f"\n{panels} panels, closest: RMS, seam to apex; through it: RMS, seam to apex, over the best of {each}")
        rows: list[tuple[float, float]] = []
        begun = time.process_time()
        for k in range(0, len(targets), at_once):
            rows += _seams_of(targets[k : k + at_once], panels, starts)
        nearest, shares = np.array(rows).T
        print(f"  largest: {nearest.max():.2f} mm, {shares.max():+.2%}; {time.process_time() - begun:.0f} CPU s")


def _seams_of(targets: list[Target], panels: int, starts: int) -> list[tuple[float, float]]:
    """Lines of `report_seam`; for each breast how far the seam is from the apex, and its RMS over the best."""
    solver, free = shipped()
    through = replace(free, seam="apex")
    every = LM([replace(stage, keep=None) for stage in solver.stages], solver.margin, solver.apart)
    cup = partial(StripsCup, panels=panels)
    closest, fits = (fit_targets(targets, cup, solver, asked) for asked in (free, through))
    wires = Wire.stack([Wire.from_polyline(target.wire) for target in targets])
    objective = starting_problems(targets, wires, cup, through, starts, trials=panels - 1)
    each = objective.cup.batch // len(targets)
    ends = every.solve(objective, objective.cup.flatten().detach(), None).flat
    objective.cup.load_flat(ends)
    cups = measured_cups(objective.cup, [target for target in targets for _ in range(each)], 0)
    rows = []
    for k, (other, fit) in enumerate(zip(closest, fits, strict=True)):
        own, f = other.figures, fit.figures
        tried = [one.figures for one in cups[k * each : (k + 1) * each]]
        best = min((one["rms_mm"] for one in tried if one["seam_to_apex_mm"] <= 1), default=math.nan)
        rows.append((f["seam_to_apex_mm"], f["rms_mm"] / best - 1))
        print(
            f"  {fit.name:12} {own['rms_mm']:6.2f} {own['seam_to_apex_mm']:6.1f}   {f['rms_mm']:6.2f}"
            f" {f['seam_to_apex_mm']:6.2f} {rows[-1][1]:+7.2%} {fit.code.name.lower()}",
            flush=True,
        )
    return rows


def problems(targets: list[Target], panels: int) -> Objective:
    """One start per scan, as a batch."""
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    return starting_problems(targets, wires, partial(StripsCup, panels=panels), shipped()[1], restarts=1)


def report_steps(targets: list[Target]) -> None:
    """Gauss-Newton steps until the objective is within 1 % of where each stage ends."""
    solver, _ = shipped()
    for panels in (2, 3):
        objective = problems(targets, panels)
        place = objective.cup.flatten().detach()
        counts = []
        for stage in solver.stages:
            part, place = staged(objective, place, stage)
            ending = minimise(part, place, Pressure(1.0), stage, lambda *_: None)
            place = ending.place
            near = (ending.history <= 1.01 * ending.history[-1]).double().argmax(0) + 1
            counts.append(int(near.median()))
        print(f"{panels} panels: median steps to within 1 % per stage: {counts}")


def report_starts(targets: list[Target]) -> None:
    """The first stage that looks at points, begun from plain arcs and from cups drawn to the cloud's sections."""
    solver, _ = shipped()
    guiding, first = solver.stages[0], replace(solver.stages[1], steps=60)
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    for panels in (2, 3):
        cup = partial(StripsCup, panels=panels)
        objective = starting_problems(targets, wires, cup, shipped()[1], RESTARTS)
        arcs = objective.cup.flatten().detach()
        part, place = staged(objective, arcs, guiding)
        sections = minimise(part, place, Pressure(1.0), guiding, lambda *_: None).place
        part = staged(objective, arcs, first)[0]
        endings = [minimise(part, p, Pressure(1.0), first, lambda *_: None) for p in (arcs, sections)]
        best = torch.stack([e.value.view(-1, RESTARTS).amin(1) for e in endings]).amin(0).repeat_interleave(RESTARTS)
        for name, ending in zip(("arcs", "sections"), endings, strict=True):
            history = ending.history / best
            steps = ((ending.history <= 1.05 * ending.history[-1]).double().argmax(0) + 1).median()
            print(
                f"{panels} panels from {name}: objective over the best {history[0].median():.1f} after one step,"
                f" {int(steps)} steps to within 5 % of its end, {(history[-1] < 1.05).double().mean():.0%} of starts in"
                " the best optimum"
            )


def report_speed(targets: list[Target]) -> None:
    """Scans per second of the whole batch, all starts and the measurement included; the best of three runs."""
    solver, conditions = shipped()
    for threads in (1, 2):
        best = (math.inf, math.inf)
        for _ in range(3):
            wall, cpu = time.perf_counter(), time.process_time()
            fit_targets(targets, partial(StripsCup, panels=2), solver, conditions, threads=threads)
            best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
        print(
            f"{len(targets)} scans, {threads} cores: {len(targets) / best[0]:.2f} scans/s"
            f" ({best[0]:.1f} s, {best[1]:.1f} s CPU of the first)"
        )


def report_single(targets: list[Target]) -> None:
    """RMS in single precision against double."""
    solver, conditions = shipped()
    for panels in (2, 3):
        cup = partial(StripsCup, panels=panels)
        both = [
            fit_targets(targets, cup, solver, conditions, dtype=d, threads=2) for d in (torch.float64, torch.float32)
        ]
        off = np.array([b.figures["rms_mm"] - a.figures["rms_mm"] for a, b in zip(*both, strict=True)])
        near = int((np.abs(off) <= 0.01).sum())
        print(
            f"{panels} panels, float32 less float64, RMS mm: median {np.median(off):.3f}, from {off.min():.3f} to"
            f" {off.max():.3f}; within 0.01 on {near} of {len(off)}"
        )


def report_rim(targets: list[Target]) -> None:
    """How far the upper edge ends from the neckline that the fit is not told, with and without the two-sided term."""
    solver, conditions = shipped()
    bare = [replace(target, neckline=None) for target in targets]
    for panels in (2, 3):
        for weight in (0.0, conditions.rim):
            own = replace(conditions, rim=weight)
            fits = fit_targets(bare, partial(StripsCup, panels=panels), solver, own, threads=2)
            off = [
                upper_edge_gap(fit.shape.edges[-1], torch.as_tensor(target.neckline))
                for fit, target in zip(fits, targets, strict=True)
            ]
            print(
                f"{panels} panels, no neckline given, condition.rim={weight:g}: upper edge off it by"
                f" {np.median(off):.1f} mm (median), at most {max(off):.1f} mm"
            )


def report_memory(folder: str) -> None:
    """200,000 points of one scan without thinning (drawn with repetition where it has fewer)."""
    target = breasts(folder, 10**9)[0]
    rng = np.random.default_rng(0)
    many = replace(target, points=target.points[rng.integers(len(target.points), size=200_000)])
    solver, conditions = shipped()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    wall = time.perf_counter()
    fit = fit_targets([many], partial(StripsCup, panels=2), solver, conditions)[0]
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(
        f"200,000 points: RMS {fit.figures['rms_mm']:.2f} mm in {time.perf_counter() - wall:.1f} s,"
        f" peak memory {before:.2f} -> {after:.2f} GiB"
    )


def sphere_objective(cup: StripsCup | FramesCup, **conditions: float) -> Objective:
    """The paper's Case 1 in units of R: quarter sphere, pole held."""
    points = quarter_sphere(1000, 1.0, np.random.default_rng(0)).numpy()
    target = Target("sphere", points, np.zeros((0, 3)), strap_point=np.array([0.0, 1.0, 1.0]))
    batch = Targets.stack([target], torch.ones(1, dtype=torch.float64)).select(torch.zeros(cup.batch, dtype=torch.long))
    settings: dict[str, Any] = {
        "rim": 0.0,
        "connection": 0.01,
        "connection_width": 0.02,
        "fairness": 1e-3,
        **conditions,
    }
    return Objective(cup, batch, Conditions(**settings))


def sphere_stages() -> LM:
    return LM(
        [
            LMStage(steps=30, terms=4, points=400, tolerance=1e-4),
            LMStage(steps=20, terms=6, points=400, tolerance=1e-4),
            LMStage(steps=60, tolerance=1e-6),
        ]
    )


def report_sphere(starts: int) -> None:
    for panels in (2, 3):
        rng = np.random.default_rng(5)
        wire = Wire.from_arc(1.0, math.pi).select(torch.zeros(starts, dtype=torch.long))
        cup = StripsCup(wire, panels, terms=8)
        share = np.arange(1, panels + 1) / panels
        angles = share * math.pi / 2 + rng.uniform(-0.25, 0.25, (starts, panels)) / panels
        cup.start(torch.as_tensor(angles), torch.as_tensor(rng.uniform(0.8, 1.2, (starts, panels))))
        objective = sphere_objective(cup)
        solution = sphere_stages().solve(objective, cup.flatten().detach(), None)
        shape = cup.shape_of(solution.flat)
        rms = 100 * objective.distances(shape, objective.feet(shape)).square().mean(1).sqrt()
        near = (rms < 1.02 * rms.min()).double().mean()
        print(
            f"case 1, {panels} panels, {starts} random starts: RMS best {rms.min():.3f} % of R, median"
            f" {rms.median():.3f}, worst {rms.max():.3f}; {near:.0%} within 2 % of the best"
        )


def known_cup(panels: int) -> tuple[StripsCup, Tensor]:
    """An asymmetric cup of the model on a wire that is not planar."""
    wire = Wire.from_omega((0.15 * math.pi / WIRE, 0.9 * math.pi / WIRE, 0.1 * math.pi / WIRE), WIRE)
    cup = StripsCup(wire, panels, terms=6, nodes=128)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start(1.5 * share[None], torch.ones(1, panels, dtype=torch.float64))
    noise = torch.randn(1, cup.size, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    order = torch.arange(6, dtype=torch.float64)
    order = torch.cat((torch.zeros(panels), order.repeat(2 * panels), torch.zeros(CORNER_SIZE)))
    flat = cup.flatten().detach() + 0.08 * noise / (1 + order**2).sqrt()
    flat[:, -CORNER_SIZE:] = 0
    return cup, flat


def gaps_between(a: CupShape, b: CupShape) -> list[str]:
    """Largest and RMS distance over the wire length, of the edges in space and of the flat patterns of two cups."""
    first, second = a.flat(), b.flat()
    edges = (a.edges - b.edges).norm(dim=-1)
    flat = torch.cat([(x - y).norm(dim=-1) for x, y in ((first.lower, second.lower), (first.upper, second.upper))])
    return [f"{v.max() / WIRE:.1e} ({v.square().mean().sqrt() / WIRE:.1e})" for v in (edges, flat)]


def report_recovery() -> None:
    """Case 2: points on a known cup, its neckline given in 2,561 points."""
    stages = [LMStage(steps=30, terms=4, points=400, tolerance=1e-3), LMStage(steps=150, tolerance=1e-13)]
    for panels in (2, 3):
        cup, flat = known_cup(panels)
        scale = cup.wire.scale
        fine = StripsCup(cup.wire, panels, 6, stations=12801, nodes=128).shape_of(flat).map(lambda v: v[0])
        unit_shape = cup.shape_of(flat).map(lambda v: v[0])
        truth = in_millimetres(unit_shape, scale.item())
        clean = on_panels(truth, POINTS, np.random.default_rng(0)).numpy()
        line = (fine.edges[-1] * scale).numpy()
        errors = []
        for noise in (0.0, 0.01, 0.1, 0.5, 1.0):
            points = clean + noise * np.random.default_rng(1).standard_normal(clean.shape)
            target = Target("known", points, np.zeros((0, 3)), neckline=line)
            conditions = Conditions(fairness=0.0, connection=0.0, barrier=1e-4, margin=0.0)
            objective = Objective(cup, Targets.stack([target], scale, 2561), conditions)
            solution = LM(stages).solve(objective, cup.flatten().detach(), None)
            found = in_millimetres(cup.shape_of(solution.flat).map(lambda v: v[0]), scale.item())
            errors.append(f"  noise {noise:g} mm: edges {{}}, patterns {{}}".format(*gaps_between(found, truth)))
        print(f"case 2, {panels} panels, largest (RMS) error over wire length:", *errors, sep="\n")


def residual_function(objective: Objective) -> Callable[[np.ndarray], np.ndarray]:
    """All residuals of one problem, times the roots of their weights."""

    @torch.no_grad()
    def residuals(flat: np.ndarray) -> np.ndarray:
        place = torch.as_tensor(flat)[None]
        shape, unfairness = objective.cup.sketch(place), objective.cup.unfairness(place)
        points = objective.points_block(objective.distances(shape, objective.feet(shape)))
        blocks = [points, *objective.blocks(place, shape, Pressure(1.0), shape.margin, unfairness)]
        parts = [(b.weight * b.loss(b.squared())[0]).clamp_min(0).sqrt().expand_as(b.squared()) for b in blocks]
        return torch.cat([p[0] for p in parts]).numpy()

    return residuals


def report_scipy(targets: list[Target]) -> None:
    """The last stage, all terms free and all points, by us in a batch and by SciPy one by one, from the same start."""
    objective = problems(targets, 2)
    place = objective.cup.flatten().detach()
    begun = time.process_time()
    ending = minimise(objective, place, Pressure(1.0), LMStage(steps=60, tolerance=1e-4), lambda *_: None)
    ours = (time.process_time() - begun) / len(targets)
    one = torch.tensor([0])
    begun = time.process_time()
    other = least_squares(residual_function(objective.select(one)), place[0].numpy(), ftol=1e-4, max_nfev=60)
    theirs = time.process_time() - begun
    print(
        f"least_squares on {targets[0].name}: {theirs:.1f} s CPU to {2 * other.cost:.3e}; ours in a batch of"
        f" {len(targets)}: {ours:.3f} s CPU per scan, {ending.value[0]:.3e}: {theirs / ours:.0f} times faster"
    )


def report_paper(seconds: float) -> None:
    """The paper's model and solver on Case 1, and the time the strips need to be as near."""
    frames = FramesCup(Wire.from_arc(1.0, math.pi), panels=2, terms=4, basis="fourier")
    frames.start(torch.tensor([[math.pi / 4, math.pi / 2]]).double(), torch.ones(1, 2).double())
    objective = sphere_objective(frames, barrier=0.0)
    begun = time.process_time()
    solution = NelderMead(seconds=seconds).solve(objective, frames.flatten().detach(), None)
    theirs = time.process_time() - begun
    shape = frames.shape_of(solution.flat)
    goal = objective.distances(shape, objective.feet(shape)).abs().mean().item()
    cup = StripsCup(Wire.from_arc(1.0, math.pi), 2, terms=4)
    cup.start(torch.tensor([[math.pi / 4, math.pi / 2]]).double(), torch.ones(1, 2).double())
    for steps in range(1, 61):
        begun = time.process_time()
        ours = LM([LMStage(steps=steps)]).solve(sphere_objective(cup), cup.flatten().detach(), None)
        spent = time.process_time() - begun
        mean = objective_mean(sphere_objective(cup), ours.flat)
        if mean <= goal:
            break
    print(
        f"Nelder-Mead: mean error {100 * goal:.2f} % of R after {theirs:.1f} s CPU; strips: {100 * mean:.2f} % in"
        f" {spent:.3f} s ({steps} steps): {theirs / spent:.0f} times faster"
    )


def objective_mean(objective: Objective, flat: Tensor) -> float:
    shape = objective.cup.shape_of(flat)
    return objective.distances(shape, objective.feet(shape)).abs().mean().item()


@dataclass
class Clock:
    """Seconds of each part of a batch of fits, by its name."""

    device: torch.device
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Count the time of what is done inside."""
        self._wait()
        begun = time.perf_counter()
        yield
        self._wait()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begun

    def _wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)


def fit_in_parts(targets: list[Target], dtype: torch.dtype, device: torch.device) -> tuple[np.ndarray, Clock]:
    """RMS (mm) of every scan, fitted as shipped with two panels, and the time of the parts."""
    solver, conditions = shipped()
    clock, cup = Clock(device), partial(StripsCup, panels=2)
    with clock.part("starts"):
        wires = Wire.stack([Wire.from_polyline(target.wire) for target in targets])
        objective = starting_problems(targets, wires, cup, conditions, 1, dtype, device)
    with clock.part("solve"):
        solution = solver.solve(objective, objective.cup.flatten().detach(), None)
    with clock.part("measurement"):
        fits = finished(winners(objective, solution, targets, wires), cup, conditions, cores())
    return np.array([fit.figures["rms_mm"] for fit in fits]), clock


def rescans(whole: list[Target], count: int, points: int) -> list[Target]:
    """So many scans: the given ones in turn, each time with other points of theirs, drawn at random."""
    random, some = np.random.default_rng(0), []
    for k in range(count):
        target = whole[k % len(whole)]
        chosen = random.choice(len(target.points), min(points, len(target.points)), replace=False)
        some.append(replace(target, name=f"{target.name}, {k // len(whole)}", points=target.points[chosen]))
    return some


def report_gpu(whole: list[Target], counts: Sequence[int], points: int) -> None:
    """Throughput of batches of growing size in both precisions, the share of each part, and RMS against the CPU's in
    double precision, on a few of the scans. Measuring is done on the processor's cores.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device.type == "cpu":
        print("no CUDA device here: a few scans on the CPU instead, which show that it runs and no more")
        counts, points = [min(count, SMALL) for count in counts[:1]], min(points, 300)
    targets = rescans(whole, max(counts), points)
    some = targets[: min(counts)]
    known, _ = fit_in_parts(some, torch.float64, torch.device("cpu"))
    for dtype in (torch.float64, torch.float32):
        if device.type == "cuda":
            fit_in_parts(some, dtype, device)  # the first call loads kernels
        for count in counts:
            if device.type == "cuda":
                torch.cuda.reset_peak_memory_stats(device)
            rms, clock = fit_in_parts(targets[:count], dtype, device)
            held = f" {torch.cuda.max_memory_allocated(device) / 2**30:.1f} GiB;" if device.type == "cuda" else ""
            total = sum(clock.seconds.values())
            shares = ", ".join(f"{name} {seconds / total:.0%}" for name, seconds in clock.seconds.items())
            off = np.abs(rms[: len(known)] - known).max()
            print(
                f"{count} scans of {points} points, {device.type}, {str(dtype).removeprefix('torch.')}:"
                f" {count / total:.1f} scans/s ({shares});{held} RMS off the CPU's in float64 by at most {off:.1g} mm",
                flush=True,
            )


def report_gpu_run(folder: str, rescans: int = 1024) -> None:
    """The command on many scans, lean, with a GPU and with the processor's cores alone."""
    if not torch.cuda.is_available():
        return
    with tempfile.TemporaryDirectory() as work:
        write_rescans(Path(folder).resolve(), Path(work), rescans)
        for name, more in (("cuda", ["device=cuda", "batch=1024"]), ("cpu", [])):
            wall, cpu = whole_run(Path(work), "experiment=lean", *more)
            print(
                f"the command, {rescans} scans, lean, device={name}, {cores()} cores: {rescans / wall:.1f} scans/s,"
                f" {cpu / rescans:.3f} CPU s a scan",
                flush=True,
            )


def whole_run(scans: Path, *settings: str) -> tuple[float, float]:
    """Wall and CPU seconds of the command on a folder, its whole process tree and everything included."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "brafit", f"scans='{scans}'", f"out='{out}/run'", *settings]
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def report_run(folder: str, rescans: int = 224) -> None:
    """What a user waits for: the command, from its call to its last file; and the solver's own share of it."""
    breasts_of, solver = Path(folder).resolve(), shipped()
    with tempfile.TemporaryDirectory() as work:
        many = Path(work)
        write_rescans(breasts_of, many, rescans)
        targets = [target_of(load_scan(path)) for path in find_scans([many])[:56]]
        begun = time.process_time()
        fit_targets(targets, partial(StripsCup, panels=2), *solver)
        own = (time.process_time() - begun) / len(targets)
        print(f"solver alone, batch of {len(targets)}, one core: {own:.3f} CPU s a scan")
        count = len(find_scans([breasts_of]))
        for scans, number in ((breasts_of, count), (many, rescans)):
            for name, settings in (("default outputs", []), ("lean", ["experiment=lean"])):
                wall, cpu = whole_run(scans, *settings)
                print(
                    f"{number} scans, {name}: {wall:.1f} s, {number / wall:.2f} scans/s, {cpu:.1f} CPU s"
                    f" ({cpu / number:.3f} a scan, {cpu / number / own:.1f} times the solver's)",
                    flush=True,
                )


PARTS: dict[str, Callable[[argparse.Namespace], None]] = {
    "run": lambda options: report_run(options.folder),
    "breasts": lambda options: report_breasts(breasts(options.folder)),
    "unmarked": lambda options: report_unmarked(breasts(options.folder)),
    "seam": lambda options: report_seam(breasts(options.folder), options.panels, options.at_once),
    "starts": lambda options: report_starts(breasts(options.folder)),
    "steps": lambda options: report_steps(breasts(options.folder)),
    "sphere": lambda options: report_sphere(100 if options.slow else 10),
    "recovery": lambda options: report_recovery(),
    "scipy": lambda options: report_scipy(breasts(options.folder)),
    "memory": lambda options: report_memory(options.folder),
    "single": lambda options: report_single(breasts(options.folder)),
    "rim": lambda options: report_rim(breasts(options.folder)),
    "speed": lambda options: report_speed(breasts(options.folder)),
    "paper": lambda options: report_paper(seconds=120) if options.slow else None,
}
"""What is measured, in this order."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", help="breast scans with their landmark files")
    parser.add_argument("--only", default=",".join(PARTS), help="parts, by commas: %(default)s")
    parser.add_argument("--slow", action="store_true", help="100 starts in case 1, and the paper's solver")
    counts = {"type": int, "nargs": "+", "default": (2, 3, 4)}
    parser.add_argument("--panels", **counts, help="of the part seam (2 3 4)")
    parser.add_argument("--at-once", type=int, default=2, help="breasts in a batch of the part seam (%(default)s)")
    parser.add_argument("--gpu", action="store_true", help="only throughput on a GPU, by batch size and precision")
    options = parser.parse_args()
    wanted = options.only.split(",")
    if unknown := set(wanted) - set(PARTS):
        parser.error(f"--only: unknown {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    torch.set_num_threads(1)
    if options.gpu:
        report_gpu(breasts(options.folder, 10**9), BATCHES, POINTS)
        report_gpu_run(options.folder)
        return
    for name, report in PARTS.items():
        if name in wanted:
            report(options)


if __name__ == "__main__":
    main()
