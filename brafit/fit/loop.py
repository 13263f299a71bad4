"""The fit of a batch of scans: starts, solver, choice of the best start, measurement."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, Wire
from brafit.fit.measure import figures_of, flat_panels, point_distances
from brafit.fit.objective import Conditions, Objective, Pressure
from brafit.fit.result import ResultCode
from brafit.fit.solver import Callback, Solver
from brafit.fit.start import start_profiles
from brafit.fit.targets import Target, Targets
from brafit.geometry.development import FlatPanel


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


def fit_targets(
    targets: Sequence[Target],
    cup: Callable[[Wire], Cup],
    solver: Solver,
    condition: Conditions,
    *,
    restarts: int = 1,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str = "cpu",
    callback: Callback | None = None,
) -> list[CupFit]:
    """Fit one batch of scans; each result is the same as if its scan were alone.

    Args:
        targets: the scans.
        cup: makes the cup model from its wires, e.g. `functools.partial(FramesCup, panels=2)`.
        solver: e.g. `Anneal`.
        condition: what is asked of the cups.
        restarts: starts per scan; the one with the lowest objective wins.
        callback: told of every step.

    Raises:
        ValueError: a target without points or with a wire that is no curve (checked input has neither).
    """
    begun = time.perf_counter()
    wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
    starts = [start_profiles(t, cup(wires.select(torch.tensor([0]))).panels, restarts) for t in targets]
    angles = torch.as_tensor(np.concatenate([a for a, _ in starts]), dtype=dtype, device=device)
    reaches = torch.as_tensor(np.concatenate([r for _, r in starts]), dtype=dtype, device=device)
    repeated = torch.arange(len(targets)).repeat_interleave(restarts)
    model = cup(wires.select(repeated).to(device=device, dtype=dtype))
    batch = Targets.stack(targets, model.wire.scale[::restarts]).select(repeated.to(device))
    model.start(angles, reaches / batch.scale[:, None])
    objective = Objective(model, batch, condition, repeated.to(device))
    solution = solver.solve(objective, model.flatten().detach(), callback)

    final = objective.value(solution.flat, Pressure(solution.pressure.penalty))
    final = torch.where(final.isfinite(), final, torch.inf).view(-1, restarts)
    best = final.argmin(1).cpu() + torch.arange(len(targets)) * restarts
    winners = model.select(best.to(device))
    flat = solution.flat[best.to(device)]
    winners.load_flat(flat)
    shapes = winners.shape_of(flat.detach())
    seconds = (time.perf_counter() - begun) / len(targets)
    results = []
    for k, target in enumerate(targets):
        row = int(best[k])
        results.append(
            _finish(
                target,
                shapes.map(lambda v: v[k].detach().cpu().double()),
                winners.wire.select(torch.tensor([k])).cpu().double(),
                solution.codes[row],
                {name: value[k].tolist() for name, value in winners.split(flat).items()},
                int(solution.iterations[row]),
                seconds,
            )
        )
    return results


def _finish(
    target: Target,
    shape: CupShape,
    wire: Wire,
    code: ResultCode,
    parameters: dict[str, list],
    iterations: int,
    seconds: float,
) -> CupFit:
    scale = wire.scale.item()
    shape = in_millimetres(shape, scale)
    flat = flat_panels(shape)
    distances = point_distances(torch.as_tensor(target.points, dtype=torch.float64), shape)
    dense = wire.sample(torch.linspace(0, LENGTH, 2001, dtype=torch.float64))[0] * scale
    neckline = None if target.neckline is None else torch.as_tensor(target.neckline, dtype=torch.float64)
    figures = figures_of(shape, flat, distances, neckline, dense, wire.smoothing.item())
    return CupFit(
        name=target.name,
        code=code,
        reason=code.value,
        shape=shape,
        panels=[FlatPanel(lower, upper) for lower, upper in zip(flat.lower, flat.upper, strict=True)],
        distances=distances.numpy(),
        figures=figures,
        parameters=parameters,
        iterations=iterations,
        seconds=seconds,
    )


def in_millimetres(shape: CupShape, scale: float) -> CupShape:
    """A shape in solver units, in millimetres. Tangents are by the wire's arc length and keep their size."""
    return CupShape(
        stations=shape.stations.cpu().double() * scale,
        edges=shape.edges * scale,
        tangents=shape.tangents,
        directions=shape.directions,
        normals=shape.normals,
        geodesic=shape.geodesic / scale,
    )
