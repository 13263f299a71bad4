from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from lunes import lune_cup, sphere_points

from brafit.fitting import Target
from brafit.fitting.start import middles, start_curves
from brafit.fitting.targets import PADDED, Targets
from brafit.geometry.polyline import evenly_spaced


def target(count: int = 50, **given) -> Target:
    return Target(f"sphere {count}", sphere_points(count)[0], lune_cup().edges[0, ::5].numpy(), **given)


def test_stack_pads_with_weight_zero_and_divides_by_the_scale(dtype):
    neckline = lune_cup().edges[-1].numpy()
    both = [target(50, neckline=neckline, apex=np.array([1.0, 2, 3])), target(20, strap_point=np.array([4.0, 5, 6]))]
    batch = Targets.stack(both, torch.tensor([80.0, 40.0], dtype=dtype))
    assert batch.points.dtype == dtype
    assert batch.points.shape == (2, PADDED, 3)
    torch.testing.assert_close(batch.weights.sum(1), torch.ones(2, dtype=dtype))
    assert (batch.weights[1, 20:] == 0).all()
    np.testing.assert_allclose(np.sort(batch.points[1, :20] * 40, axis=0), np.sort(both[1].points, axis=0), rtol=1e-5)
    assert batch.has_neckline.tolist() == [True, False]
    assert batch.has_apex.tolist() == [True, False]
    assert batch.has_connection.tolist() == [False, True]
    np.testing.assert_allclose(batch.connection[1] * 40, [4, 5, 6], rtol=1e-5)
    np.testing.assert_allclose(batch.apex[0] * 80, [1, 2, 3], rtol=1e-5)
    chosen = batch.select(torch.tensor([1, 1]))
    assert chosen.scale.tolist() == [40.0, 40.0]
    assert chosen.has_connection.all()


def test_a_bust_point_that_nobody_marked_is_the_scans_farthest_point() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    points[:2] = [[7.0, 3.0, 9.0], [5.0, 1.0, 9.5]]
    np.testing.assert_allclose(Target("one", points, points[:5]).bust_point, [6.0, 2.0, 9.25])
    np.testing.assert_array_equal(Target("one", points, points[:5], apex=points[3]).bust_point, points[3])


def test_thinned_clouds_are_means_of_small_patches():
    """On a sphere: patches of some ten points lie on it but for their sag, cover it all, and all but keep the centre of
    mass, whatever the order in which the points came."""
    random = np.random.default_rng(5)
    points = sphere_points(2000)[0]
    weights = random.uniform(0.5, 2, len(points))
    weights[::7] = 0
    shuffled = random.permutation(len(points))
    wire = lune_cup().edges[0, ::5].numpy()
    both = [
        Target("in order", points, wire, weights=weights),
        Target("shuffled", points[shuffled], wire, weights=weights[shuffled]),
        Target("small", points[:50], wire),
    ]
    whole = Targets.stack(both, torch.full((3,), 80.0, dtype=torch.float64))
    few = whole.thinned(200)
    torch.testing.assert_close(few.points[0], few.points[1], rtol=0, atol=1e-12)
    torch.testing.assert_close(few.weights.sum(1), torch.ones(3, dtype=torch.float64))
    middles = [(cloud.points * cloud.weights[..., None]).sum(1) for cloud in (whole, few)]
    torch.testing.assert_close(*middles, rtol=0, atol=0.5 / 80)
    away = (80 * few.points[0] - torch.tensor([0.0, 80, 0])).norm(dim=-1)
    assert ((away - 80).abs() < 2.0).all()
    assert torch.cdist(whole.points[0], few.points[0]).min(1).values.max() * 80 < 15
    assert (few.weights[2] > 0).sum() == 50
    assert whole.thinned(0).points.shape == (3, 0, 3)


def test_even_spacing_is_even_by_arc_length_and_keeps_the_ends():
    a = np.linspace(0, np.pi, 200) ** 2 / np.pi
    line = np.stack((np.cos(a), np.sin(a), 0 * a), axis=1)
    even = evenly_spaced(line, 31)
    np.testing.assert_allclose(even[[0, -1]], line[[0, -1]], atol=1e-15)
    steps = np.linalg.norm(np.diff(even, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)


@pytest.mark.parametrize("given", ["neckline", "strap_point", "nothing"])
def test_starts_are_sections_from_the_wire_to_the_upper_edge(given):
    """On the quarter sphere every section through the wire's chord is a half circle of its radius."""
    shape = lune_cup(2)
    extra = {
        "neckline": {"neckline": shape.edges[-1].numpy()},
        "strap_point": {"strap_point": np.array([0.0, 80, 80])},
        "nothing": {},
    }[given]
    curves = start_curves(target(2000, **extra), 2, 9)
    assert curves.shape[:2] == (9, 2)
    np.testing.assert_allclose(np.linalg.norm(curves - [0, 80, 0], axis=-1), 80, rtol=0.02)
    np.testing.assert_allclose(curves[:, :, 0], 0, atol=0.5)
    np.testing.assert_allclose(curves[:, :, -1] - [0, 160, 0], 0, atol=0.5)
    angles, reaches = middles(curves)
    tolerance = 0.08 if given == "nothing" else 0.01
    np.testing.assert_allclose(angles[:, 1], math.pi / 2, atol=tolerance)
    np.testing.assert_allclose(reaches, 80, rtol=0.02)
    assert angles[0, 0] == pytest.approx(math.pi / 6, abs=0.05)
    assert ((angles[:, 0] > 0.1) & (angles[:, 0] < 1.4)).all()
    assert len(set(angles[:, 0].round(6))) == 9
    np.testing.assert_array_equal(start_curves(target(2000, **extra), 2, 9), curves)
