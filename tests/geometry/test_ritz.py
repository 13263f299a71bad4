from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from numpy.polynomial import chebyshev

from brafit.geometry.ritz import BASES, ritz_basis, ritz_sum

X = torch.linspace(0, 1, 17, dtype=torch.float64)


def test_cosine():
    expected = torch.stack([torch.cos(math.pi * k * X) for k in range(5)])
    torch.testing.assert_close(ritz_basis("cosine", 5, X), expected)


def test_fourier():
    one, sin, cos = torch.ones_like(X), torch.sin, torch.cos
    expected = [one, sin(math.pi * X), cos(math.pi * X), sin(2 * math.pi * X), cos(2 * math.pi * X)]
    torch.testing.assert_close(ritz_basis("fourier", 5, X), torch.stack(expected))
    torch.testing.assert_close(ritz_basis("fourier", 4, X), torch.stack(expected[:4]))


def test_chebyshev():
    expected = chebyshev.chebvander(2 * X.numpy() - 1, 6).T
    np.testing.assert_allclose(ritz_basis("chebyshev", 7, X), expected, atol=1e-14)


@pytest.mark.parametrize("kind", BASES)
def test_terms_are_independent_and_follow_the_type(kind, dtype):
    basis = ritz_basis(kind, 6, X.to(dtype))
    assert basis.dtype == dtype
    assert torch.linalg.matrix_rank(basis.double(), rtol=1e-3) == 6


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_sum(shape):
    basis = ritz_basis("cosine", 5, X)
    coefficients = torch.randn(*shape, 5, dtype=torch.float64)
    values = ritz_sum(coefficients, basis)
    torch.testing.assert_close(values, coefficients @ basis)
    assert torch.equal(values.reshape(-1, 17)[0], ritz_sum(coefficients.reshape(-1, 5)[0], basis))


def test_errors_name_what_is_allowed():
    with pytest.raises(ValueError, match=r"cubic.*cosine, fourier, chebyshev"):
        ritz_basis("cubic", 3, X)
    with pytest.raises(ValueError, match="at least 1 term, got 0"):
        ritz_basis("cosine", 0, X)
