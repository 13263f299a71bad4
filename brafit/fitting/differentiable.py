"""The fit as a layer: cups whose parameters, edges and flat patterns have derivatives by points, wire, neckline and the
conditions' weights, as `torch.autograd` sees them. See `brafit.fitting.implicit`.

What is made of the data before a fit is differentiated through: the smoothing of wire and neckline, and the scale, a
wire's length over pi. Held are: which points are neighbours, the cup frame that the data are in, the points' weights,
and the places that are assumed where a scan has no data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import get_args

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from brafit.cup.base import Cup
from brafit.cup.shape import CupShape
from brafit.cup.wire import LENGTH, SMOOTHING, Wire
from brafit.fitting.implicit import Data, Kind, Optimum, Problem, at_optimum, polished
from brafit.fitting.loop import TRIALS, starting_problems, winners
from brafit.fitting.neckline import DENSE, LEAST, intervals, side_rows
from brafit.fitting.objective import Conditions, Objective, Pressure, weight_names
from brafit.fitting.solver import Solver
from brafit.fitting.targets import SHEET_NEIGHBOURS, Target, Targets, padded_rows, sheet_neighbours, sheet_rows
from brafit.geometry.development import FlatPanel, arc_lengths
from brafit.geometry.grid import chebyshev_analysis
from brafit.geometry.order import along_curve
from brafit.geometry.traced import by_arc_length, chords_of, dense, spaced, traced_series


@dataclass(frozen=True)
class TensorTarget:
    """A `Target` whose places are tensors that may carry derivatives; mm, in its cup frame, float64 on the CPU.

    Attributes:
        target: what holds in all other respects; its own places are not looked at.
        points, wire, neckline, strap_point, apex: as in `Target`.
    """

    target: Target
    points: Float[Tensor, "n 3"]
    wire: Float[Tensor, "k 3"]
    neckline: Float[Tensor, "m 3"] | None = None
    strap_point: Float[Tensor, "3"] | None = None
    apex: Float[Tensor, "3"] | None = None

    @staticmethod
    def of(target: Target, **given: Tensor) -> "TensorTarget":
        """Of a target, with some of its places given as tensors.

        Raises:
            TypeError: a name that is no place of a target.
            ValueError: a tensor that is not float64, or another number of points than the target's.
        """
        own = {f.name: getattr(target, f.name) for f in fields(TensorTarget)[1:]}
        for name, value in given.items():
            if name not in own:
                raise TypeError(f"{name!r} is no place of a scan: there are {', '.join(own)}")
            if value.dtype != torch.float64:
                raise ValueError(f"{name} is {value.dtype}; derivatives of a fit need torch.float64")
            if name == "points" and value.shape != target.points.shape:
                raise ValueError(f"points have the shape {tuple(value.shape)}, the target's {target.points.shape}")
        plain = {k: torch.as_tensor(v, dtype=torch.float64) for k, v in own.items() if v is not None}
        return TensorTarget(target, **(plain | given))

    def held(self) -> Target:
        """As arrays, without derivatives."""
        own = {f.name: getattr(self, f.name) for f in fields(self)[1:]}
        return replace(self.target, **{k: None if v is None else v.detach().cpu().numpy() for k, v in own.items()})


@dataclass(frozen=True)
class FittedCups:
    """B cups at their optimum. All tensors are functions of the data they were fitted to.

    Attributes:
        parameters: solver units, columns as `Cup.flatten` has them.
        shape: edges in mm; its tangents are by the wire's arc length.
        flat: the panels laid flat, mm: `lower` and `upper` are (B, panels, stations, 2).
        optimum: how near the optimum they are; what `settled` is not true of has no derivatives to rely on.
        moved: how far the edges moved (mm, largest) from where the solver stopped to the optimum.
        pressure: weights that the solver raised, which are held.
    """

    parameters: Float[Tensor, "batch size"]
    shape: CupShape
    flat: FlatPanel
    optimum: Optimum
    moved: Float[Tensor, " batch"]
    pressure: Pressure

    @property
    def edges(self) -> Float[Tensor, "batch edges n 3"]:
        """Positions of the edges, mm, from the wire up."""
        return self.shape.edges

    @property
    def settled(self) -> Bool[Tensor, " batch"]:
        return self.optimum.settled

    def lengths(self) -> Float[Tensor, "batch edges"]:
        """Lengths of the edges in the patterns, mm, from the wire up: each panel's lower edge, then the upper edge."""
        lower = arc_lengths(self.flat.lower, self.shape.stations)[..., -1]
        upper = arc_lengths(self.flat.upper, self.shape.stations)[..., -1]
        return torch.cat((lower, upper[:, -1:]), dim=1)

    def extents(self) -> Float[Tensor, "batch panels 2"]:
        """Length along the lower edge's chord and width across it of every flat panel, mm."""
        both = torch.cat((self.flat.lower, self.flat.upper), dim=-2)
        return both.amax(-2) - both.amin(-2)


