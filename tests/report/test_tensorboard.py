from typing import Any

import numpy as np
import pytest
import torch
from lunes import lune_cup, lune_flat, sphere_points
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.util import tensor_util

from brafit.fit.solver import Step
from brafit.pattern import PatternOptions, finish, pieces_from_panels
from brafit.report.mesh import DOTS, mesh_view
from brafit.report.pictures import pattern_picture
from brafit.report.tensorboard import Recorder

LAYOUT: Any = layout_pb2.Layout  # type: ignore[attr-defined]


def step(index: int, stage: str = "1 adam", total: int = 10, **terms: torch.Tensor) -> Step:
    return Step(stage, index, total, terms)


def events(folder) -> EventAccumulator:
    accumulator = EventAccumulator(str(folder), size_guidance={"scalars": 0, "tensors": 0, "images": 0})
    return accumulator.Reload()


def tensor(read: EventAccumulator, tag: str) -> np.ndarray:
    return tensor_util.make_ndarray(read.Tensors(tag)[-1].tensor_proto)


def test_quantiles_over_the_finite_values_of_the_batch(tmp_path):
    batch = torch.arange(101.0)
    broken = torch.cat((batch, torch.tensor([torch.nan, torch.inf])))
    with Recorder(tmp_path) as recorder:
        recorder.step(step(0, loss=batch, penalty=2 * batch))
        recorder.step(step(1, loss=broken, penalty=torch.full((5,), torch.nan)))
        recorder.step(step(2, loss=batch[7:8]))
    read = events(tmp_path)
    found = {q: [(e.step, e.value) for e in read.Scalars(f"loss/{q}")] for q in ("median", "p05", "p95")}
    assert found == {
        "median": [(0, 50), (1, 50), (2, 7)],
        "p05": [(0, 5), (1, 5), (2, 7)],
        "p95": [(0, 95), (1, 95), (2, 7)],
    }
    assert [(e.step, e.value) for e in read.Scalars("penalty/p95")] == [(0, 190)]


def test_one_chart_with_the_band_of_each_term(tmp_path):
    with Recorder(tmp_path) as recorder:
        recorder.step(step(0, loss=torch.ones(3)))
        recorder.step(step(1, stage="2 lbfgs", loss=torch.ones(3), ends=torch.ones(3)))
    layout = LAYOUT.FromString(tensor(events(tmp_path), "custom_scalars__config__").item())
    (category,) = layout.category
    assert [chart.title for chart in category.chart] == ["loss", "ends"]
    (series,) = category.chart[1].margin.series
    assert (series.value, series.lower, series.upper) == ("ends/median", "ends/p05", "ends/p95")


def test_long_fits_are_thinned_but_every_stage_begins(tmp_path):
    with Recorder(tmp_path) as recorder:
        for index in range(5000):
            recorder.step(step(index, stage="1" if index < 3333 else "2", total=5000, loss=torch.ones(2)))
    read = events(tmp_path)
    steps = [event.step for event in read.Scalars("loss/median")]
    assert 900 < len(steps) <= 1001
    assert 0 in steps
    assert 3333 in steps
    assert [tensor(read, "stage/text_summary").item()] == [b"2"]


@pytest.mark.parametrize("side", ["left", "right"])
def test_images_and_mesh_of_a_scan(tmp_path, side):
    points, distances = sphere_points(700)
    made = finish(pieces_from_panels(lune_flat()), PatternOptions(), name="anny", side="left")
    with Recorder(tmp_path) as recorder:
        recorder.images("anny Ü", {"patterns": pattern_picture(made, "anny")})
        recorder.mesh("anny Ü", *mesh_view(lune_cup(n=21), points, distances, side))
    read = events(tmp_path)
    (image,) = read.Images("anny Ü/patterns")
    assert image.encoded_image_string.startswith(b"\x89PNG")
    assert image.width > 500
    vertices, faces, colours = (tensor(read, f"anny Ü/cup_{part}")[0] for part in ("VERTEX", "FACE", "COLOR"))
    assert vertices.shape == colours.shape == (2 * (2 + 19 * 7) + 4 * 700, 3)
    assert faces.min() == 0
    assert faces.max() == len(vertices) - 1
    assert np.abs(vertices.min(0) + vertices.max(0)).max() < 1e-3
    dots = vertices[-4 * 700 :].reshape(-1, 4, 3).mean(1)
    worn = points[:, [1, 0, 2]] * ((1, -1, 1) if side == "left" else (-1, -1, 1))
    np.testing.assert_allclose(dots - dots[0], worn - worn[0], atol=1e-3)


def test_the_3d_view_shows_faces_outwards_and_colours_as_they_are(tmp_path):
    points, distances = sphere_points(20)
    for side in ("left", "right"):
        vertices, colours, faces = mesh_view(lune_cup(n=21), points, distances, side)
        assert (vertices.dtype, colours.dtype, faces.dtype) == (np.float32, np.uint8, np.int32)
        cup = faces[: len(faces) - 4 * 20]
        corners = vertices[cup].astype(float)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert np.mean(normals[:, 2] >= -1e-6) > 0.95  # to the viewer
        with Recorder(tmp_path / side) as recorder:
            recorder.mesh("x", vertices, colours, faces)
        read = events(tmp_path / side)
        for part, array in (("VERTEX", vertices), ("COLOR", colours), ("FACE", faces)):
            np.testing.assert_array_equal(tensor(read, f"x/cup_{part}")[0], array)


def test_large_clouds_are_thinned_in_the_3d_view():
    points, distances = sphere_points(DOTS + 500)
    vertices, _, _ = mesh_view(lune_cup(n=21), points, distances)
    assert len(vertices) == 2 * (2 + 19 * 7) + 4 * DOTS
