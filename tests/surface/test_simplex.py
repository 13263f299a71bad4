from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from brafit.surface.simplex import minimised


def valley(v: np.ndarray) -> np.ndarray:
    """Rosenbrock's, of many points at once."""
    return (100 * (v[:, 1:] - v[:, :-1] ** 2) ** 2 + (1 - v[:, :-1]) ** 2).sum(axis=1)


def steps(v: np.ndarray) -> np.ndarray:
    """With plateaus, on which a simplex shrinks."""
    return np.floor(4 * np.abs(v)).sum(axis=1)


@pytest.mark.parametrize("loss", [valley, steps])
@pytest.mark.parametrize("rounds", [3, 60, 400])
def test_each_start_leads_where_scipy_leads(loss, rounds):
    starts = np.random.default_rng(0).uniform(-1.5, 1.5, (8, 3))
    starts[0, 1] = 0.0
    found = minimised(loss, starts, xatol=1e-3, fatol=1e-6, rounds=rounds)
    options = {"xatol": 1e-3, "fatol": 1e-6, "maxiter": rounds}
    for start, end in zip(starts, found, strict=True):
        expected = minimize(lambda v: loss(v[None])[0], start, method="Nelder-Mead", options=options)
        np.testing.assert_allclose(end, expected.x, atol=1e-9)
