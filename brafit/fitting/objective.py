"""The objective, (59) of docs/formulation.md, as named blocks of residuals, batched: value = sum over blocks of
weight * sum rho(residual^2). The paper's is (43).

The objective knows cups and targets, but no solver. Constraints are blocks too: a solver sets their penalty and
multipliers.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import softplus

from brafit.cup.base import Cup, Linearised
from brafit.cup.edge_gaps import Gaps, gaps_to_line, gaps_to_points, gaps_to_sheet
from brafit.cup.shape import CupShape
from brafit.fitting.block import Block, pull, pulls
from brafit.fitting.condition import Asked, Condition, checked_conditions
from brafit.fitting.fairness import Shares, fairness_blocks
from brafit.fitting.loss import Loss, beyond, fuzzy, point_loss
from brafit.fitting.targets import Targets
from brafit.geometry.grid import station_weights
from brafit.geometry.nearest import nearest_feet, signed_distance
from brafit.geometry.panels import Feet
from brafit.geometry.products import evenly, total

Flat = Float[Tensor, "batch size"]
GUIDING = 0.4
"""Weight of the mean squared distance between edges and guides, each way."""
CLOSEST, APEX = SEAMS = ("closest", "apex")
"""Where the ridge nearest to the apex may be asked to run."""
SEAM = 10.0
"""Least weight of the squared distance of the apex from the nearest ridge, where a ridge is to run through it."""
SEAM_LIMIT = 1.0
"""Largest such distance, mm."""
RIM_SPACINGS = 2.5
"""Spacings of the cloud's points within which the upper edge is on the cloud."""
WEIGHTS = ("points", "neckline", "rim", "connection", "ridge_apex", "barrier", "fairness")
"""Those of the conditions' settings that are weights of blocks of the objective."""


@dataclass(frozen=True)
class Conditions:
    """What is asked of a cup, and how strongly. Weights multiply mean squares in units of (wire length / pi)^2.

    Attributes:
        points: loss of the point distances: l2, l1 (31), robust, or a `brafit.fitting.loss.Loss` in mm.
        points_width: rounding of l1 and scale of robust, mm.
        neckline: weight of the mean squared distance between upper edge and neckline, each way.
        neckline_limit: mean distance between upper edge and neckline, mm, above which that weight is raised for a scan
            (exact cups only); None: never.
        neckline_wave: length of the waves (mm) of the neckline that are smoothed away, see `smooth_neckline`; 0: none.
        rim: weight of the mean squared distance by which the upper edge leaves the cloud, where no neckline is given.
        connection: k1 of the fuzzy condition (42) that draws the upper edge to the strap point.
        connection_width: 1 / sqrt(k2), mm: within it the condition grows as the distance squared, up to twice that
            faster, farther out in proportion to the distance.
        seam: where the ridge nearest to the apex runs: where the cup is closest to the points (`closest`), or through
            the apex (`apex`).
        ridge_apex: weight of the squared distance of the apex from the nearest ridge; 0 leaves the ridges free. With
            `seam` apex it is at least SEAM, and raised for a scan until that distance is within SEAM_LIMIT.
        margin: the regularity margin that the barrier keeps.
        margin_width: how far above it the barrier begins.
        barrier: weight of the barrier.
        fairness: how fair and repeatable the flat edges are to be, against how close the cup is: multiplies the weights
            of `brafit.fitting.fairness`. 0: only close.
        extra: conditions of other kinds, each with a name of its own.

    Raises:
        ValueError: a loss, width or condition that cannot be used.
    """

    points: str | Loss = "l2"
    points_width: float = 0.5
    neckline: float = 0.25
    neckline_limit: float | None = 0.77
    neckline_wave: float = 45.0
    rim: float = 0.1
    connection: float = 0.04
    connection_width: float = 40.0
    seam: str = CLOSEST
    ridge_apex: float = 0.0
    margin: float = 0.3
    margin_width: float = 0.03
    barrier: float = 1.0
    fairness: float = 1.0
    extra: Sequence[Condition] = ()

    def __post_init__(self) -> None:
        point_loss(self.points, 1.0)
        object.__setattr__(self, "extra", checked_conditions(self.extra, WEIGHTS))
        for name in ("points_width", "neckline_limit", "connection_width", "margin_width"):
            if getattr(self, name) is not None and not getattr(self, name) > 0:
                raise ValueError(f"condition.{name} must be positive, got {getattr(self, name)}")
        if self.seam not in SEAMS:
            raise ValueError(f"unknown seam {self.seam!r}: allowed are {', '.join(SEAMS)}")

    @property
    def ridge_pull(self) -> float:
        """Weight of the squared distance of the apex from the nearest ridge, before it is raised."""
        return max(self.ridge_apex, SEAM) if self.seam == APEX else self.ridge_apex


