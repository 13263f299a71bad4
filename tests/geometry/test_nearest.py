from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from cups import cloud, lune_frames, near
from lunes import lune_cup
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize
from surfaces import LENSES, stations

from brafit.cup.shape import CupShape
from brafit.geometry import nearest
from brafit.geometry.nearest import (
    foot_directions,
    nearest_feet,
    nearest_on_curve,
    project,
    sampled_distances,
    signed_distance,
)
from brafit.geometry.panels import Feet, Sums, sample_table, surface_normals, surface_points


def random_cup(seed: int = 0, panels: int = 2, n: int = 41) -> CupShape:
    cup = lune_frames(panels=panels, stations=n)
    return cup.shape_of(near(cup, 0.08, seed)).map(lambda v: v[0].detach())


def feet_of(points: torch.Tensor, shape: CupShape) -> Feet:
    return nearest_feet(points, shape.edges, shape.tangents, shape.stations)


def distances(points: torch.Tensor, shape: CupShape) -> torch.Tensor:
    return signed_distance(points, shape.edges, shape.tangents, shape.stations, feet_of(points, shape))


def brute_force(p: np.ndarray, shape: CupShape, longer: float = 1.0) -> tuple[float, int, float]:
    """Smallest distance, its panel and u: dense samples, then SciPy's bounded minimiser from the best of each panel.

    `longer`: rulings go on to this multiple of their length.
    """
    s = shape.stations.numpy()
    curves = [CubicHermiteSpline(s, x.numpy(), v.numpy()) for x, v in zip(shape.edges, shape.tangents, strict=True)]
    dense, u = np.linspace(s[0], s[-1], 301), np.linspace(0, longer, 31)
    best = (math.inf, -1, -1.0)
    for panel, (low, high) in enumerate(itertools.pairwise(curves)):

        def squared(z: np.ndarray, low=low, high=high) -> float:
            return float(((p - (1 - z[1]) * low(z[0]) - z[1] * high(z[0])) ** 2).sum())

        grid = (1 - u[:, None]) * low(dense)[:, None] + u[:, None] * high(dense)[:, None]
        order = np.argsort(((p - grid) ** 2).sum(-1).ravel())
        for k in order[[0, 7, 40]]:
            start = dense[k // len(u)], u[k % len(u)]
            bounds = [(s[0], s[-1]), (0, longer)]
            ending = minimize(squared, start, bounds=bounds, tol=1e-15, options={"ftol": 1e-15, "gtol": 1e-12})
            if ending.fun < best[0] ** 2:
                best = (math.sqrt(ending.fun), panel, float(ending.x[1]))
    return best


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_equals_brute_force(panels):
    shape, points = random_cup(panels, panels), cloud(24, panels)
    feet = feet_of(points, shape)
    ours = (points - surface_points(shape.edges, shape.tangents, shape.stations, feet)).norm(dim=-1)
    truth = np.array([brute_force(p, shape)[0] for p in points.numpy()])
    np.testing.assert_allclose(ours, truth, rtol=0, atol=2e-7)
    assert (ours.numpy() <= truth + 1e-12).all()
    on_rim = ((feet.panel == 0) & (feet.u == 0)) | ((feet.panel == panels - 1) & (feet.u == 1))
    assert on_rim.any()
    assert not on_rim.all()


@pytest.mark.parametrize("name", LENSES)
def test_points_off_an_exact_surface_have_the_known_feet(name):
    """p = X(s, u) + h eta at stations and between them, on both sides."""
    p = LENSES[name](stations(101))
    picks, between = torch.arange(10, 91, 5), LENSES[name](stations(201))
    u = torch.linspace(0.1, 0.9, len(picks), dtype=torch.float64)
    for fine, places in ((p, picks), (between, 2 * picks + 1)):
        x = torch.lerp(fine.lower[places], fine.upper[places], u[:, None])
        for height in (0.05, -0.05):
            points = x + height * fine.normals[places]
            feet = feet_of(points, p.shape)
            torch.testing.assert_close(feet.arc(p.s), fine.s[places], rtol=0, atol=1e-5)
            torch.testing.assert_close(feet.u, u, rtol=0, atol=1e-5)
            torch.testing.assert_close(distances(points, p.shape), torch.full_like(u, height), rtol=0, atol=1e-6)
            normal = surface_normals(p.shape.edges, p.shape.tangents, p.s, feet)
            torch.testing.assert_close(normal, fine.normals[places], rtol=0, atol=1e-4)


def test_directions_are_the_differences_own():
    shape, points = random_cup(3), cloud(300, 3)
    feet = feet_of(points, shape)
    m = foot_directions(points, shape.edges, shape.tangents, shape.stations, feet)
    delta = points - surface_points(shape.edges, shape.tangents, shape.stations, feet)
    torch.testing.assert_close(m.norm(dim=-1), torch.ones(300, dtype=torch.float64))
    torch.testing.assert_close((m * delta).sum(-1).abs(), delta.norm(dim=-1), rtol=1e-9, atol=0)


def test_outside_is_positive():
    shape = lune_cup(2, 101, 1.0)
    centre = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    direction = torch.nn.functional.normalize(torch.rand(50, 3, dtype=torch.float64) + 0.1, dim=-1)
    assert (distances(centre + 1.3 * direction, shape) > 0.1).all()
    assert (distances(centre + 0.7 * direction, shape) < -0.1).all()


def test_a_point_on_the_surface_has_distance_zero_and_a_gradient():
    shape = lune_cup(1, 41, 1.0)
    points = 0.5 * (shape.edges[0, 5:35:5] + shape.edges[1, 5:35:5])
    edges = shape.edges.clone().requires_grad_()
    own = signed_distance(points, edges, shape.tangents, shape.stations, feet_of(points, shape))
    torch.testing.assert_close(own.detach(), torch.zeros(6, dtype=torch.float64), rtol=0, atol=1e-12)
    (gradient,) = torch.autograd.grad(own.sum(), edges)
    assert gradient.isfinite().all()
    assert gradient.abs().max() > 0.1


def paper_rule(p: np.ndarray, shape: CupShape) -> int:
    """The paper's classing: project onto the lower panel, rulings prolonged; t* < t_max puts the point in D_L."""
    lower = CupShape(
        shape.stations, shape.edges[:2], shape.tangents[:2], shape.directions[:1], shape.normals[:1], shape.geodesic[:1]
    )
    return 0 if brute_force(p, lower, longer=3.0)[2] < 1 else 1


def test_the_papers_classing_is_the_nearest_panel():
    """For points that project into a panel, t* against t_max, the nearest panel and the true panel agree."""
    shape = lune_cup(2, 61, 1.0)
    generator = np.random.default_rng(1)
    panel = generator.integers(2, size=40)
    station, u = generator.integers(12, 49, size=40), generator.uniform(0.1, 0.9, size=40)
    on = torch.lerp(shape.edges[panel, station], shape.edges[panel + 1, station], torch.from_numpy(u)[:, None])
    points = on + torch.from_numpy(generator.uniform(0, 0.1, size=(40, 1))) * shape.normals[panel, station]
    feet = feet_of(points, shape)
    assert feet.panel.tolist() == panel.tolist()
    assert ((feet.u > 0) & (feet.u < 1)).all()
    assert [paper_rule(p, shape) for p in points.numpy()] == panel.tolist()


def test_envelope_gradients_against_central_differences():
    """The derivative through the fixed foot is that of the distance with a new search."""
    shape, points = random_cup(5), cloud(200, 5)
    edges, tangents = shape.edges.clone().requires_grad_(), shape.tangents.clone().requires_grad_()
    own = signed_distance(points, edges, tangents, shape.stations, feet_of(points, shape))
    weights = torch.randn(200, dtype=torch.float64)
    along = torch.randn(2, *edges.shape, dtype=torch.float64)
    gradients = torch.autograd.grad((weights * own).sum(), (edges, tangents))

    def value(h: float, along: torch.Tensor) -> float:
        e, v = shape.edges + h * along[0], shape.tangents + h * along[1]
        feet = nearest_feet(points, e, v, shape.stations, iterations=10)
        return (weights * signed_distance(points, e, v, shape.stations, feet)).sum().item()

    h = 1e-6
    difference = (value(h, along) - value(-h, along)) / (2 * h)
    analytic = sum((g * a).sum().item() for g, a in zip(gradients, along, strict=True))
    assert analytic == pytest.approx(difference, rel=1e-6)


def test_jacobian_is_the_derivative_of_the_distances():
    shape, points = random_cup(6), cloud(30, 6)
    feet = feet_of(points, shape)
    table = torch.randn(4 * 41 + 2 * 41, 3, 5, dtype=torch.float64)
    edges, tangents = shape.edges, shape.tangents
    assert sample_table(edges, tangents).shape[0] == len(table)
    step = table.movedim(-1, 0).unflatten(1, (2, 3, 41))

    def moved(a: torch.Tensor) -> torch.Tensor:
        change = torch.einsum("a,atekc->tekc", a, step)
        return signed_distance(points, edges + change[0], tangents + change[1], shape.stations, feet)

    expected = torch.autograd.functional.jacobian(moved, torch.zeros(5, dtype=torch.float64))
    m = foot_directions(points, edges, tangents, shape.stations, feet)
    sums = Sums.of(m, feet, shape.stations, 3)
    torch.testing.assert_close(sums.jacobian(table), expected)
    force = torch.randn(30, dtype=torch.float64)
    torch.testing.assert_close(sums.gradient(force, table), force @ expected)


def test_feet_are_the_same_at_other_stations():
    """A foot on a cup of 41 stations, and where it is among 16 others: the same place on the wire."""
    shape, points = random_cup(4), cloud(50, 4)
    feet = feet_of(points, shape)
    others = torch.linspace(0, 1, 16, dtype=torch.float64) ** 2 * shape.stations[-1]
    moved = feet.on(shape.stations, others)
    torch.testing.assert_close(moved.arc(others), feet.arc(shape.stations))
    assert moved.interval.max() <= 14
    assert torch.equal(moved.panel, feet.panel)


def test_chunks_do_not_change_results(monkeypatch):
    shape, points = random_cup(7), cloud(101, 7)
    whole = feet_of(points, shape)
    monkeypatch.setattr(nearest, "CHUNK", 500)
    parts = feet_of(points, shape)
    assert torch.equal(whole.panel, parts.panel)
    assert torch.equal(whole.interval, parts.interval)
    torch.testing.assert_close(parts.tau, whole.tau, rtol=0, atol=1e-12)
    torch.testing.assert_close(parts.u, whole.u, rtol=0, atol=1e-12)


def test_memory_is_bounded_by_the_chunk(monkeypatch):
    """No tensor of the search holds more than about CHUNK distances, whatever the number of points."""
    shape, points = random_cup(8), cloud(3000, 8)
    monkeypatch.setattr(nearest, "CHUNK", 2000)
    largest, real = 0, torch.baddbmm

    def watched(*args, **kwargs):
        nonlocal largest
        result = real(*args, **kwargs)
        largest = max(largest, result.numel())
        return result

    monkeypatch.setattr(torch, "baddbmm", watched)
    sampled_distances(points, shape.edges)
    assert 0 < largest <= 2000


def test_each_cup_of_a_batch_is_as_if_alone():
    shapes = [random_cup(seed) for seed in range(4)]
    clouds = [cloud(60, seed) for seed in range(4)]
    edges, tangents = (torch.stack([getattr(s, k) for s in shapes]).unflatten(0, (2, 2)) for k in ("edges", "tangents"))
    points, grid = torch.stack(clouds).unflatten(0, (2, 2)), shapes[0].stations
    feet = nearest_feet(points, edges, tangents, grid)
    together = signed_distance(points, edges, tangents, grid, feet).flatten(0, 1)
    for k in range(4):
        torch.testing.assert_close(together[k], distances(clouds[k], shapes[k]), rtol=0, atol=1e-13)


def test_follows_type_and_device(dtype, device):
    shape, points = random_cup(9), cloud(100, 9)
    expected = distances(points, shape)
    grid = shape.stations.to(device, dtype)
    edges, tangents, points = (x.to(device, dtype) for x in (shape.edges, shape.tangents, points))
    feet = nearest_feet(points, edges, tangents, grid)
    own = signed_distance(points, edges, tangents, grid, feet)
    assert own.dtype == dtype
    tolerance = 1e-12 if dtype == torch.float64 else 1e-5
    own = own.cpu().double()
    torch.testing.assert_close(own.abs(), expected.abs(), rtol=0, atol=tolerance)
    inside = (
        (feet.u > 0) & (feet.u < 1)
    ).cpu()  # beyond the rim, near the tangent plane, the sign is a matter of rounding
    assert inside.any()
    torch.testing.assert_close(own[inside], expected[inside], rtol=0, atol=tolerance)


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_feet_that_are_followed_are_those_of_a_search(panels):
    """On a cup that has moved, over stations and ridges. Where the nearest foot leaps, the one that is followed lies
    no more than twice the movement further away.
    """
    cup = lune_frames(panels=panels, stations=41)
    first, moved = (cup.shape_of(near(cup, 0.08, 3) * (1 + k)).map(lambda v: v[0].detach()) for k in (0, 4e-3))
    points = cloud(2000, 11)
    searched = project(points, moved.edges, moved.tangents, moved.stations, 10)
    followed = project(points, moved.edges, moved.tangents, moved.stations, 2, near=feet_of(points, first))
    excess = followed.distances.abs() - searched.distances.abs()
    assert excess.min() > -1e-6
    assert excess.max() < 2 * (moved.edges - first.edges).norm(dim=-1).max() + 1e-6
    assert (excess < 1e-6).double().mean() > 0.95
    before = feet_of(points, first)
    assert (before.interval != searched.feet.interval).any()
    if panels > 1:
        assert (before.panel != searched.feet.panel).any()
        assert (followed.feet.panel == searched.feet.panel).double().mean() > 0.95


def test_nearest_on_a_curve_is_scipys():
    shape, points = random_cup(12), cloud(40, 12)
    for line, slopes in zip(shape.edges, shape.tangents, strict=True):
        interval, tau = nearest_on_curve(points, line, slopes, shape.stations)
        s = shape.stations.numpy()
        curve = CubicHermiteSpline(s, line.numpy(), slopes.numpy())
        own = s[interval] + tau.numpy() * np.diff(s)[interval]
        dense = np.linspace(s[0], s[-1], 20001)
        least = np.linalg.norm(points.numpy()[:, None] - curve(dense)[None], axis=-1).min(1)
        np.testing.assert_allclose(np.linalg.norm(points.numpy() - curve(own), axis=-1), least, rtol=0, atol=1e-7)
