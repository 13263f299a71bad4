"""A batch's course and results as TensorBoard events.

One writer per batch and three tags per term, never one tag per scan and term: TensorBoard becomes slow beyond some ten
thousand tags. Per scan there is one image of each kind and one 3D view, all at the end.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from numpy import ndarray
from torch import Tensor

from brafit.fit.solver import Step

QUANTILES = {"median": 0.5, "p05": 0.05, "p95": 0.95}
MOMENTS = 1000
"""Steps of a fit that are recorded at most, evenly over it (and the first of every stage)."""


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

    def images(self, name: str, pictures: Mapping[str, bytes]) -> None:
        """Add pictures of one scan, PNG files by their kind, as `brafit.result.Result.pictures` gives them."""
        from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[attr-defined]

        values = []
        for kind, png in pictures.items():
            width, height = struct.unpack(">II", png[16:24])
            image = Summary.Image(encoded_image_string=png, width=width, height=height, colorspace=3)
            values.append(Summary.Value(tag=f"{name}/{kind}", image=image))
        self._writer.file_writer.add_summary(Summary(value=values))  # type: ignore[union-attr]

    def mesh(
        self,
        name: str,
        vertices: Float32[ndarray, "v 3"],
        colours: UInt8[ndarray, "v 3"],
        faces: Int32[ndarray, "f 3"],
    ) -> None:
        """Add a 3D view of one scan, as `brafit.result.Result.mesh_view` gives it.

        Written here because `SummaryWriter.add_mesh` makes a Python number of every coordinate.
        """
        from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[attr-defined]
        from tensorboard.plugins.mesh import metadata
        from tensorboard.plugins.mesh.plugin_data_pb2 import MeshPluginData  # type: ignore[attr-defined]
        from tensorboard.util.tensor_util import make_tensor_proto

        kinds = MeshPluginData
        parts = {kinds.VERTEX: vertices, kinds.FACE: faces, kinds.COLOR: colours}
        mask, scene = metadata.get_components_bitmask(list(parts)), json.dumps(_SCENE, sort_keys=True)
        values = []
        for kind, array in parts.items():
            about = metadata.create_summary_metadata(
                f"{name}/cup", None, kind, mask, [1, *array.shape], json_config=scene
            )
            tag = metadata.get_instance_name(f"{name}/cup", kind)
            values.append(Summary.Value(tag=tag, tensor=make_tensor_proto(array[None]), metadata=about))
        self._writer.file_writer.add_summary(Summary(value=values))  # type: ignore[union-attr]

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


_SCENE = {"material": {"cls": "MeshStandardMaterial", "side": 2, "roughness": 1, "metalness": 0}}


def _quantiles(values: Tensor) -> dict[str, float]:
    """Of the finite values; nothing if there are none."""
    numbers = values.detach().double().cpu().flatten()
    numbers = numbers[numbers.isfinite()].numpy()
    if len(numbers) == 0:
        return {}
    return dict(zip(QUANTILES, np.quantile(numbers, list(QUANTILES.values())).tolist(), strict=True))