def weight_names(conditions: Conditions) -> tuple[str, ...]:
    """Names of the conditions' weights: WEIGHTS, then the conditions of other kinds."""
    return (*WEIGHTS, *(condition.called for condition in conditions.extra))


@dataclass(frozen=True)
class Pressure:
    """How hard the constraints press: penalty mu and multipliers lambda of lambda c + mu/2 c^2, per constraint.

    The multipliers make the constraints hold without an endless penalty (the multiplier method). `barrier`,
    `neckline` and `seam` multiply the weights of the regularity barrier, of the neckline and of the ridge's pull to the
    apex, problem by problem (`brafit.fitting.raising`). `final`: the penalty that constraints are told of with
    (`Block.told`); None: this one.
    """

    penalty: float
    multipliers: dict[str, Tensor] = field(default_factory=dict)
    barrier: Float[Tensor, "batch 1"] | float = 1.0
    neckline: Float[Tensor, "batch 1"] | float = 1.0
    seam: Float[Tensor, "batch 1"] | float = 1.0
    final: float | None = None

    def select(self, index: Tensor) -> "Pressure":
        own = (self.barrier, self.neckline, self.seam)
        barrier, neckline, seam = (f[index] if isinstance(f, Tensor) else f for f in own)
        multipliers = {k: v[index] for k, v in self.multipliers.items()}
        return Pressure(self.penalty, multipliers, barrier, neckline, seam, self.final)


@dataclass(frozen=True)
class Evaluation:
    """Objective of B problems at one place: its value and gradient, and what is told of it (`Objective.told`)."""

    value: Float[Tensor, " batch"]
    gradient: Flat
    terms: dict[str, Float[Tensor, " batch"]]


