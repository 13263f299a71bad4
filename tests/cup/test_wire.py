from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from scipy.optimize import minimize_scalar

from brafit.cup import Wire
from brafit.cup.wire import LENGTH

DENSE = torch.linspace(0, LENGTH, 501, dtype=torch.float64)


def positions(wire: Wire, item: int = 0) -> torch.Tensor:
    """In the unit the wire was given in."""
    return wire.sample(DENSE)[item] * wire.scale[item]


def noisy_arc(count: int, noise: float, radius: float = 80.0, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    a = np.sort(np.append(generator.uniform(0, np.pi, count - 2), (0, np.pi)))
    line = radius * np.stack((np.sin(a), 1 - np.cos(a), 0.2 * np.sin(2 * a)), axis=1)
    return line + generator.normal(0, noise, line.shape)


def distance_to(wire: Wire, point: np.ndarray) -> float:
    """From a point to the wire, by SciPy's scalar minimiser around the nearest of dense samples."""
    scale = wire.scale.item()

    def distance(s: float) -> float:
        s = min(max(s, 0.0), LENGTH)
        return float(np.linalg.norm(wire.sample(torch.tensor([s], dtype=torch.float64))[0, 0].numpy() * scale - point))

    near = DENSE[np.linalg.norm(positions(wire).numpy() - point, axis=1).argmin()].item()
    around: Any = minimize_scalar(
        distance, bounds=(near - 0.02, near + 0.02), method="bounded", options={"xatol": 1e-10}
    )
    return min(float(around.fun), distance(near))


def test_constant_omega_is_the_papers_half_circle():
    radius = 1 / 2.91
    wire = Wire.from_omega((0.0, 2.91, 0.0), math.pi * radius)
    a = DENSE
    expected = radius * torch.stack((torch.sin(a), 1 - torch.cos(a), torch.zeros_like(a)), dim=-1)
    torch.testing.assert_close(positions(wire), expected, rtol=0, atol=1e-13)
    assert wire.length.item() == pytest.approx(math.pi * radius)
    assert wire.smoothing.item() == 0


def test_constant_omega_is_a_helix_in_any_frame():
    omega, length = np.array([0.3, 0.8, -0.4]), 4.0
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    frame *= np.linalg.det(frame)
    wire = Wire.from_omega(tuple(omega), length, frame.tolist())
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]]
    generator[2, 3] = 1
    for k in (0, 100, 333, 500):
        end = expm(generator * length * k / 500)[:3, 3]
        np.testing.assert_allclose(positions(wire)[k], frame @ end, atol=1e-12)


@pytest.mark.parametrize(("radius", "length"), [(80.0, 251.3), (80.0, 150.0), (60.0, 300.0), (1.0, 1e-3)])
def test_arc_lies_in_the_cup_frame(radius, length):
    wire = Wire.from_arc(radius, length)
    x = positions(wire)
    small = 1e-11 * radius
    assert x[0].norm() < small
    assert abs(x[-1, 0]) < small
    assert x[-1, 1].item() == pytest.approx(2 * radius * math.sin(length / radius / 2))
    assert (x[:, 2].abs() < small).all()
    assert (x[1:-1, 0] > 0).all()
    centre = torch.tensor([0.0, x[-1, 1].item() / 2, 0.0], dtype=torch.float64)
    centre[0] = -radius * math.cos(length / radius / 2)
    torch.testing.assert_close((x - centre).norm(dim=-1), torch.full_like(DENSE, radius))


@pytest.mark.parametrize(
    "wire",
    [Wire.from_arc(80.0, 200.0), Wire.from_omega((0.3, 0.8, -0.4), 4.0), Wire.from_polyline(noisy_arc(40, 0.2))],
    ids=["arc", "helix", "polyline"],
)
def test_parameter_is_arc_length(wire):
    speed = wire.sample(DENSE, 1)[0].norm(dim=-1)
    torch.testing.assert_close(speed, torch.ones_like(DENSE), rtol=0, atol=1e-7)
    chords = positions(wire).diff(dim=0).norm(dim=-1).sum()
    assert chords.item() == pytest.approx(wire.length.item(), rel=1e-5)


def test_derivatives_are_those_of_the_positions():
    wire, h = Wire.from_polyline(noisy_arc(40, 0.2)), 1e-5
    s = DENSE[10:-10:10]
    for order in (1, 2):
        difference = (wire.sample(s + h, order - 1) - wire.sample(s - h, order - 1)) / (2 * h)
        torch.testing.assert_close(wire.sample(s, order), difference, rtol=0, atol=1e-6)


@pytest.mark.parametrize("noise", [0.0, 0.2, 1.0])
def test_smoothing_is_the_largest_distance_of_the_given_points(noise):
    points = noisy_arc(40, noise)
    wire = Wire.from_polyline(points)
    actual = max(distance_to(wire, p) for p in points)
    assert wire.smoothing.item() == pytest.approx(actual, abs=1e-5)
    assert wire.smoothing.item() < 0.05 + 3 * noise


