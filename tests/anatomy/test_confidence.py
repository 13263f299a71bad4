"""Landmarks that nobody looked at: what speaks for them, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from brafit.anatomy.confidence import BOUNDS, Confidence, doubt
from brafit.anatomy.torso import proposals
from brafit.cloud.mesh import sample_faces
from brafit.errors import InputError
from brafit.landmarks import landmarks_path
from brafit.scan import Scan, load_scan, load_sides
from brafit.simulation.bodies import levelled

BREAST, RISE, BACK = np.array([80.0, 60.0]), 70.0, 0.5


def body(sides: tuple[int, ...], legs: bool, n: int = 90_000) -> np.ndarray:
    """A trunk with a neck and balls for breasts on the sides named (1: left), with legs if wished; y up, z front."""
    trunk = trimesh.creation.icosphere(subdivisions=5).apply_scale([170.0, 330.0, 105.0])
    trunk.vertices[:, 2] *= np.where(trunk.vertices[:, 2] < 0, BACK, 1.0)
    trunk = trimesh.intersections.slice_mesh_plane(trunk, [0, 1, 0], [0, -230, 0])
    parts = [trunk, trimesh.creation.cylinder(55.0, 160.0, sections=64)]
    parts[1].apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    parts[1].apply_translation([0, 350, -10])
    for side in sides:
        ball = trimesh.creation.icosphere(subdivisions=4, radius=RISE)
        parts.append(ball.apply_translation([side * BREAST[0], BREAST[1], 55.0]))
    for side in (1, -1) if legs else ():
        leg = trimesh.creation.cylinder(80.0, 800.0, sections=64)
        leg.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
        parts.append(leg.apply_translation([side * 85.0, -600.0, 0.0]))
    meshes = [part.subdivide_to_size(25.0) for part in parts]
    share = n / sum(mesh.area for mesh in meshes)
    points = [sample_faces(mesh.vertices, mesh.faces, int(share * mesh.area)) for mesh in meshes]
    shown = [part[~_inside(part, parts, k)] for k, part in enumerate(points)]
    return np.concatenate(shown) + 0.2 * np.random.default_rng(0).standard_normal((sum(map(len, shown)), 3))


def _inside(points: np.ndarray, parts: list[trimesh.Trimesh], own: int) -> np.ndarray:
    """Points of a part within the trunk or a ball."""
    gone = np.zeros(len(points), dtype=bool)
    if own != 0:
        whole = points * np.where(points[:, 2:] < 0, [1.0, 1.0, 1 / BACK], 1.0)
        gone |= ((whole / [170.0, 330.0, 105.0]) ** 2).sum(axis=1) < 1
    for k, part in enumerate(parts[2:4], start=2):
        if k != own:
            gone |= np.linalg.norm(points - part.bounds.mean(axis=0), axis=1) < RISE
    return gone if own < 4 else np.zeros(len(points), dtype=bool)


@pytest.fixture(scope="module")
def one_sided(tmp_path_factory):
    path = tmp_path_factory.mktemp("body") / "body.npy"
    np.save(path, body((1,), legs=True))
    return path


def test_where_there_is_no_breast_none_is_proposed(one_sided):
    left, right = load_sides(one_sided, ("left", "right"), propose=True, points=500)
    assert isinstance(left, Scan)
    assert left.apex is not None
    apex = left.frame.to_scan(left.apex)
    assert np.linalg.norm(apex[:2] - BREAST) < 40, "on the breast, not on a thigh"
    assert isinstance(right, InputError)
    assert "right breast" in str(right)


def test_both_breasts_of_a_body_with_legs_are_found(tmp_path):
    found = proposals(tmp_path / "body.npy", body((1, -1), legs=True))
    for one, sign in zip(found, (1, -1), strict=True):
        assert not one.confidence.faults
        assert np.linalg.norm(one.marks.points["apex"][:2] - BREAST * [sign, 1]) < 40
        assert 150 < one.confidence.evidence["wire"] < 350


def test_mirrored_marks_that_hang_before_the_skin_are_refused(one_sided, tmp_path):
    (found, _) = proposals(one_sided, np.load(one_sided))
    path = tmp_path / "scan.npy"
    np.save(path, np.load(one_sided))
    marks = found.marks
    given = {"side": "left", "units": "mm", "wire": marks.wire.tolist() if marks.wire is not None else None}
    given["landmarks"] = {name: place.tolist() for name, place in marks.points.items()}
    landmarks_path(path).write_text(json.dumps(given))
    assert load_scan(path, points=500).confidence is None
    with pytest.raises(InputError, match=r"no right breast was found|mirrored, are not those of the right breast"):
        load_scan(path, side="right", points=500)


def test_confidence_is_that_of_the_worst_evidence():
    usual = {"rise": 20.0, "wire": 210.0, "guessed": 0.1}
    good = Confidence("left", usual)
    assert (good.value, good.doubts, good.faults, doubt(good)) == (1.0, (), (), "")
    low = BOUNDS["rise"].possible[0]
    between = Confidence("left", usual | {"rise": (low + BOUNDS["rise"].usual[0]) / 2})
    assert between.value == pytest.approx(0.5)
    assert "rises by 12 mm" in doubt(between)
    assert "brafit-inspect" in doubt(between)
    assert not between.faults
    none = Confidence("left", usual | {"wire": 406.0, "guessed": 0.6})
    assert none.value == 0
    assert none.faults == ("the wire is 406 mm long, wires are 150 to 350 mm",)
    assert len(none.doubts) == 2


def test_a_levelled_breast_is_as_flat_as_what_is_about_it():
    box = trimesh.creation.box([200.0, 200.0, 20.0])
    plate = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 12.0)[:2])
    bump = 40 * np.exp(-(plate.vertices[:, :2] ** 2).sum(axis=1) / 30**2)
    top = plate.vertices[:, 2] > 9
    raised = plate.vertices + np.where(top, bump, 0.0)[:, None] * [0, 0, 1]
    there = top & (np.linalg.norm(plate.vertices[:, :2], axis=1) < 85)
    flat, half = (levelled(raised, plate.faces, there, left)[there, 2] - 10 for left in (0.0, 0.5))
    assert np.abs(flat).max() < 0.5
    np.testing.assert_allclose(half, 0.5 * (raised[there, 2] - 10), atol=0.5)
