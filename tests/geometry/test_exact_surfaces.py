"""The closed forms of tests/surfaces.py against the definitions, by finite differences: they judge everything else."""

from __future__ import annotations

import pytest
import torch
from surfaces import LENSES, stations


@pytest.fixture(params=LENSES)
def make(request: pytest.FixtureRequest):
    return LENSES[request.param]


def frames(p) -> torch.Tensor:
    zeta = p.lower_tangent / p.lower_tangent.norm(dim=-1, keepdim=True)
    return torch.stack((torch.linalg.cross(p.normals, zeta), p.normals, zeta), dim=-1)


def test_rates_are_those_of_the_turning_frame(make):
    """(1), (2): F' = F Omega, with M = xi'.eta = +omega_zeta."""
    s, h = stations(12)[1:-1], 1e-5
    frame = frames(make(s))
    turning = (frames(make(s + h)) - frames(make(s - h))) / (2 * h)
    rates = (frame.mT @ turning) / make(s).lower_tangent.norm(dim=-1)[:, None, None]
    xi, eta, zeta = make(s).omega.unbind(-1)
    zero = torch.zeros_like(xi)
    expected = torch.stack((zero, -zeta, eta, zeta, zero, -xi, -eta, xi, zero), dim=-1).unflatten(-1, (3, 3))
    torch.testing.assert_close(rates, expected, rtol=0, atol=1e-8)


def test_edges_have_their_tangents_and_keep_lengths_and_angles_when_flat(make):
    s, h = stations(12)[1:-1], 1e-5
    here, before, after = make(s), make(s - h), make(s + h)
    for edge in ("lower", "upper"):
        difference = (getattr(after, edge) - getattr(before, edge)) / (2 * h)
        torch.testing.assert_close(difference, getattr(here, f"{edge}_tangent"), rtol=0, atol=1e-8)
    s = stations(4001)
    p = make(s)
    for edge, flat in ((p.lower, p.flat_lower), (p.upper, p.flat_upper)):
        torch.testing.assert_close(flat.diff(dim=0).norm(dim=-1), edge.diff(dim=0).norm(dim=-1), rtol=1e-6, atol=0)
    torch.testing.assert_close((p.flat_upper - p.flat_lower).norm(dim=-1), p.lengths)
    diagonal = (p.upper[1:] - p.lower[:-1]).norm(dim=-1)
    torch.testing.assert_close((p.flat_upper[1:] - p.flat_lower[:-1]).norm(dim=-1), diagonal, rtol=1e-5, atol=1e-8)


def test_edges_meet_at_both_ends(make):
    p = make(stations(9))
    torch.testing.assert_close(p.lower[[0, -1]], p.upper[[0, -1]])
    assert p.lengths[1:-1].min() > 0.1
