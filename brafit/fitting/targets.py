"""What a cup is fitted to: one scan, and a batch of them in solver units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from brafit.cup.wire import Wire
from brafit.fitting.neckline import Neckline, smooth_neckline
from brafit.geometry.developable import dot
from brafit.geometry.order import along_curve

NECKLINE_SAMPLES = 81
"""Evenly spaced points by which a batch holds its necklines."""
SHEET = 2000
"""Points at most that tell where a cloud without a neckline ends."""
_WIDE = 3.0
"""A patch of points is no patch if its radius is so many times the typical one."""
SHEET_NEIGHBOURS = 12
"""Neighbours that a point's normal is taken from."""
TOP = 0.005
"""Share of a scan's points, those farthest from the wire's plane, whose middle stands for a bust point that nobody
marked."""


@dataclass(frozen=True)
class Target:
    """One scan in its cup frame, millimetres.

    Attributes:
        name: name of the scan.
        points: the cloud to fit.
        wire: points along the wire, inner end first.
        neckline: points along the wanted upper edge, inner end first, or None.
        strap_point: where the strap is to be sewn on (the connection point X_C), or None.
        apex: the bust point, or None: the fit is told of none. `bust_point` is one always.
        assumed: places on a surface that is assumed where the scan has no data: the fit sees them, no figure and no
            warning counts them.
        weights: share of the surface that each of `seen` stands for, or None: all alike.
    """

    name: str
    points: Float[np.ndarray, "n 3"]
    wire: Float[np.ndarray, "k 3"]
    neckline: Float[np.ndarray, "m 3"] | None = None
    strap_point: Float[np.ndarray, "3"] | None = None
    apex: Float[np.ndarray, "3"] | None = None
    assumed: Float[np.ndarray, "g 3"] | None = None
    weights: Float[np.ndarray, " w"] | None = None

    @property
    def bust_point(self) -> Float[np.ndarray, "3"]:
        """The apex; where nobody marked it, the middle of the points farthest from the wire's plane."""
        if self.apex is not None:
            return self.apex
        order = np.argsort(self.points[:, 2])
        return self.points[order[-max(1, round(TOP * len(order))) :]].mean(axis=0)

    @property
    def seen(self) -> Float[np.ndarray, "w 3"]:
        """What the fit sees: the points, then the places that are assumed."""
        return self.points if self.assumed is None else np.concatenate([self.points, self.assumed])

    def smooth_neckline(self, wave: float) -> Neckline | None:
        """The neckline without waves shorter than that, see `smooth_neckline`; None where none is given."""
        return None if self.neckline is None else smooth_neckline(self.neckline, self.strap_point, wave)


PADDED = 64
"""Points of a batch are padded to a multiple of this."""


