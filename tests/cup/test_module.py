"""A cup as a module: points in, signed distances out, both in millimetres, with derivatives."""

from __future__ import annotations

import copy
import math
import pickle
from functools import partial

import numpy as np
import pytest
import torch
from cups import near
from lunes import RADIUS, lune_cup, lune_flat, sphere_points
from torch import Tensor

from brafit.cup import Cup, FramesCup, StripsCup, Wire
from brafit.fitting.measure import in_millimetres

ANGLE = np.linspace(0, np.pi, 200)
LINE = RADIUS * np.stack((np.sin(ANGLE), 1 - np.cos(ANGLE), 0 * ANGLE), axis=-1)
"""The half circle."""
OVAL = 0.7 * LINE * (1.2, 1.0, 1.0) + np.stack((0 * ANGLE, 0 * ANGLE, 4 * np.sin(ANGLE) ** 2), axis=-1)
"""A smaller wire, which is not planar."""
STRIPS = partial(StripsCup, terms=5, nodes=24, output_nodes=48, stations=61)
FRAMES = partial(FramesCup, terms=4, stations=61)
models = pytest.mark.parametrize("model", [STRIPS, FRAMES], ids=["strips", "frames"])


def cup_of(model, panels: int = 2, lines: np.ndarray | None = None) -> Cup:
    """Cups a little off plain ones."""
    cup = model(np.stack((LINE, OVAL)) if lines is None else lines, panels=panels)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(cup.batch, -1), torch.full((cup.batch, panels), 1.0, dtype=torch.float64))
    order = torch.randn(cup.size, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    cup.load_flat(cup.flatten().detach() + 0.02 * order * cup.steps)
    return cup


def clouds(count: int = 25) -> Tensor:
    """Points about both wires' cups, inside and outside, beyond the rim too."""
    ball = torch.from_numpy(sphere_points(2 * count)[0]).view(2, count, 3)
    away = 1 + 0.2 * torch.randn(2, count, 1, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return ball * away * torch.tensor([1.0, 0.7], dtype=torch.float64)[:, None, None]


def test_distances_of_a_known_cup_are_in_millimetres():
    """In its plane of symmetry the cup is a polygon around the circle's arc: R (cos - cos(pi / 8)) from its sides."""
    cup = FramesCup(LINE, panels=2, stations=201)
    right = torch.tensor([[math.pi / 4, math.pi / 2]], dtype=torch.float64)
    cup.start(right, torch.ones_like(right))
    a = np.linspace(0.01, np.pi / 2 - 0.01, 40)
    points = RADIUS * np.stack((np.cos(a), np.ones(40), np.sin(a)), axis=1)
    known = RADIUS * (np.cos(np.abs(a % (np.pi / 4) - np.pi / 8)) - np.cos(np.pi / 8))
    np.testing.assert_allclose(cup(torch.from_numpy(points)[None])[0].detach(), known, atol=5e-3)
    np.testing.assert_allclose(cup.shape().edges[0].detach(), lune_cup(2, 201).edges, atol=5e-3)
    flat = lune_flat(2, 201)[0]
    width = (cup.patterns().lower[0, :, -1] - cup.patterns().lower[0, :, 0]).norm(dim=-1)
    torch.testing.assert_close(width, (flat.lower[-1] - flat.lower[0]).norm().expand(2), rtol=1e-5, atol=0)
    torch.testing.assert_close(cup.margin(), torch.ones(1, 2, 201, dtype=torch.float64), rtol=0, atol=1e-4)


@models
def test_shape_patterns_and_margin_are_those_of_the_fit(model):
    cup = cup_of(model)
    shape, patterns, scale = cup.shape(), cup.patterns(), cup.wire.scale.tolist()
    for k in range(2):
        known = in_millimetres(cup.shape_of(cup.flatten()).map(lambda v, k=k: v[k]), scale[k])
        assert torch.allclose(shape.edges[k], known.edges, rtol=0, atol=1e-9)
        assert torch.allclose(shape.geodesic[k], known.geodesic, rtol=0, atol=1e-12)
        assert torch.allclose(cup.margin()[k], known.margin, rtol=0, atol=1e-12)
        assert torch.allclose(patterns.lower[k], known.flat().lower, rtol=0, atol=1e-9)
        assert torch.allclose(patterns.upper[k], known.flat().upper, rtol=0, atol=1e-9)
        assert torch.allclose(cup(clouds())[k], known.distances(clouds()[k]), rtol=0, atol=1e-9)


def slope(cup: Cup, function, direction: Tensor, h: float = 1e-6) -> Tensor:
    """Central difference of a function of the cup, along a direction of its parameters."""
    flat = cup.flatten().detach()
    values = []
    for step in (h, -h):
        cup.load_flat(flat + step * direction)
        values.append(function(cup).detach())
    cup.load_flat(flat)
    return (values[0] - values[1]) / (2 * h)


def by_parameters(cup: Cup, value: Tensor) -> Tensor:
    """Derivatives of a number by what `flatten` gives."""
    parts = torch.autograd.grad(value, [cup.get_parameter(name) for name in cup.layout])
    return torch.cat([part.flatten(1) for part in parts], dim=1) / cup.steps


@models
def test_derivatives_by_every_parameter_are_central_differences(model):
    cup, points = cup_of(model), clouds()
    own = by_parameters(cup, cup(points).sin().sum())
    for column in range(cup.size):
        direction = torch.zeros_like(own)
        direction[:, column] = 1
        known = slope(cup, lambda cup: cup(points).sin().sum(1), direction)
        torch.testing.assert_close(own[:, column], known, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize(
    "output",
    [
        lambda cup: cup(clouds()),
        lambda cup: cup.shape().edges,
        lambda cup: torch.stack((cup.patterns().lower, cup.patterns().upper)),
        lambda cup: cup.margin(),
    ],
    ids=["distances", "edges", "patterns", "margin"],
)
@pytest.mark.parametrize("panels", [1, 3])
@models
def test_derivatives_of_every_output_are_central_differences(model, panels, output):
    cup = cup_of(model, panels)
    values = output(cup)
    generator = torch.Generator().manual_seed(1)
    pull = torch.randn(values.shape, generator=generator, dtype=values.dtype)
    own = by_parameters(cup, (pull * values).sum())
    assert (own != 0).all()
    for _ in range(2):
        direction = torch.randn(own.shape, generator=generator, dtype=own.dtype) * cup.steps
        known = (pull * slope(cup, output, direction)).sum()
        torch.testing.assert_close((own * direction).sum(), known, rtol=1e-6, atol=1e-5)


@models
def test_derivatives_by_the_points_are_central_differences(model):
    cup, points = cup_of(model), clouds().requires_grad_()
    (gradient,) = torch.autograd.grad(cup(points).sum(), points)
    h = 1e-5
    for axis in range(3):
        step = torch.zeros(3, dtype=torch.float64)
        step[axis] = h
        known = (cup(points + step) - cup(points - step)).detach() / (2 * h)
        assert torch.allclose(gradient[..., axis], known, rtol=0, atol=1e-6)
    assert torch.allclose(gradient.norm(dim=-1), torch.ones(2, 25, dtype=torch.float64), rtol=0, atol=1e-6)


def test_distances_of_a_shape_have_derivatives():
    """The obvious road too: a loss made of it does not stand still."""
    cup = cup_of(STRIPS)
    cup.shape().distances(clouds()).square().mean().backward()
    gradient = cup.get_parameter("length").grad
    assert gradient is not None
    assert (gradient[..., 0] != 0).all()
    with torch.no_grad():
        assert torch.allclose(cup.shape().distances(clouds()), cup(clouds()), rtol=0, atol=1e-11)


@models
def test_each_cup_is_as_if_alone(model):
    cup, points = cup_of(model), clouds()
    together = cup(points)
    together.square().sum().backward()
    for k in range(2):
        alone = cup.select(torch.tensor([k]))
        distances = alone(points[k : k + 1])
        assert torch.allclose(distances[0], together[k], rtol=0, atol=1e-11)
        distances.square().sum().backward()
        for name, parameter in alone.named_parameters():
            whole = cup.get_parameter(name).grad
            assert whole is not None
            assert parameter.grad is not None
            assert torch.allclose(parameter.grad[0], whole[k], rtol=1e-9, atol=1e-9), name


@models
def test_padding_has_no_distance_and_no_pull(model):
    cup, points = cup_of(model), clouds()
    padded = torch.cat((points, torch.full((2, 7, 3), torch.nan, dtype=torch.float64)), dim=1).requires_grad_()
    distances = cup(padded)
    assert distances[:, -7:].isnan().all()
    assert torch.equal(distances[:, :-7], cup(points))
    gradients = []
    for loss in (distances.square().nanmean(), cup(points).square().mean()):
        cup.zero_grad()
        loss.backward()
        gradients.append([p.grad.clone() for p in cup.parameters() if p.grad is not None])
    for own, known in zip(*gradients, strict=True):
        torch.testing.assert_close(own, known, rtol=1e-12, atol=1e-12)
    assert padded.grad is not None
    assert (padded.grad[:, -7:] == 0).all()


@models
def test_no_points_no_distances(model):
    assert cup_of(model)(torch.empty(2, 0, 3, dtype=torch.float64)).shape == (2, 0)


@models
def test_precision_and_place(model, dtype, device):
    cup = cup_of(model).to(device, dtype)
    points = clouds().to(device, dtype)
    distances = cup(points)
    assert (distances.dtype, distances.device.type) == (dtype, device.type)
    distances.square().mean().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in cup.parameters())
    assert torch.allclose(distances.cpu().double(), cup_of(model)(clouds()), rtol=0, atol=2e-2)
    assert cup.patterns().upper.dtype == cup.margin().dtype == dtype


@models
def test_copies_and_states_keep_the_cup(model, tmp_path):
    cup, points = cup_of(model), clouds()
    known = cup(points)
    torch.save(cup, tmp_path / "cup.pt")
    loaded = torch.load(tmp_path / "cup.pt", weights_only=False)
    for other in (copy.deepcopy(cup), pickle.loads(pickle.dumps(cup)), loaded):
        assert torch.equal(other(points), known)
        other.load_flat(near(other))  # a copy of its own
    assert torch.equal(cup(points), known)


@models
def test_a_state_brings_its_wires(model):
    """A cup on other wires that loads a state is that state's cup, not its parameters on the old wires."""
    cup, other = cup_of(model), cup_of(model, lines=np.stack((OVAL, OVAL)))
    other.load_state_dict(cup.state_dict())
    assert torch.equal(other(clouds()), cup(clouds()))
    assert torch.equal(other.sketch(other.flatten()).edges, cup.sketch(cup.flatten()).edges)


@models
def test_parameters_are_held_in_steps_that_round_nothing(model):
    cup = cup_of(model)
    mantissa, _ = torch.frexp(cup.steps)
    assert (mantissa == 0.5).all()
    flat = near(cup)
    cup.load_flat(flat)
    assert torch.equal(cup.flatten(), flat)


@models
def test_wires_of_every_kind_make_the_same_cup(model):
    known = model(Wire.from_polyline(LINE)).state_dict()
    for line in (LINE, LINE[None], LINE.tolist(), torch.from_numpy(LINE), Wire.from_polyline(LINE)):
        own = model(line).state_dict()
        assert all(torch.equal(own[name], value) for name, value in known.items())
    assert model(torch.from_numpy(LINE).float()).stations.dtype == torch.float32
    assert model(np.stack((LINE, OVAL))).batch == 2


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        (LINE[:, :2], "shape"),
        (LINE[:3], "at least 4 distinct points"),
        ([LINE.tolist(), LINE[:50].tolist()], "shape"),
        (np.where(np.arange(200)[:, None] == 7, np.nan, LINE), "not finite"),
        (LINE + np.array([10.0, 0, 0]), "not in the cup frame"),
        (LINE[:, [1, 0, 2]], "not in the cup frame"),
        (LINE[::-1] - LINE[-1], "not in the cup frame"),
        (LINE * (-1, 1, 1), "not in the cup frame"),
        (torch.from_numpy(LINE).requires_grad_(), "no derivatives by its wire"),
    ],
)
def test_what_is_no_wire_is_refused(line, cause):
    with pytest.raises(ValueError, match=cause):
        StripsCup(line)


@models
def test_what_are_no_points_of_these_cups_is_refused(model):
    cup = cup_of(model)
    for points in (clouds()[0], clouds()[:1], clouds()[..., :2]):
        with pytest.raises(ValueError, match=r"points must be \(2, n, 3\)"):
            cup(points)
    with pytest.raises(ValueError, match=r"give points.to\(cup.stations\)"):
        cup(clouds().float())
