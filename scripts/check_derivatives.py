"""How far derivatives through the fit agree with fits of changed data: the tables of docs/derivatives.md.

    python scripts/check_derivatives.py [SCAN] [key=value ...]

Data and weights are changed at random, and the optimum is found anew by Newton's method. The fits of the changed data
share nothing with the derivatives but the objective: their data come as arrays, by the road of every fit.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import brafit
from brafit.fitting import DifferentiableFit, FittedCups, Target, TensorTarget
from brafit.fitting.objective import WEIGHTS
from brafit.samples import sample_paths

PLACES = ("points", "wire", "neckline", "strap_point", "apex")
STEPS = (1e-4, 0.1, 0.5)
"""Changes of data in mm (root mean square), and of weights in parts of 1 times WEIGHT."""
WEIGHT = 1.0
MEASURES = ("lengths", "pieces", "parameters")


def measured(cups: FittedCups) -> list[Tensor]:
    """Lengths of the ridges and the upper edge, places on the edges of the pieces (mm), and parameters."""
    flat = torch.cat((cups.flat.lower, cups.flat.upper), dim=1)[0, :, 10::20]
    return [cups.lengths()[0, 1:], flat.flatten(), cups.parameters[0]]


@dataclass(frozen=True)
class Change:
    """Data or weights, what they depend on, a direction, and the fit with so much of it."""

    name: str
    leaf: Tensor
    direction: Tensor
    fitted: Callable[[float], FittedCups]


def rates(cups: FittedCups, every: list[Change]) -> list[list[Tensor]]:
    """Derivatives of the measures along each change: one pass back for each number that is measured."""
    leaves, found = [change.leaf for change in every], []
    for values in measured(cups):
        rows = [torch.autograd.grad(v, leaves, retain_graph=True, materialize_grads=True) for v in values]
        parts = [[(g * change.direction).sum() for g, change in zip(row, every, strict=True)] for row in rows]
        found.append([torch.stack(one) for one in zip(*parts, strict=True)])
    return [list(one) for one in zip(*found, strict=True)]


def changes(
    layer: DifferentiableFit, target: Target, near: FittedCups, scan: TensorTarget, shares: dict
) -> list[Change]:
    """Of everything that the scan has and the conditions weigh. Places move smoothly."""
    random, found = np.random.default_rng(0), []
    for name in PLACES:
        own = getattr(target, name)
        if own is None or (name == "apex" and layer.condition.ridge_apex == 0):
            continue
        direction = _unit(_strain(own, random) if name == "points" else _wave(own, random))

        def moved(step: float, name: str = name, own: np.ndarray = own, by: np.ndarray = direction) -> FittedCups:
            return layer([TensorTarget.of(replace(target, **{name: own + step * by}))], near=near)

        found.append(Change(name, getattr(scan, name), torch.from_numpy(direction), moved))
    for name in WEIGHTS:
        value = getattr(layer.condition, name)
        if name == "points" or not value > 0 or (name == "rim" and target.neckline is not None):
            continue

        def weighed(step: float, name: str = name, value: float = value) -> FittedCups:
            condition = replace(layer.condition, **{name: value * (1 + WEIGHT * step)})
            return replace(layer, condition=condition)([TensorTarget.of(target)], near=near)

        found.append(Change(f"weight of {name}", shares[name], torch.tensor(WEIGHT).double(), weighed))
    return found


def _wave(line: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A smooth change of a line at random, or of one point."""
    place = np.linspace(0, np.pi, len(line))[:, None] if line.ndim == 2 else np.zeros(1)
    return np.sum([random.normal(size=3) * np.cos(k * place) for k in range(4)], axis=0)


def _strain(points: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A linear change of a cloud at random, about its middle."""
    return (points - points.mean(axis=0)) @ random.normal(size=(3, 3))


def _unit(direction: np.ndarray) -> np.ndarray:
    return direction / np.sqrt((direction**2).sum(-1).mean())


def off(found: Tensor, known: Tensor) -> str:
    return f"{float((found - known).norm() / known.norm()):9.1e}"


def main(path: Path, settings: list[str]) -> None:
    layer, (target,) = brafit.layer([path], settings=settings)
    given = {k: torch.from_numpy(v.copy()).requires_grad_() for k in PLACES if (v := getattr(target, k)) is not None}
    shares = {name: torch.ones((), dtype=torch.float64, requires_grad=True) for name in WEIGHTS}
    scan = TensorTarget.of(target, **given)
    cups = layer([scan], shares=shares)
    newton = replace(layer, matrix="gauss-newton")([scan], shares=shares, near=cups)
    print(f"{target.name}: optimum {cups.moved[0]:.4f} mm from where the solver stopped, settled: {bool(cups.settled)}")
    print(f"relative errors; steps of {', '.join(f'{s:g}' for s in STEPS)} mm (weights: of {WEIGHT:.0%} times that)")
    print(f"{'by':20s} {'of':10s} {'Gauss-Newton':>12s} {'full Hessian':>12s}  at larger steps")
    every = changes(layer, target, cups, scan, shares)
    for change, full, gauss in zip(every, rates(cups, every), rates(newton, every), strict=True):
        ends = [[measured(change.fitted(sign * step)) for sign in (1, -1)] for step in STEPS]
        for k, name in enumerate(MEASURES):
            known = [(up[k] - down[k]).detach() / (2 * step) for (up, down), step in zip(ends, STEPS, strict=True)]
            larger = " ".join(off(full[k], one) for one in known[1:])
            near, exact = off(gauss[k], known[0]), off(full[k], known[0])
            print(f"{change.name:20s} {name:10s} {near:>12s} {exact:>12s} {larger}", flush=True)


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if "=" not in word]
    main(Path(words[0]) if words else sample_paths()[1], [word for word in sys.argv[1:] if "=" in word])
