from __future__ import annotations

import math

import numpy as np
import pytest
import roma
import torch
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from brafit.geometry.curve import prefix_motions
from brafit.geometry.rotation import apply, motion_exp, product, rotation_exp, sinc_terms, skew

ANGLES = (0.0, 1e-12, 1e-6, 1e-3, 0.0999, 0.1, 0.1001, 1.0, 3.0, math.pi, 6.5)


def rotvecs(dtype: torch.dtype = torch.float64) -> torch.Tensor:
    axes = torch.nn.functional.normalize(torch.randn(len(ANGLES), 3, dtype=torch.float64), dim=-1)
    return (axes * torch.tensor(ANGLES, dtype=torch.float64)[:, None]).to(dtype)


def motion(rotvec: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Generator of a motion, (4, 4)."""
    matrix = torch.zeros(4, 4, dtype=rotvec.dtype)
    matrix[:3, :3], matrix[:3, 3] = skew(rotvec), shift
    return matrix


def test_rotations_agree_with_roma_and_scipy(dtype, device):
    v = rotvecs(dtype).to(device)
    ours = rotation_exp(v)
    assert ours.dtype == dtype
    assert ours.device == v.device
    tolerance = {"rtol": 0, "atol": 1e-14 if dtype == torch.float64 else 2e-6}
    torch.testing.assert_close(ours, roma.rotvec_to_rotmat(v), **tolerance)
    independent = torch.from_numpy(Rotation.from_rotvec(v.cpu().double().numpy()).as_matrix())
    torch.testing.assert_close(ours.cpu().double(), independent, **tolerance)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,)])
def test_any_batch_shape(shape, dtype):
    v, w = torch.randn(*shape, 3, dtype=dtype), torch.randn(*shape, 3, dtype=dtype)
    rotation, translation = motion_exp(v, w)
    assert rotation.shape == (*shape, 3, 3)
    assert translation.shape == (*shape, 3)
    if v.numel():
        one = motion_exp(v.reshape(-1, 3)[0], w.reshape(-1, 3)[0])
        assert torch.equal(rotation.reshape(-1, 3, 3)[0], one[0])
        assert torch.equal(translation.reshape(-1, 3)[0], one[1])


def test_motions_are_the_matrix_exponential():
    for v in rotvecs():
        shift = torch.randn(3, dtype=torch.float64)
        rotation, translation = motion_exp(v, shift)
        whole = torch.from_numpy(expm(motion(v, shift).numpy()))
        torch.testing.assert_close(rotation, whole[:3, :3], rtol=0, atol=1e-13)
        torch.testing.assert_close(translation, whole[:3, 3], rtol=0, atol=1e-13)


def test_series_join_the_closed_forms_without_a_step():
    squared = torch.tensor([1e-2 * (1 - 1e-13), 1e-2 * (1 + 1e-13)], dtype=torch.float64)
    for term in sinc_terms(squared):
        torch.testing.assert_close(term[0], term[1], rtol=1e-13, atol=0)


def test_orthonormal_to_round_off_after_many_steps(dtype):
    steps = 10_000
    rotation = rotation_exp(0.3 * torch.randn(steps, 3, dtype=dtype))
    frames, _ = prefix_motions(rotation, torch.zeros(steps, 3, dtype=dtype))
    error = (frames.mT @ frames - torch.eye(3, dtype=dtype)).abs().max().item()
    assert error < 200 * torch.finfo(dtype).eps
    assert (torch.linalg.det(frames) > 0.99).all()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.0999, 0.1001, 2.0])
def test_first_and_second_derivatives(angle):
    v = torch.tensor([0.6, -0.48, 0.64], dtype=torch.float64) * angle
    inputs = (v.requires_grad_(), torch.randn(3, dtype=torch.float64, requires_grad=True))
    assert torch.autograd.gradcheck(motion_exp, inputs)
    assert torch.autograd.gradgradcheck(motion_exp, inputs)


def test_derivatives_at_zero_rotation_are_the_known_ones():
    """exp(v) = 1 + [v] + [v][v]/2 + ...: first derivatives [e_i], second ([e_i][e_j] + [e_j][e_i]) / 2."""
    zero = torch.zeros(3, dtype=torch.float64)
    generators = skew(torch.eye(3, dtype=torch.float64))
    first = torch.func.jacfwd(rotation_exp)(zero).movedim(-1, 0)
    torch.testing.assert_close(first, generators, rtol=0, atol=1e-15)
    second = torch.func.jacfwd(torch.func.jacfwd(rotation_exp))(zero).movedim((-2, -1), (0, 1))
    products = generators[:, None] @ generators[None]
    torch.testing.assert_close(second, (products + products.transpose(0, 1)) / 2, rtol=0, atol=1e-15)


def test_small_products():
    a, b = torch.randn(4, 3, 3, dtype=torch.float64), torch.randn(4, 3, 5, dtype=torch.float64)
    torch.testing.assert_close(product(a, b), a @ b)
    torch.testing.assert_close(apply(a, b[..., 0]), (a @ b)[..., 0])
    v, u = torch.randn(2, 4, 3, dtype=torch.float64)
    np.testing.assert_allclose(apply(skew(v), u), np.cross(v, u))
