"""A batch's course and results as TensorBoard events.

One writer per batch and three tags per term, never one tag per scan and term: TensorBoard becomes slow beyond some ten
thousand tags. Per scan there is one image of each kind and one 3D view, all at the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray
from torch import Tensor

from brafit.cup.shape import CupShape
from brafit.fit.solver import Step
from brafit.pattern.piece import Side
from brafit.report.colour import PANELS, distance_colours, distance_limit
from brafit.report.figures import figure_image
from brafit.report.mesh import cup_mesh

QUANTILES = {"median": 0.5, "p05": 0.05, "p95": 0.95}
MOMENTS = 1000
"""Steps of a fit that are recorded at most, evenly over it (and the first of every stage)."""
DOTS = 4000
"""Points of a cloud that a 3D view shows at most."""


class Recorder:
    """Writes one batch's events into a folder. A context manager; `close` may be called twice.

    Tags: `TERM/median`, `TERM/p05` and `TERM/p95` of every term over the problems still running (finite values only),
    and a chart of that band per term under Custom Scalars; `stage`; images `SCAN/KIND`; meshes `SCAN/cup`.
    """

    def __init__(self, folder: str | Path):
        from torch.utils.tensorboard import SummaryWriter  # costs two seconds

        self._writer = SummaryWriter(str(folder), max_queue=1000, flush_secs=10)
        self._charted: list[str] = []
        self._stages: list[str] = []
        self._next = 0

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def step(self, step: Step) -> None:
        """Record a step's terms; pass this method as (part of) the callback of `brafit.fit.fit_targets`."""
        entering = step.stage not in self._stages
        if step.index < self._next and not entering:
            return
        self._next = step.index + max(1, step.total // MOMENTS)
        if entering:
            self._stages.append(step.stage)
            self._writer.add_text("stage", step.stage, step.index)
        self._chart(step.terms)
        for name, values in step.terms.items():
            for quantile, value in _quantiles(values).items():
                self._writer.add_scalar(f"{name}/{quantile}", value, step.index)

    def images(self, name: str, **figures: Figure) -> None:
        """Add figures of one scan, such as `images("anny_05", patterns=..., fit=...)`."""
        for kind, figure in figures.items():
            self._writer.add_image(f"{name}/{kind}", figure_image(figure), dataformats="HWC")

    def mesh(
        self,
        name: str,
        shape: CupShape,
        points: Float[ndarray, "n 3"],
        distances: Float[ndarray, " n"],
        side: Side = "left",
    ) -> None:
        """Add a 3D view of one scan: its cup, and its cloud coloured by distance.

        TensorBoard shows either points or faces under one tag, so every point becomes a small tetrahedron.

        Args:
            shape: the cup, cup frame, mm.
            points: cup frame, mm. At most `DOTS` of them, evenly chosen, are shown.
            distances: mm, positive outside the cup.
            side: right cups, which are fitted as left ones, are shown as they are worn.
        """
        worn = np.array((1.0, -1.0 if side == "right" else 1.0, 1.0))
        cup = cup_mesh(shape, strips=6, place=lambda x: x * worn)
        limit = distance_limit(distances)
        chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), DOTS)).astype(int))
        size = 0.004 * float(np.ptp(cup.vertices, axis=0).max())
        vertices, faces = _tetrahedra(points[chosen] * worn, size)
        colours = np.repeat(distance_colours(distances[chosen], limit), 4, axis=0)
        vertices = np.vstack((cup.vertices, vertices))
        centre = (vertices.min(0) + vertices.max(0)) / 2
        self._writer.add_mesh(
            f"{name}/cup",
            vertices=torch.as_tensor((vertices - centre) @ _UPRIGHT.T, dtype=torch.float32)[None],
            colors=torch.as_tensor(np.vstack((PANELS[cup.panel % len(PANELS)], colours)), dtype=torch.uint8)[None],
            faces=torch.as_tensor(np.vstack((cup.faces, faces + len(cup.vertices))), dtype=torch.int32)[None],
            config_dict=_SCENE,
        )

    def close(self) -> None:
        """Write what is pending and close the files."""
        self._writer.close()

    def _chart(self, terms: Mapping[str, Any]) -> None:
        """One chart per term, all in one group. TensorBoard takes the last layout written."""
        new = [name for name in terms if name not in self._charted]
        if new:
            self._charted += new
            bands = {name: ["Margin", [f"{name}/{q}" for q in QUANTILES]] for name in self._charted}
            self._writer.add_custom_scalars({"fit: median, 5 % and 95 % over the batch": bands})


# The viewer looks along -z with y up: the bottom of the wire (+x of the cup frame) downwards, the chest behind.
_UPRIGHT = np.array(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
_SCENE = {"material": {"cls": "MeshStandardMaterial", "side": 2, "roughness": 1, "metalness": 0}}


def _quantiles(values: Tensor) -> dict[str, float]:
    """Of the finite values; nothing if there are none."""
    numbers = values.detach().double().cpu().flatten()
    numbers = numbers[numbers.isfinite()].numpy()
    if len(numbers) == 0:
        return {}
    return dict(zip(QUANTILES, np.quantile(numbers, list(QUANTILES.values())).tolist(), strict=True))


def _tetrahedra(centres: Float[ndarray, "n 3"], size: float) -> tuple[ndarray, ndarray]:
    """Vertices (4 n, 3) and outward faces (4 n, 3)."""
    corners = size * np.array(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
    faces = np.array(((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)))
    vertices = (centres[:, None] + corners).reshape(-1, 3)
    return vertices, (faces + 4 * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
