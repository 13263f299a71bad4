"""Scans that hold one breast, or one side of a body: they do not show where the body's middle is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from torsos import torso, write

from brafit.cloud import Cloud
from brafit.errors import InputError
from brafit.landmarks import landmarks_path
from brafit.samples import sample_paths
from brafit.scan import load_scan, load_sides

OF_MIDDLE = {"apex_out", "inner_out"}


def as_proposed(sample: Path, folder: Path, **marks: list[float]) -> Path:
    """A landmark file of a bundled breast that says that nobody has looked at it, with other points."""
    content = json.loads(landmarks_path(sample).read_text())
    content |= {"proposed": True, "landmarks": content["landmarks"] | marks}
    path = folder / f"{sample.stem}.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("sample", sample_paths(), ids=lambda path: path.stem)
def test_proposed_marks_on_one_breast_are_judged_without_a_middle(sample, tmp_path):
    """They are right: they are a person's."""
    scan = load_scan(sample, landmarks=as_proposed(sample, tmp_path), points=500)
    assert scan.confidence is not None
    assert scan.confidence.doubts == ()
    assert not OF_MIDDLE & scan.confidence.evidence.keys()
    assert {"rise", "wire", "guessed", "inner_usual", "outer_usual", "apex_off"} <= scan.confidence.evidence.keys()
    assert "one_side" not in [note.code for note in scan.notes], "there is no other breast to be fitted"


def test_wrong_marks_on_one_breast_are_refused_all_the_same(tmp_path):
    sample = sample_paths()[1]
    apex = np.array(json.loads(landmarks_path(sample).read_text())["landmarks"]["apex"])
    off = as_proposed(sample, tmp_path, apex=(apex + np.array([0.0, 0.0, 40.0])).tolist())
    with pytest.raises(InputError, match="the bust point is 37 mm off the surface"):
        load_scan(sample, landmarks=off)


def one_side(folder: Path, tapered: float) -> Path:
    """The left side of a torso with a flat back, and a bit more; it tapers off downwards by so much for a metre."""
    points = torso(40.0, n=60_000)
    points[:, 2] *= np.where(points[:, 2] < 0, 0.4, 1.0)
    points[:, [0, 2]] *= 1 + tapered * points[:, 1:2] / 1000
    return write(folder, points[points[:, 0] > -12])


@pytest.mark.parametrize("tapered", [1.5, 0.0])
def test_one_side_of_a_body_has_no_middle(tmp_path, tapered):
    """Whether it is symmetric in no way, or in another one."""
    path = one_side(tmp_path, tapered)
    content = json.loads(landmarks_path(path).read_text())
    landmarks_path(path).write_text(json.dumps(content | {"proposed": True}))
    left, right = load_sides(path, points=500)
    assert not isinstance(left, InputError)
    assert left.confidence is not None
    assert not OF_MIDDLE & left.confidence.evidence.keys()
    assert isinstance(right, InputError)
    assert "it marks the left breast only, and the" in str(right)


def test_nothing_is_proposed_on_one_side_of_a_body_and_the_reason_is_told(tmp_path):
    cloud = Cloud(tmp_path / "half.npy", np.load(one_side(tmp_path, 1.5)), None, None)
    for error in load_sides(cloud, propose=True):
        assert isinstance(error, InputError)
        assert "it seems to be a part of a torso: no plane parts it into two sides that are alike" in error.cause
        assert "body's middle" not in error.cause
