import io
from typing import Any

import numpy as np
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.util import tensor_util

from brafit.report.fit_step import FitStep
from brafit.report.tensorboard import Recorder

LAYOUT: Any = layout_pb2.Layout  # type: ignore[attr-defined]


def step(index: int, stage: str = "1 adam", total: int = 10, scans: dict | None = None, **medians: float) -> FitStep:
    bands = {name: {"median": m, "p05": m - 1, "p95": m + 1} for name, m in medians.items()}
    return FitStep(stage, index, total, bands, scans or {})


def events(folder) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder), size_guidance={"scalars": 0, "tensors": 0, "images": 0})
    return accumulator.Reload()


def tensor(read: EventAccumulator, tag: str) -> np.ndarray:
    return tensor_util.make_ndarray(read.Tensors(tag)[-1].tensor_proto)


def test_a_batch_has_its_quantiles_and_each_watched_scan_a_curve(tmp_path):
    with Recorder(tmp_path) as recorder:
        recorder.step(step(0, loss=50.0, penalty=7.0, scans={"anny": {"objective": 3.0, "rms_mm": 2.0}}))
        recorder.step(step(1, loss=40.0, scans={"anny": {"objective": 1.0, "rms_mm": 1.0}}))
    read = events(tmp_path)
    found = {q: [(e.step, e.value) for e in read.Scalars(f"loss/{q}")] for q in ("median", "p05", "p95")}
    assert found == {"median": [(0, 50), (1, 40)], "p05": [(0, 49), (1, 39)], "p95": [(0, 51), (1, 41)]}
    assert [(e.step, e.value) for e in read.Scalars("penalty/p95")] == [(0, 8)]
    assert [(e.step, e.value) for e in read.Scalars("anny/rms_mm")] == [(0, 2), (1, 1)]


def test_one_chart_with_the_band_of_each_term(tmp_path):
    with Recorder(tmp_path) as recorder:
        recorder.step(step(0, loss=1.0))
        recorder.step(step(1, stage="2 lbfgs", loss=1.0, ends=1.0))
    layout = LAYOUT.FromString(tensor(events(tmp_path), "custom_scalars__config__").item())
    (category,) = layout.category
    assert [chart.title for chart in category.chart] == ["loss", "ends"]
    (series,) = category.chart[1].margin.series
    assert (series.value, series.lower, series.upper) == ("ends/median", "ends/p05", "ends/p95")


def test_long_fits_are_thinned_but_every_stage_begins(tmp_path):
    with Recorder(tmp_path) as recorder:
        for index in range(5000):
            recorder.step(step(index, stage="1" if index < 3333 else "2", total=5000, loss=1.0))
    read = events(tmp_path)
    steps = [event.step for event in read.Scalars("loss/median")]
    assert 900 < len(steps) <= 1001
    assert 0 in steps
    assert 3333 in steps
    assert [tensor(read, "stage/text_summary").item()] == [b"2"]


def test_pictures_and_meshes_come_back_as_they_were(tmp_path):
    drawn = io.BytesIO()
    Image.new("RGB", (70, 50), "red").save(drawn, "png")
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    colours, faces = np.full((3, 3), 200, dtype=np.uint8), np.array([[0, 1, 2]], dtype=np.int32)
    with Recorder(tmp_path) as recorder:
        recorder.image("anny Ü/patterns", drawn.getvalue())
        recorder.mesh("anny Ü/cup", vertices, colours, faces, "anny Ü, left cup")
    read = events(tmp_path)
    (image,) = read.Images("anny Ü/patterns")
    assert image.encoded_image_string == drawn.getvalue()
    assert (image.width, image.height) == (70, 50)
    for part, values in (("VERTEX", vertices), ("FACE", faces), ("COLOR", colours)):
        np.testing.assert_array_equal(tensor(read, f"anny Ü/cup_{part}")[0], values)
    metadata = read.SummaryMetadata("anny Ü/cup_VERTEX")
    assert metadata.plugin_data.plugin_name == "mesh"
    assert metadata.display_name == "anny Ü, left cup"