def test_smoothing_brings_a_noisy_wire_nearer_to_the_true_one():
    points, true = noisy_arc(50, 0.3), Wire.from_polyline(noisy_arc(400, 0.0))
    wire = Wire.from_polyline(points)
    before = np.sqrt(np.mean([distance_to(true, p) ** 2 for p in points[1:-1]]))
    after = np.sqrt(np.mean([distance_to(true, p.numpy()) ** 2 for p in positions(wire)[20:-20:10]]))
    assert after < 0.7 * before


def test_a_fine_polyline_is_followed():
    """A wire out of its plane, unevenly sampled: position, length and ends."""
    points = noisy_arc(60, 0.0)
    wire = Wire.from_polyline(points)
    x = positions(wire).numpy()
    np.testing.assert_allclose(x[[0, -1]], points[[0, -1]], atol=1e-9)
    a = np.linspace(0, np.pi, 20001)
    true = 80 * np.stack((np.sin(a), 1 - np.cos(a), 0.2 * np.sin(2 * a)), axis=1)
    assert max(np.linalg.norm(true - p, axis=1).min() for p in x[::25]) < 0.05
    assert wire.length.item() == pytest.approx(np.linalg.norm(np.diff(true, axis=0), axis=1).sum(), abs=0.05)


def test_ends_are_kept_under_noise_and_repeated_points_do_not_matter():
    points = noisy_arc(30, 0.5)
    wire = Wire.from_polyline(points)
    np.testing.assert_allclose(positions(wire)[[0, -1]], points[[0, -1]], atol=1e-9)
    repeated = Wire.from_polyline(np.repeat(points, 2, axis=0))
    assert torch.equal(repeated.coefficients, wire.coefficients)


def test_four_points_are_enough():
    a = np.linspace(0, np.pi, 4)
    wire = Wire.from_polyline(80 * np.stack((np.sin(a), 1 - np.cos(a), 0 * a), axis=1))
    assert 0.85 * 80 * np.pi < wire.length.item() < 1.1 * 80 * np.pi
    assert positions(wire).isfinite().all()


def test_scale_and_place_do_not_matter():
    points = noisy_arc(30, 0.2)
    wire, moved = Wire.from_polyline(points), Wire.from_polyline(points / 1000 + (5, -3, 2))
    torch.testing.assert_close(moved.scale * 1000, wire.scale)
    torch.testing.assert_close(moved.smoothing * 1000, wire.smoothing, rtol=1e-6, atol=0)
    shift = torch.tensor([5.0, -3.0, 2.0], dtype=torch.float64)
    torch.testing.assert_close((positions(moved) - shift) * 1000, positions(wire), rtol=0, atol=1e-8)


def test_each_wire_of_a_batch_is_as_if_alone(dtype):
    wires = [Wire.from_arc(1.0, 2.0), Wire.from_polyline(noisy_arc(30, 0.2)), Wire.from_arc(3.0, 4.0)]
    batch = Wire.stack(wires).to(dtype)
    s = DENSE.to(dtype)
    together = batch.sample(s)
    assert together.dtype == dtype
    assert len(batch) == 3
    for k, wire in enumerate(wires):
        assert torch.equal(together[k], wire.to(dtype).sample(s)[0])
    chosen = batch.select(torch.tensor([2, 0, 2]))
    assert torch.equal(chosen.sample(s), together[[2, 0, 2]])
    assert torch.equal(chosen.length, batch.length[[2, 0, 2]])


def test_the_plane_of_a_half_circle_and_of_one_that_is_moved():
    """Its normal, and the circle's mean point, 2 R / pi from the chord; both move along."""
    normal, middle = Wire.from_omega((0, 1 / 80, 0), 80 * math.pi).plane()
    assert torch.allclose(normal, torch.tensor([[0.0, 0.0, 1.0]]).double(), rtol=0, atol=1e-12)
    assert torch.allclose(middle, torch.tensor([[2 / math.pi, 1.0, 0.0]]).double(), rtol=0, atol=2e-2)
    turn, line = expm(np.cross(np.eye(3), (0.3, -0.2, 0.5))), noisy_arc(60, 0.5)
    one, other = (Wire.from_polyline(own) for own in (line, line @ turn.T + (4, -5, 6)))
    assert torch.allclose(other.plane()[0], one.plane()[0] @ torch.from_numpy(turn.T), rtol=0, atol=1e-9)
    shift = torch.tensor([4.0, -5.0, 6.0]).double() / one.scale
    assert torch.allclose(other.plane()[1], one.plane()[1] @ torch.from_numpy(turn.T) + shift, rtol=0, atol=1e-9)


def test_errors():
    with pytest.raises(ValueError, match="length must be positive, got 0"):
        Wire.from_omega((0.0, 1.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="must be positive, got -1"):
        Wire.from_arc(-1.0, 1.0)
    with pytest.raises(ValueError, match="longer than the circle of radius 1"):
        Wire.from_arc(1.0, 2 * math.pi)
    with pytest.raises(ValueError, match="at least 4 distinct points, got 2"):
        Wire.from_polyline(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]))
    broken = noisy_arc(10, 0.0)
    broken[4, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        Wire.from_polyline(broken)
