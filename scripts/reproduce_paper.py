"""The paper's experiment: Case (1), a quarter sphere, and Case (2), a known cup of the model, with the paper's solver
beside ours.

    python scripts/reproduce_paper.py [--out runs/paper] [--patience 400]

Prints a table and draws the counterparts of the paper's figures 9 to 12 into the output folder. The length unit is
the paper's: the wire has the constant omega (0, 2.91, 0), so R = 1/2.91; the wire is taken as the half circle, under
which the connection point (0, 0.34, 0.34) is the pole of the sphere.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from paper_figures import cup_figure, flat_figure
from torch import Tensor

from brafit.cup import CupShape, FramesCup, Wire
from brafit.fitting import Anneal, Conditions, NelderMead, Solver, Target
from brafit.fitting.lm import LM
from brafit.fitting.measure import in_millimetres
from brafit.fitting.objective import Objective
from brafit.fitting.targets import Targets
from brafit.geometry.developable import twist_determinant
from brafit.geometry.development import FlatPanel
from brafit.pattern import pieces_from_panels
from brafit.report.figures import save_figure
from brafit.simulation.synthetic import PAPER_RADIUS, on_panels, quarter_sphere

R = PAPER_RADIUS
POLE = torch.tensor([0.0, R, R], dtype=torch.float64)
TERMS = 6


ADAM = {"optimiser": "adam", "steps": 20, "penalty": 1.0, "rate": 0.02}


def quick(steps: int) -> Anneal:
    """Adam for the rough shape, then six short runs of L-BFGS while the penalty rises."""
    stages = [{"optimiser": "lbfgs", "steps": steps, "penalty": 10.0**k} for k in range(6)]
    return Anneal([ADAM, *stages], tolerance=1e-7)


def thorough(stages: int = 15) -> Anneal:
    """Adam, then many runs of L-BFGS while the penalty rises and the damping falls, down to weakly determined
    directions.
    """
    shares = [k / (stages - 1) for k in range(stages)]
    lbfgs = [
        {"optimiser": "lbfgs", "steps": 20, "penalty": 10 ** (4 * x - 1), "damping": 10 ** (-2 * x - 5)} for x in shares
    ]
    return Anneal([ADAM, *lbfgs], tolerance=1e-12)


@dataclass(frozen=True)
class Outcome:
    """What one solver reached on one case; lengths in units of R, seconds of CPU time."""

    name: str
    mean: float
    rms: float
    ends: float
    residual: float
    evaluations: int
    seconds: float
    shape: CupShape
    flat: FlatPanel


def make_objective(points: Tensor, connection: Tensor, upper: Tensor | None = None, fairness: float = 0.0) -> Objective:
    """The paper's problem: its wire, one cloud, the connection point held within a few thousandths of R; squared
    distances.

    Points only pull a surface towards themselves, so that the upper line is known to 1e-3 R only where it is given:
    `upper`.
    """
    wire = Wire.from_omega((0.0, 1 / R, 0.0), math.pi * R)
    neckline = None if upper is None else upper.numpy()
    target = Target("paper", points.numpy(), np.zeros((0, 3)), neckline=neckline, strap_point=connection.numpy())
    cup = FramesCup(wire, panels=2, terms=TERMS, basis="fourier")
    cup.start(torch.tensor([[math.pi / 4, math.pi / 2]]).double(), torch.ones(1, 2).double())
    conditions = Conditions(
        connection=0.01,
        connection_width=0.02 * R,
        neckline=0.03,
        rim=0.0,
        barrier=0.0,
        fairness=fairness,
    )
    return Objective(cup, Targets.stack([target], wire.scale), conditions)


def solve(name: str, objective: Objective, solver: Solver, points: Tensor) -> Outcome:
    begun = time.process_time()
    solution = solver.solve(objective, objective.cup.flatten().detach(), None)
    seconds = time.process_time() - begun
    unit_shape = objective.cup.shape_of(solution.flat.detach()).map(lambda v: v[0].detach())
    shape = in_millimetres(unit_shape, R)
    inner = slice(1, -1)
    residual = twist_determinant(shape.tangents[:-1, inner], shape.tangents[1:, inner], shape.directions[:, inner])
    distances = shape.distances(points).abs() / R
    return Outcome(
        name=name,
        mean=distances.mean().item(),
        rms=distances.square().mean().sqrt().item(),
        ends=(shape.edges[1:, -1] - shape.edges[0, -1]).norm(dim=-1).max().item() / R,
        residual=residual.square().mean().sqrt().item(),
        evaluations=int(solution.iterations[0]),
        seconds=seconds,
        shape=shape,
        flat=shape.flat(),
    )


def known_cup() -> CupShape:
    """A smooth cup of the model that is no lune, developable to 1e-5: fitted to a skewed, unequally stretched
    sphere.
    """
    x, y, z = quarter_sphere(1000, R, np.random.default_rng(7)).unbind(-1)
    skewed = torch.stack((0.92 * x, y + 0.15 * z * (y / R), 1.12 * z), dim=-1)
    objective = make_objective(skewed, torch.tensor([0.0, 1.15 * R, 1.12 * R]), fairness=300.0)
    return solve("truth", objective, thorough(), skewed).shape


def curve_gap(a: Tensor, b: Tensor) -> float:
    """Largest distance from samples of one curve to the other, both ways, curves being refined between samples."""

    def refine(curve: Tensor) -> Tensor:
        upsampled = torch.nn.functional.interpolate(
            curve.mT[None], size=20 * (len(curve) - 1) + 1, mode="linear", align_corners=True
        )
        return upsampled[0].mT

    return max(
        torch.cdist(a, refine(b)).min(1).values.max().item(), torch.cdist(b, refine(a)).min(1).values.max().item()
    )


def print_table(outcomes: list[Outcome]) -> None:
    print(f"{'':34}{'mean % R':>10}{'RMS % R':>10}{'ends / R':>10}{'det RMS':>10}{'evals':>8}{'CPU s':>9}")
    for o in outcomes:
        print(
            f"{o.name:34}{100 * o.mean:10.4f}{100 * o.rms:10.4f}{o.ends:10.1e}{o.residual:10.1e}"
            f"{o.evaluations:8d}{o.seconds:9.1f}"
        )


def draw(outcome: Outcome, points: Tensor, case: int, out: Path) -> None:
    """Counterparts of figures 9 and 10 (case 1), 11 and 12 (case 2)."""
    first = 7 + 2 * case
    panels = [FlatPanel(a, b) for a, b in zip(outcome.flat.lower, outcome.flat.upper, strict=True)]
    shown = cup_figure(outcome.shape, points.numpy(), f"Case ({case}): shape and data points")
    save_figure(shown, out / f"figure_{first}.png")
    save_figure(flat_figure(pieces_from_panels(panels), f"Case ({case}): patterns"), out / f"figure_{first + 1}.png")


def case_1(out: Path, patience: float) -> None:
    points = quarter_sphere(1000, R, np.random.default_rng(0))

    def run(name: str, solver: Solver) -> Outcome:
        return solve(name, make_objective(points, POLE, fairness=0.3), solver, points)

    run("warm-up", quick(2))
    ours = run("ours: Adam, L-BFGS", quick(25))
    short = run("ours, hurried", quick(8))
    theirs = [run("paper's solver, equal time", NelderMead(seconds=ours.seconds))]
    if patience > 0:
        theirs.append(run(f"paper's solver, {patience:g} s at most", NelderMead(seconds=patience)))
    print("\nCase (1): 1000 points on the quarter sphere, 2 panels, 6 Ritz terms")
    print_table([ours, short, *theirs])
    for other in theirs:
        for mine in (ours, short):
            times, errors = other.seconds / mine.seconds, other.mean / mine.mean
            print(
                f"{other.name} took {times:.1f} times the time of `{mine.name}`, to {errors:.2f} times its mean error"
            )
    draw(ours, points, 1, out)


def case_2(out: Path) -> None:
    truth = known_cup()
    points = on_panels(truth, 1000, np.random.default_rng(1))
    upper = truth.edges[-1]
    top = upper[len(upper) // 2]
    solvers: dict[str, Solver] = {
        "ours: Adam, L-BFGS": thorough(),
        "ours: Levenberg-Marquardt": LM([{"steps": 100, "penalty": 1.0, "tolerance": 1e-13}]),
    }
    outcomes = [solve(name, make_objective(points, top, upper), s, points) for name, s in solvers.items()]
    print("\nCase (2): 1000 points on a known cup of the model, its upper line given")
    print_table(outcomes)
    flat = truth.flat()
    for o in outcomes:
        space = max(map(curve_gap, o.shape.edges, truth.edges))
        pairs = ((o.flat.lower, flat.lower), (o.flat.upper, flat.upper))
        plane = max(curve_gap(a, b) for mine, true in pairs for a, b in zip(mine, true, strict=True))
        print(f"{o.name}: edges off the true ones by {space / R:.1e} R in space, {plane / R:.1e} R in the patterns")
    draw(outcomes[0], points, 2, out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/paper"), help="folder of the figures")
    parser.add_argument(
        "--patience", type=float, default=400.0, help="CPU seconds for the paper's solver to stop by itself"
    )
    parser.add_argument("--threads", type=int, default=1, help="CPU threads")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    case_1(arguments.out, arguments.patience)
    case_2(arguments.out)
    print(f"\nfigures 9 to 12: {arguments.out}")


if __name__ == "__main__":
    main()