@dataclass(frozen=True)
class DifferentiableFit:
    """Fits as a differentiable function of scans.

    Attributes:
        cup, solver, condition, restarts: as `fit_targets` takes them.
        matrix: `full`, the Hessian, or `gauss-newton`, which the solvers use, for the derivatives. The optimum is found
            with the Hessian either way.

    Raises:
        ValueError: another matrix.
    """

    cup: Callable[[Wire], Cup]
    solver: Solver
    condition: Conditions
    restarts: int = 1
    matrix: Kind = "full"

    def __post_init__(self) -> None:
        if self.matrix not in get_args(Kind):
            raise ValueError(f"unknown matrix {self.matrix!r}: allowed are {', '.join(get_args(Kind))}")

    def __call__(
        self,
        scans: Sequence[TensorTarget | Target],
        *,
        shares: Mapping[str, Tensor] | None = None,
        near: FittedCups | None = None,
    ) -> FittedCups:
        """The cups of a batch.

        Args:
            scans: what to fit; a `Target` is taken without derivatives by its places.
            shares: what multiplies the conditions' weights, by their names, see `weight_names`: tensors of shape (B,)
                or (); with 1 a weight is as it is in `condition`.
            near: cups that differ little, such as those of a step before: the optimum is sought from there, with the
                weights raised as they were, and no solver runs.

        Raises:
            ValueError: a cup with constraints, whose optimum this is not; an unknown weight.
        """
        scans = [TensorTarget.of(scan) if isinstance(scan, Target) else scan for scan in scans]
        targets = [scan.held() for scan in scans]
        wires = Wire.stack([Wire.from_polyline(t.wire) for t in targets])
        objective, pressure = self._fitted(targets, wires, near)
        stopped = objective.cup.flatten().detach()
        problem = Problem.of(objective, pressure, _data(objective, scans, targets, self.condition, shares or {}))
        optimum = polished(problem.held(), stopped)
        parameters = at_optimum(problem, optimum, self.matrix)
        cup, scale = problem.objective.cup, problem.data.scale
        units = cup.shape_of(parameters)
        shape = _millimetres(units, scale)
        with torch.no_grad():
            before = objective.cup.shape_of(stopped).edges * scale[:, None, None, None]
            moved = (shape.edges - before).norm(dim=-1).amax((-2, -1))
        laid = units.flat()
        flat = FlatPanel(*(v * scale[:, None, None, None] for v in (laid.lower, laid.upper)))
        return FittedCups(parameters, shape, flat, optimum, moved, pressure)

    def _fitted(self, targets: Sequence[Target], wires: Wire, near: FittedCups | None) -> tuple[Objective, Pressure]:
        """The objective with cups where the solver stopped, and the weights that it ended with."""
        restarts, trials = (self.restarts, TRIALS) if near is None else (1, 1)
        objective = starting_problems(targets, wires, self.cup, self.condition, restarts, trials=trials)
        if objective.cup.constrained:
            raise ValueError(f"{type(objective.cup).__name__} has constraints; derivatives need a cup without any")
        if near is not None:
            objective.cup.load_flat(near.parameters.detach())
            return objective, near.pressure
        solution = self.solver.solve(objective, objective.cup.flatten().detach(), None)
        won = winners(objective, solution, targets, wires)
        return Objective(won.cup, won.targets, self.condition), won.pressure


def _millimetres(shape: CupShape, scale: Float[Tensor, " batch"]) -> CupShape:
    """A batch of shapes in solver units with edges and curvatures in millimetres. Stations stay in solver units: wires
    of a batch differ in length.
    """
    unit = scale[:, None, None]
    return replace(shape, edges=shape.edges * unit[..., None], geodesic=shape.geodesic / unit)


