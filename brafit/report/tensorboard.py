"""A run's course and results as TensorBoard events, written by TensorBoard itself: PyTorch is not needed for it.

Three tags per term and batch, never one per scan and term: TensorBoard becomes slow beyond some ten thousand tags. Of
the scans that are watched there are two curves, pictures and a 3D view each.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from tensorboard.compat.proto import event_pb2, summary_pb2
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.plugins.custom_scalar import metadata as charts
from tensorboard.plugins.mesh import metadata as meshes
from tensorboard.plugins.mesh import plugin_data_pb2
from tensorboard.plugins.text import metadata as texts
from tensorboard.summary.writer.event_file_writer import EventFileWriter
from tensorboard.util.tensor_util import make_tensor_proto

from brafit.naming import plain_path
from brafit.report.fit_step import FitStep

MOMENTS = 1000
"""Steps of a fit that are recorded at most, evenly over it (and the first of every stage)."""
_BAND = ("median", "p05", "p95")
_SCENE = {"material": {"cls": "MeshStandardMaterial", "side": 2, "roughness": 1, "metalness": 0}}
# The classes of messages are made at run time.
_EVENTS: Any = event_pb2
_SUMMARIES: Any = summary_pb2
_CHARTS: Any = layout_pb2
_PARTS: Any = plugin_data_pb2.MeshPluginData  # type: ignore[attr-defined]


class Recorder:
    """Writes events into a folder. A context manager; `close` may be called twice.

    Tags: `TERM/median`, `TERM/p05` and `TERM/p95` of every term over the problems of a batch that still run, and a
    chart of that band per term under Custom Scalars; `SCAN/objective` and `SCAN/rms_mm` of scans that are watched;
    `stage`; images `SCAN/KIND`; meshes `SCAN/cup`.
    """

    def __init__(self, folder: str | Path):
        Path(folder).mkdir(parents=True, exist_ok=True)
        self._link = ExitStack()
        place = self._link.enter_context(plain_path(Path(folder)))
        self._writer = EventFileWriter(str(place), max_queue_size=1000, flush_secs=10)
        self._charted: list[str] = []
        self._stages: list[str] = []
        self._next = 0

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def step(self, step: FitStep) -> None:
        """Record a step of a batch's fit."""
        entering = step.stage not in self._stages
        if step.index < self._next and not entering:
            return
        self._next = step.index + max(1, step.total // MOMENTS)
        if entering:
            self._stages.append(step.stage)
            self.text("stage", step.stage, step.index)
        self._chart(step.quantiles)
        values = {f"{term}/{name}": value for term, band in step.quantiles.items() for name, value in band.items()}
        values |= {f"{scan}/{name}": value for scan, own in step.scans.items() for name, value in own.items()}
        self._add(
            _SUMMARIES.Summary(value=[_SUMMARIES.Summary.Value(tag=tag, simple_value=v) for tag, v in values.items()]),
            step.index,
        )

    def image(self, tag: str, png: bytes) -> None:
        """Add a picture, as the content of a PNG file."""
        width, height = struct.unpack(">II", png[16:24])
        picture = _SUMMARIES.Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=png)
        self._add(_SUMMARIES.Summary(value=[_SUMMARIES.Summary.Value(tag=tag, image=picture)]))

    def mesh(self, tag: str, vertices: np.ndarray, colours: np.ndarray, faces: np.ndarray, title: str = "") -> None:
        """Add a 3D view.

        Args:
            tag: the name under which TensorBoard lists it.
            vertices: (v, 3) float32, as the viewer shows them: it looks along -z, with y up.
            colours: (v, 3) uint8.
            faces: (f, 3) int32.
            title: shown with it; the tag if there is none.
        """
        parts = ((_PARTS.VERTEX, vertices), (_PARTS.FACE, faces), (_PARTS.COLOR, colours))
        mask = meshes.get_components_bitmask([kind for kind, _ in parts])
        values = []
        for kind, array in parts:
            own = meshes.create_summary_metadata(
                tag, title or tag, kind, mask, (1, *array.shape), title or tag, json_config=json.dumps(_SCENE)
            )
            name = meshes.get_instance_name(tag, kind)
            values.append(_SUMMARIES.Summary.Value(tag=name, tensor=make_tensor_proto(array[None]), metadata=own))
        self._add(_SUMMARIES.Summary(value=values))

    def text(self, tag: str, words: str, step: int = 0) -> None:
        """Add a text in Markdown."""
        own = texts.create_summary_metadata(display_name=tag, description="")
        self._tensor(f"{tag}/text_summary", np.array([words.encode()], dtype=object), own, step)

    def summary(self, summary: Any) -> None:
        """Add a summary made elsewhere, such as hyperparameters."""
        self._add(summary)

    def scalar(self, tag: str, value: float, step: int = 0) -> None:
        """Add a number."""
        self._add(_SUMMARIES.Summary(value=[_SUMMARIES.Summary.Value(tag=tag, simple_value=value)]), step)

    def close(self) -> None:
        """Write what is pending and close the files."""
        self._writer.close()
        self._link.close()

    def _chart(self, terms: Mapping[str, Any]) -> None:
        """One chart per term, all in one group. TensorBoard takes the last layout written."""
        new = [name for name in terms if name not in self._charted]
        if not new:
            return
        self._charted += new
        layout = _CHARTS.Layout(
            category=[
                _CHARTS.Category(
                    title="fit: median, 5 % and 95 % over the batch", chart=[_band(name) for name in self._charted]
                )
            ]
        )
        content = np.array(layout.SerializeToString(), dtype=object)
        self._tensor(charts.CONFIG_SUMMARY_TAG, content, charts.create_summary_metadata())

    def _tensor(self, tag: str, content: np.ndarray, metadata: Any, step: int = 0) -> None:
        tensor = make_tensor_proto(content)
        self._add(_SUMMARIES.Summary(value=[_SUMMARIES.Summary.Value(tag=tag, tensor=tensor, metadata=metadata)]), step)

    def _add(self, summary: Any, step: int = 0) -> None:
        self._writer.add_event(_EVENTS.Event(summary=summary, step=step, wall_time=time.time()))


def _band(term: str) -> Any:
    median, low, high = (f"{term}/{name}" for name in _BAND)
    series = _CHARTS.MarginChartContent.Series(value=median, lower=low, upper=high)
    return _CHARTS.Chart(title=term, margin=_CHARTS.MarginChartContent(series=[series]))
