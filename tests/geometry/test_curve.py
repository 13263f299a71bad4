from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from brafit.geometry.curve import gauss_points, integrate_curve, prefix_motions
from brafit.geometry.rotation import rotation_exp

EYE = torch.eye(3, dtype=torch.float64)
ORIGIN = torch.zeros(3, dtype=torch.float64)


def constant(omega, n: int, length: float, speed: float = 1.0):
    s = torch.linspace(0, length, n, dtype=torch.float64)
    rates = torch.tensor(omega, dtype=torch.float64).expand(n - 1, 2, 3)
    frames, x = integrate_curve(rates, torch.full((n - 1, 2), speed, dtype=torch.float64), s.diff(), EYE, ORIGIN)
    return s, frames, x


def test_constant_geodesic_curvature_draws_the_circle():
    """omega_eta = 1 / R, zeta along z, xi along x: a circle about (R, 0, 0), however few stations there are."""
    radius = 0.7
    s, frames, x = constant((0.0, 1 / radius, 0.0), 7, 2 * math.pi * radius)
    a = s / radius
    torch.testing.assert_close(x[:, 0], radius * (1 - torch.cos(a)), rtol=0, atol=1e-14)
    torch.testing.assert_close(x[:, 2], radius * torch.sin(a), rtol=0, atol=1e-14)
    torch.testing.assert_close(x[:, 1], torch.zeros(7, dtype=torch.float64))
    torch.testing.assert_close(frames[-1], EYE, rtol=0, atol=1e-14)


def test_constant_rates_draw_the_helix():
    """The axis of the helix is omega's; its radius and climb follow from the angle between omega and zeta."""
    omega, speed = np.array([0.5, -0.8, 1.1]), 1.4
    s, frames, x = constant(tuple(omega), 23, 5.0, speed)
    for k, end in enumerate(s.tolist()):
        generator = np.zeros((4, 4))
        generator[:3, :3] = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        generator[2, 3] = 1
        whole = expm(generator * speed * end)
        np.testing.assert_allclose(frames[k], whole[:3, :3], atol=1e-13)
        np.testing.assert_allclose(x[k], whole[:3, 3], atol=1e-13)
    rate = np.linalg.norm(omega)
    axis = omega / rate
    np.testing.assert_allclose(x[-1].numpy() @ axis, axis[2] * speed * 5.0, atol=1e-13)


def varying(s: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    omega = torch.stack((torch.sin(2 * s), 1 + 0.5 * torch.cos(3 * s), 0.4 * s), dim=-1)
    return omega, (1 + 0.3 * torch.sin(2.5 * s)).square()


def drawn(n: int, dtype: torch.dtype = torch.float64) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    s = torch.linspace(0, math.pi, n, dtype=dtype)
    omega, speed = varying(gauss_points(s))
    return s, *integrate_curve(omega, speed, s.diff(), EYE.to(dtype), ORIGIN.to(dtype))


def reference() -> tuple[np.ndarray, np.ndarray]:
    """Frame and position at s = pi of the frame equations (1)-(4), by another integrator."""

    def rates(s: float, state: np.ndarray) -> np.ndarray:
        (wx, wy, wz), v = (t.numpy() for t in varying(torch.tensor(s, dtype=torch.float64)))
        xi, eta, zeta = state[:9].reshape(3, 3)
        turned = np.stack((wz * eta - wy * zeta, wx * zeta - wz * xi, wy * xi - wx * eta))
        return v * np.concatenate((turned.ravel(), zeta))

    start = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
    end = solve_ivp(rates, (0, math.pi), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return end[:9].reshape(3, 3).T, end[9:]


def test_fourth_order_convergence_to_the_frame_equations():
    frame, x = reference()

    def error(n: int) -> float:
        _, frames, positions = drawn(n)
        return max(np.abs(frames[-1].numpy() - frame).max(), np.abs(positions[-1].numpy() - x).max())

    errors = [error(n) for n in (21, 41, 81)]
    assert errors[2] < 1e-6
    for coarse, fine in itertools.pairwise(errors):
        assert 13 < coarse / fine < 20


def test_frames_turn_as_their_rates_say():
    """(1), (2) and x' = zeta s' by central differences at the stations."""
    s, frames, x = drawn(4001)
    h = (s[1] - s[0]).item()
    omega, speed = varying(s)
    xi, eta, zeta = frames.unbind(-1)
    wx, wy, wz = (omega * speed[:, None]).unbind(-1)
    expected = {
        "xi": (xi, wz[:, None] * eta - wy[:, None] * zeta),
        "eta": (eta, wx[:, None] * zeta - wz[:, None] * xi),
        "zeta": (zeta, wy[:, None] * xi - wx[:, None] * eta),
        "x": (x, speed[:, None] * zeta),
    }
    for values, slopes in expected.values():
        difference = (values[2:] - values[:-2]) / (2 * h)
        torch.testing.assert_close(difference, slopes[1:-1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 8, 9, 100])
def test_scan_equals_a_plain_loop(n):
    rotation = rotation_exp(torch.randn(n, 3, dtype=torch.float64))
    translation = torch.randn(n, 3, dtype=torch.float64)
    frames, places = prefix_motions(rotation, translation)
    frame, place = EYE, ORIGIN
    for k in range(n):
        place = frame @ translation[k] + place
        frame = frame @ rotation[k]
        torch.testing.assert_close(frames[k], frame, rtol=0, atol=1e-13)
        torch.testing.assert_close(places[k], place, rtol=0, atol=1e-12)


def test_each_curve_of_a_batch_is_as_if_alone(dtype):
    s = torch.linspace(0, 3, 20, dtype=dtype)
    omega, speed = torch.randn(2, 3, 19, 2, 3, dtype=dtype), torch.rand(2, 3, 19, 2, dtype=dtype)
    frame, origin = rotation_exp(torch.randn(2, 3, 3, dtype=dtype)), torch.randn(2, 3, 3, dtype=dtype)
    frames, x = integrate_curve(omega, speed, s.diff(), frame, origin)
    assert frames.dtype == x.dtype == dtype
    own = integrate_curve(omega[1, 2], speed[1, 2], s.diff(), frame[1, 2], origin[1, 2])
    assert torch.equal(frames[1, 2], own[0])
    assert torch.equal(x[1, 2], own[1])


def test_float32_is_close_to_float64():
    for single, double in zip(drawn(101, torch.float32)[1:], drawn(101)[1:], strict=True):
        torch.testing.assert_close(single.double(), double, rtol=0, atol=5e-6)


def test_gradients():
    steps = torch.full((3,), 0.4, dtype=torch.float64)

    def curve(omega, speed, turn, origin):
        return integrate_curve(omega, speed, steps, rotation_exp(turn), origin)

    inputs = [torch.randn(*shape, dtype=torch.float64) for shape in ((3, 2, 3), (3, 2), (3,), (3,))]
    assert torch.autograd.gradcheck(curve, [x.requires_grad_() for x in inputs])