def _data(
    objective: Objective,
    scans: Sequence[TensorTarget],
    held: Sequence[Target],
    condition: Conditions,
    shares: Mapping[str, Tensor],
) -> Data:
    """The data in solver units, as functions of the scans' tensors. `held`: the scans without derivatives."""
    terms, targets = objective.cup.wire.coefficients.shape[1], objective.targets
    wires = [traced_wire(scan.wire, terms) for scan in scans]
    scale = torch.stack([length for _, length in wires]) / LENGTH
    samples = targets.neckline.shape[1]
    lines = [_neckline(*both, condition.neckline_wave, samples) for both in zip(scans, held, strict=True)]
    unit = scale[:, None]

    def marks(name: str) -> Float[Tensor, "batch 3"]:
        own = [getattr(scan, name) for scan in scans]
        return torch.stack([scale.new_zeros(3) if v is None else v for v in own]) / unit

    names = weight_names(condition)
    if unknown := sorted(set(shares) - set(names)):
        raise ValueError(f"unknown weight {unknown[0]!r}: allowed are {', '.join(names)}")
    ones = torch.ones_like(scale)
    sheets = [_sheet(*both, targets.sheet.shape[1]) for both in zip(scans, held, strict=True)]
    sheet, normals, spacing = (torch.stack(parts) for parts in zip(*sheets, strict=True))
    return Data(
        points=_points(scans, held, targets) / unit[..., None],
        weights=targets.weights,
        neckline=torch.stack(lines) / unit[..., None],
        connection=marks("strap_point"),
        apex=marks("apex"),
        scale=scale,
        sheet=sheet / unit[..., None],
        sheet_normals=normals,
        spacing=spacing / scale,
        wire=torch.stack([coefficients for coefficients, _ in wires]),
        shares=torch.stack([ones * shares.get(name, 1.0) for name in names], dim=1),
    )


def _points(scans: Sequence[TensorTarget], held: Sequence[Target], targets: Targets) -> Float[Tensor, "batch points 3"]:
    """The clouds as `Targets.stack` orders and pads them, mm."""
    rows = []
    for scan, target in zip(scans, held, strict=True):
        assumed = target.seen[len(target.points) :]
        every = torch.cat((scan.points, torch.as_tensor(assumed, dtype=torch.float64)))
        own = every[torch.from_numpy(along_curve(target.seen))]
        rows.append(torch.nn.functional.pad(own, (0, 0, 0, targets.points.shape[1] - len(own))))
    return torch.stack(rows)


def _sheet(
    scan: TensorTarget, held: Target, size: int
) -> tuple[Float[Tensor, "size 3"], Float[Tensor, "size 3"], Float[Tensor, ""]]:
    """Sheet, normals and spacing of a cloud without a neckline as `Targets.stack` makes them, mm; zeros elsewhere."""
    rows = sheet_rows(len(scan.points))
    cloud = scan.points[torch.from_numpy(rows)]
    if scan.neckline is not None or len(cloud) <= SHEET_NEIGHBOURS:
        none = cloud.new_zeros(size, 3)
        return none, none, cloud.new_zeros(())
    near = torch.from_numpy(sheet_neighbours(held.points[rows])[1])
    offset = cloud[near] - cloud[near].mean(dim=1, keepdim=True)
    flattest = torch.linalg.eigh(offset.mT @ offset)[1][:, :, 0]
    whole = torch.from_numpy(padded_rows(len(cloud), size))
    apart = (cloud[near[:, 1]] - cloud).norm(dim=-1)
    return cloud[whole], flattest[whole], torch.quantile(apart, 0.5)


def traced_wire(
    points: Float[Tensor, "k 3"], terms: int, smoothing: float = SMOOTHING
) -> tuple[Float[Tensor, "terms 3"], Float[Tensor, ""]]:
    """Coefficients and length of `Wire.from_polyline`, differentiable in the points."""
    points = points[_distinct(points)]
    positions, length = by_arc_length(traced_series(points, smoothing), terms)
    analysis = torch.from_numpy(chebyshev_analysis(terms))
    return analysis @ positions * (LENGTH / length), length


def _neckline(scan: TensorTarget, held: Target, wave: float, samples: int) -> Float[Tensor, "m 3"]:
    """`smooth_neckline` and its samples, differentiable in the line and the strap point; zeros where none is given."""
    if scan.neckline is None or held.neckline is None:
        return torch.zeros(samples, 3, dtype=torch.float64)
    distinct = _distinct(scan.neckline)
    line = scan.neckline[distinct]
    rows = [torch.from_numpy(r) for r in side_rows(held.neckline[distinct.numpy()], held.strap_point)]
    given = line if scan.strap_point is None else torch.cat((line, scan.strap_point[None]))
    sides = [given[r] if wave == 0 or len(r) < LEAST else traced_side(given[r], wave) for r in rows]
    if len(sides) == 1:
        return spaced(sides[0], samples)
    own = intervals([side.detach().numpy() for side in sides], samples)
    return torch.cat((spaced(sides[0], own + 1), spaced(sides[1], samples - own)[1:]))


def traced_side(line: Float[Tensor, "k 3"], wave: float) -> Float[Tensor, "m 3"]:
    """One side of a neckline without waves shorter than `wave`, mm."""
    return dense(traced_series(line, (wave / (2 * chords_of(line).sum())) ** 6), DENSE)


def _distinct(line: Float[Tensor, "k 3"]) -> Bool[Tensor, " k"]:
    """Which points of a polyline differ from the one before."""
    moved = chords_of(line.detach()) > 0
    return torch.cat((torch.ones_like(moved[:1]), moved))