class Objective:
    """The objective of B cups against B targets.

    Args:
        cup: the cup model; its wire and buffers are used, its parameters come as flat matrices.
        targets: what to fit.
        conditions: weights and widths.
        groups: problems with the same number are starts of the same scan; by default every problem is a scan of its
            own.
        guides: curves for all edges above the wire, evenly sampled, to draw the cups to before points are looked at.
        ridges: which ridge is drawn to the apex, from 1, problem by problem; None: the one that is nearest.
    """

    def __init__(
        self,
        cup: Cup,
        targets: Targets,
        conditions: Conditions,
        groups: Int[Tensor, " batch"] | None = None,
        guides: Float[Tensor, "batch edges m 3"] | None = None,
        ridges: Int[Tensor, " batch"] | None = None,
    ):
        self.cup, self.targets, self.conditions, self.guides = cup, targets, conditions, guides
        self.height = targets.height(cup.wire)  # of all points, whatever a stage sees
        self.ridges = ridges
        self.groups = torch.arange(cup.batch, device=targets.points.device) if groups is None else groups
        self.guiding = self.moving = False
        self.shares = Shares()
        self.final_margin_width = conditions.margin_width

    @property
    def rivals(self) -> Int[Tensor, " batch"]:
        """Problems of the same number are starts of one cup, and the best of them can be told early: of the same scan,
        with the same ridge drawn to the apex."""
        return self.groups if self.ridges is None else self.groups * self.cup.panels + self.ridges

    def _with(self, **changes: object) -> "Objective":
        """A shallow copy with some attributes changed."""
        other = copy.copy(self)
        for name, value in changes.items():
            setattr(other, name, value)
        return other

    def select(self, index: Tensor) -> "Objective":
        """The problems with these batch indices."""
        return self._with(
            cup=self.cup.select(index),
            targets=self.targets.select(index),
            height=self.height[index],
            groups=self.groups[index],
            guides=None if self.guides is None else self.guides[index],
            ridges=None if self.ridges is None else self.ridges[index],
        )

    def finer(self) -> "Objective":
        """The same problems with cups on a finer grid."""
        return self._with(cup=self.cup.finer())

    def on(self, cup: Cup, targets: Targets) -> "Objective":
        """The same problems with other cups and targets."""
        height = targets.height(cup.wire) if targets.points.shape[1] else self.height
        return self._with(cup=cup, targets=targets, height=height)

    def twice_differentiable(self) -> "Objective":
        """The same problems with edges' nearest points that move along, see `gaps_to_points`."""
        return self._with(moving=True)

    def thinned(self, count: int) -> "Objective":
        """The same problems with at most `count` points each."""
        return self._with(targets=self.targets.thinned(count))

    def eased(self, shares: Shares, margin_width: float) -> "Objective":
        """The same problems with these shares of weights, and at least this width of the margin."""
        c = self.conditions
        wide = replace(c, margin_width=max(margin_width, c.margin_width))
        return self._with(conditions=wide, shares=shares)

    def seen(self, points: int | None) -> "Objective":
        """The same problems as a stage sees them: with at most so many points each, or all (None). 0: none, their
        edges drawn to the guides instead, where there are guides.
        """
        if points is None:
            return self
        if points == 0:
            return self if self.guides is None else self._with(targets=self.targets.thinned(0), guiding=True)
        return self.thinned(points)

    def feet(self, shape: CupShape, iterations: int = 4) -> Feet:
        """Nearest points of the targets' clouds on the cups."""
        edges, tangents = shape.edges.detach(), shape.tangents.detach()
        return nearest_feet(self.targets.points, edges, tangents, shape.stations, iterations)

    def distances(self, shape: CupShape, feet: Feet) -> Float[Tensor, "batch points"]:
        return signed_distance(self.targets.points, shape.edges, shape.tangents, shape.stations, feet)

    def constraints(self, shape: CupShape) -> dict[str, Float[Tensor, "batch m"]]:
        """The cup model's own constraints, scaled so that a sum of squares is a mean over stations; maybe none."""
        return self.cup.constraints(shape)

    def unasked(self, columns: Int[Tensor, " columns"]) -> Bool[Tensor, "batch columns"]:
        """Which of these parameters nothing asks for: the place of an upper edge's corner without a strap point. Free,
        it would wander and make a kink.
        """
        asked = self.targets.has_connection & (self.conditions.connection > 0)
        return ~asked[:, None] & (columns == self.cup.corner_place)

    def points_block(self, distances: Float[Tensor, "some points"], problems: slice = slice(None)) -> Block:
        """The error between cloud and cup, (31), of all problems or some."""
        c = self.conditions
        loss = point_loss(c.points, c.points_width, self.targets.scale[problems, None])
        return Block("points", distances, self.targets.weights[problems], "points", loss)

    def blocks(
        self,
        flat: Flat,
        shape: CupShape,
        pressure: Pressure,
        margin: Float[Tensor, "batch panels n"],
        unfairness: Float[Tensor, "batch m"],
    ) -> list[Block]:
        """All residuals but the points', constraints last. `margin`: the regularity margin; `unfairness`: the cup's."""
        c = self.conditions
        blocks = self._guided_edges(shape) if self.guiding else self._wanted_edges(flat, shape, pressure)
        if c.barrier > 0:
            weight = c.barrier * pressure.barrier / margin[0].numel()
            rows = partial(_barrier_rows, bound=c.margin, width=c.margin_width)
            soft, final = (
                Block("regularity", shortfall(margin.flatten(1), c.margin, width), weight, "barrier", rows=rows)
                for width in (c.margin_width, self.final_margin_width)
            )
            blocks.append(replace(soft, final=final))
        if c.fairness > 0:
            blocks += fairness_blocks(self.cup, flat, unfairness, c.fairness, self.shares, self.height)
        for name, value in self.constraints(shape).items():
            shift = pressure.multipliers.get(name)
            residual = value if shift is None else value + shift / pressure.penalty
            rows = partial(_constraint_rows, name=name)
            final = Block(name, value, 0.5 * (pressure.final or pressure.penalty))
            blocks.append(Block(name, residual, 0.5 * pressure.penalty, rows=rows, final=final))
        return blocks

    @torch.no_grad()
    def told(
        self, blocks: Sequence[Block], points: Float[Tensor, " batch"], square: Float[Tensor, " batch"]
    ) -> dict[str, Float[Tensor, " batch"]]:
        """What `Step` tells of these problems.

        Args:
            blocks: all but the points'.
            points: value of the points.
            square: their mean squared distance.
        """
        terms = {"points": points} | {block.name: block.told().detach() for block in blocks}
        value = total([*terms.values()])
        terms = {"objective": torch.full_like(value, torch.nan) if self.guiding else value, **terms}
        return terms if self.targets.points.shape[1] == 0 else terms | {"rms_mm": self.targets.scale * square.sqrt()}

    def _all(self, flat: Flat, shape: CupShape, pressure: Pressure) -> list[Block]:
        """The points' residuals and all others."""
        points = self.points_block(self.distances(shape, self.feet(shape)))
        return [points, *self.blocks(flat, shape, pressure, shape.margin, self.cup.unfairness(flat))]

    def mean_square(
        self, distances: Float[Tensor, "some points"], problems: slice = slice(None)
    ) -> Float[Tensor, " some"]:
        """Mean of the squared distances of the scans' own points, all alike, of all problems or some."""
        used = self.targets.data[problems].to(distances)
        return (used * distances.square()).sum(1) / used.sum(1).clamp_min(1)

    def _guided_edges(self, shape: CupShape) -> list[Block]:
        """Every edge drawn to its guide both ways."""
        assert self.guides is not None
        blocks = []
        for i in range(1, shape.edges.shape[1]):
            guide = self.guides[:, i - 1]
            there, back = gaps_to_line(shape, i, guide), gaps_to_points(shape, i, guide)
            blocks += pulls(f"edge {i}", "guide", "", shape, there, back, GUIDING)
        return blocks

    def _wanted_edges(self, flat: Flat, shape: CupShape, pressure: Pressure) -> list[Block]:
        """What the landmarks ask of the edges."""
        c, targets, blocks = self.conditions, self.targets, []
        unit, has_strap = targets.scale[:, None], targets.has_connection[:, None].to(targets.points)
        # one search for the neckline's points and the strap point
        asked = torch.cat((targets.neckline, targets.connection[:, None]), dim=1)
        wanted = gaps_to_points(shape, -1, asked, self.moving)
        if c.neckline > 0:
            weight = c.neckline * pressure.neckline * targets.has_neckline[:, None].to(targets.points)
            there = gaps_to_line(shape, -1, targets.neckline)
            blocks += pulls("edge", "neckline", "neckline", shape, there, wanted.part(slice(None, -1)), weight)
        if c.rim > 0 and targets.sheet.shape[1] > 0:
            blocks.append(self._rim(shape))
        if c.connection > 0:
            loss = partial(fuzzy, strength=c.connection, sharpness=(unit / c.connection_width) ** 2)
            corner = self.cup.corner_gap(flat, shape, targets.connection)
            blocks.append(pull("connection", "connection", corner or wanted.part(slice(-1, None)), has_strap, loss))
        if c.ridge_pull > 0 and self.cup.panels > 1:
            weight = c.ridge_pull * pressure.seam * targets.has_apex[:, None].to(targets.points)
            final = pull("ridge at apex", "ridge_apex", self.ridge_gap(shape), weight)
            share = self.shares.seam if c.seam == APEX else 1.0
            blocks.append(replace(final, weight=share * weight, final=final))
        if c.extra:
            asked = Asked.of(self.cup, flat, targets)
            blocks += [asked.block(condition, shape) for condition in c.extra]
        return blocks

    def _rim(self, shape: CupShape) -> Block:
        """The upper edge held on the cloud, as far as that is known: points pull a cup towards themselves, nothing
        pulls back a cup that is too large.
        """
        targets = self.targets
        gaps = gaps_to_sheet(shape, -1, targets.sheet, targets.sheet_normals)
        weight = self.conditions.rim * (targets.spacing > 0)[:, None] * station_weights(shape.stations)
        return pull("edge to cloud", "rim", gaps, weight, partial(beyond, free=RIM_SPACINGS * targets.spacing[:, None]))

    def ridge_gap(self, shape: CupShape) -> Gaps:
        """From the apex to the ridge that is drawn to it."""
        apex = self.targets.apex[:, None]
        gaps = [gaps_to_points(shape, ridge, apex, self.moving) for ridge in range(1, self.cup.panels)]
        if self.ridges is None:
            drawn = torch.stack([g.vectors.detach().square().sum((-2, -1)) for g in gaps]).argmin(0)
        else:
            drawn = self.ridges - 1
        rows = torch.arange(len(drawn), device=drawn.device)
        parts = (f.name for f in fields(Gaps) if f.name != "own")
        return Gaps(*(torch.stack([getattr(g, name) for g in gaps])[drawn, rows] for name in parts))

    @torch.no_grad()
    def value(self, flat: Flat, pressure: Pressure) -> Float[Tensor, " batch"]:
        """The value alone, for solvers that want no gradient."""
        shape = self.cup.sketch(flat)
        return total([block.value() for block in self._all(flat, shape, pressure)])

    @torch.no_grad()
    def terms(self, flat: Flat, pressure: Pressure) -> dict[str, Float[Tensor, " batch"]]:
        """What `Step` tells of the problems at a place."""
        points, *others = self._all(flat, self.cup.sketch(flat), pressure)
        return self.told(others, points.value(), self.mean_square(points.residual))

    def evaluate(self, flat: Flat, pressure: Pressure) -> Evaluation:
        """Value, gradient and what is told."""
        with torch.enable_grad():
            flat = flat.detach().requires_grad_()
            shape = self.cup.sketch(flat)
            points, *others = self._all(flat, shape, pressure)
            values = [points.value(), *(block.value() for block in others)]
            value = total(values)
            (gradient,) = torch.autograd.grad(value.sum(), flat)
        terms = self.told(others, values[0].detach(), self.mean_square(points.residual.detach()))
        return Evaluation(value.detach(), gradient, terms)


def shortfall(margin: Tensor, bound: float, width: float) -> Tensor:
    """Residuals of the barrier: about bound - margin where the regularity margin is below its bound, fading to 0 over
    `width` above it.

    Args:
        margin: regularity margins, see `CupShape.margin`.
        bound: where the barrier is to hold them.
        width: over which the barrier fades.
    """
    return width * evenly(softplus, (bound - margin) / width)


def _barrier_rows(linear: Linearised, bound: float, width: float) -> Float[Tensor, "batch m columns"]:
    fading = evenly(torch.sigmoid, (bound - linear.margin) / width)
    return (-fading[..., None] * linear.margin_columns).flatten(1, 2)


def _constraint_rows(linear: Linearised, name: str) -> Float[Tensor, "batch m columns"]:
    return linear.constraints[name]