@dataclass(frozen=True)
class Targets:
    """B targets in solver units. Clouds of different size are padded with points of weight 0, and each comes in the
    order of `along_curve`.

    Attributes:
        points, weights: clouds and the weight of each point; the weights of a cloud sum to 1.
        data: which of them are a scan's own: neither padding nor assumed.
        neckline, has_neckline: evenly spaced points of the wanted upper edge, and whether there is one.
        connection, has_connection: connection point.
        apex, has_apex: bust point.
        scale: millimetres per solver unit.
        sheet, sheet_normals, spacing: for clouds without a neckline, points spread over each, its normals there, and
            the typical distance between neighbours. Shorter ones repeat their first point.
    """

    points: Float[Tensor, "batch points 3"]
    weights: Float[Tensor, "batch points"]
    data: Bool[Tensor, "batch points"]
    neckline: Float[Tensor, "batch m 3"]
    has_neckline: Bool[Tensor, " batch"]
    connection: Float[Tensor, "batch 3"]
    has_connection: Bool[Tensor, " batch"]
    apex: Float[Tensor, "batch 3"]
    has_apex: Bool[Tensor, " batch"]
    scale: Float[Tensor, " batch"]
    sheet: Float[Tensor, "batch sheet 3"]
    sheet_normals: Float[Tensor, "batch sheet 3"]
    spacing: Float[Tensor, " batch"]

    def select(self, index: Tensor) -> "Targets":
        """The targets with these batch indices (repetitions allowed)."""
        return Targets(*(getattr(self, f.name)[index] for f in fields(self)))

    def to(self, like: Tensor) -> "Targets":
        """The targets with the precision and on the device of another tensor."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Targets(**{k: v.to(like) if v.is_floating_point() else v.to(like.device) for k, v in values.items()})

    def in_millimetres(self) -> "Targets":
        """The targets with all lengths in mm; `scale` is then 1."""
        unit, one = self.scale[:, None], torch.ones_like(self.scale)
        each = {name: getattr(self, name) * unit for name in ("connection", "apex")}
        clouds = {name: getattr(self, name) * unit[..., None] for name in ("points", "neckline", "sheet")}
        return replace(self, **each, **clouds, spacing=self.spacing * self.scale, scale=one)

    def height(self, wire: Wire) -> Float[Tensor, " batch"]:
        """Mean height of the clouds over their wires' planes, solver units. `wire`: of the same batch."""
        normal, middle = wire.plane()
        away = ((self.points - middle[:, None]) * normal[:, None]).sum(-1)
        return (self.weights * away).sum(-1)

    def thinned(self, count: int) -> "Targets":
        """The targets with at most `count` points each: the weighted means of as many small patches, runs of
        neighbouring points of the same number.

        Picked points would leave to chance what the early stages see, and lead clouds of one breast to different cups.
        Only where the curve leaps within a run, its middle point stands for all.
        """
        if count >= self.points.shape[1]:
            return self
        if count == 0:
            return replace(self, points=self.points[:, :0], weights=self.weights[:, :0], data=self.data[:, :0])
        counted = self.weights > 0
        own = counted.sum(1, keepdim=True).clamp_min(1)
        kept = own.clamp_max(count)
        patch = (counted.cumsum(1) - 1).clamp_min(0) * kept // own
        weights = self.weights.new_zeros(len(own), count).scatter_add_(1, patch, self.weights)

        def mean(values: Float[Tensor, "batch points k"]) -> Float[Tensor, "batch count k"]:
            total = values.new_zeros(len(own), count, values.shape[2])
            total.scatter_add_(1, patch[..., None].expand_as(values), values * self.weights[..., None])
            return total / weights[..., None].clamp_min(1e-30)

        middle = mean(self.points)
        away = self.points - middle.gather(1, patch[..., None].expand_as(self.points))
        spread = mean(dot(away, away)[..., None])
        wide = spread > _WIDE**2 * spread.where(spread > 0, torch.nan).nanmedian(1, keepdim=True).values
        rank = (2 * torch.arange(count, device=own.device) + 1) * own // (2 * kept)
        place = counted.long().argsort(dim=1, descending=True, stable=True).gather(1, rank.minimum(own - 1))
        points = torch.where(wide, self.points.gather(1, place[..., None].expand(-1, -1, 3)), middle)
        return replace(self, points=points, weights=weights, data=mean(self.data[..., None].to(weights))[..., 0] > 0.5)

    @staticmethod
    def stack(
        targets: Sequence[Target],
        scale: Float[Tensor, " batch"],
        samples: int = NECKLINE_SAMPLES,
        neckline_wave: float = 0.0,
    ) -> "Targets":
        """A batch, with `scale` millimetres to a solver unit; dtype and device follow `scale`. `neckline_wave`: see
        `smooth_neckline`.
        """

        def tensor(values: object) -> Tensor:
            return torch.as_tensor(np.asarray(values), dtype=scale.dtype, device=scale.device)

        def optional(values: list[np.ndarray | None], default: np.ndarray) -> tuple[Tensor, Tensor]:
            has = torch.tensor([v is not None for v in values], device=scale.device)
            return tensor([default if v is None else v for v in values]), has

        seen = [t.seen for t in targets]
        counts = [len(points) for points in seen]
        # Sums over padded points are the same for any batch, as long as their lengths are multiples of so many.
        points = np.zeros((len(targets), -(-max(counts) // PADDED) * PADDED, 3))
        weights, data = np.zeros(points.shape[:2]), np.zeros(points.shape[:2], dtype=bool)
        for row, (target, own) in enumerate(zip(targets, seen, strict=True)):
            order, count = along_curve(own), len(own)
            points[row, :count], weights[row, :count] = own[order], 1 / count
            data[row, :count] = order < len(target.points)
            if target.weights is not None:
                weights[row, :count] = target.weights[order] / target.weights.sum()
        lines = [None if (line := t.smooth_neckline(neckline_wave)) is None else line.sampled(samples) for t in targets]
        neckline, has_neckline = optional(lines, np.zeros((samples, 3)))
        connection, has_connection = optional([t.strap_point for t in targets], np.zeros(3))
        apex, has_apex = optional([t.apex for t in targets], np.zeros(3))
        sheet, normals, spacing = _sheets(targets)
        unit = scale[:, None]
        return Targets(
            points=tensor(points) / unit[..., None],
            weights=tensor(weights),
            data=torch.as_tensor(data, device=scale.device),
            neckline=neckline / unit[..., None],
            has_neckline=has_neckline,
            connection=connection / unit,
            has_connection=has_connection,
            apex=apex / unit,
            has_apex=has_apex,
            scale=scale,
            sheet=tensor(sheet) / unit[..., None],
            sheet_normals=tensor(normals),
            spacing=tensor(spacing) / scale,
        )


def _sheets(targets: Sequence[Target]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sheets of the clouds without a neckline with their normals and spacings; the others' are of no account."""
    rows = [sheet_rows(len(t.points)) if t.neckline is None else np.arange(1) for t in targets]
    size = max((len(r) for r in rows if len(r) > 1), default=0)
    sheets, normals, spacings = np.zeros((len(targets), size, 3)), np.zeros((len(targets), size, 3)), []
    for k, target in enumerate(targets):
        spacings.append(0.0)
        cloud = target.points[rows[k]]
        if len(cloud) <= SHEET_NEIGHBOURS or size == 0:
            continue
        away, near = sheet_neighbours(cloud)
        offset = cloud[near] - cloud[near].mean(axis=1, keepdims=True)
        flattest = np.linalg.eigh(offset.mT @ offset)[1][:, :, 0]
        whole = padded_rows(len(cloud), size)
        sheets[k], normals[k] = cloud[whole], flattest[whole]
        spacings[k] = float(np.median(away[:, 1]))
    return sheets, normals, np.array(spacings)


def sheet_rows(count: int) -> Int[np.ndarray, " rows"]:
    """Which of so many points make the sheet of a cloud."""
    return np.arange(0, count, max(1, -(-count // SHEET)))


def sheet_neighbours(cloud: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n k"], Int[np.ndarray, "n k"]]:
    """Distances and numbers of the points whose plane gives the normal of each, nearest first: itself, and the
    neighbours."""
    away, near = KDTree(cloud).query(cloud, SHEET_NEIGHBOURS + 1)
    return np.asarray(away), np.asarray(near)


def padded_rows(count: int, size: int) -> Int[np.ndarray, " size"]:
    """Numbers from 0 to count, then zeros."""
    whole = np.arange(size)
    whole[count:] = 0
    return whole
