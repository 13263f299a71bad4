from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from cups import half_circle

from brafit.cup import Cup, StripsCup, Wire
from brafit.cup.plain import HEIGHT
from brafit.geometry.developable import regularity, twist_angle
from brafit.geometry.grid import sliding_derivative


def straight_ended() -> Wire:
    """A wire whose ends are straight: an arc between two tangents."""
    angle = np.linspace(-1.2, 1.2, 60)
    arc = 60 * np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    along = np.array([-math.sin(1.2), math.cos(1.2), 0.0])
    out = arc[-1] + np.linspace(2, 30, 15)[:, None] * along
    into = out[::-1] * np.array([1.0, -1.0, 1.0])
    return Wire.from_polyline(np.concatenate((into, arc, out)) - into[0])


WIRES = {
    "half circle": half_circle(),
    "helix": Wire.from_omega((0.2, 0.9, 0.15), math.pi),
    "straight ends": straight_ended(),
}


def wavy(wire: Wire, panels: int, batch: int = 1, terms: int = 6, **options: int) -> tuple[StripsCup, torch.Tensor]:
    """Cups and parameters beside a plain start, the higher terms the smaller."""
    cup = StripsCup(wire.select(torch.zeros(batch, dtype=torch.long)), panels, terms, **options)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(batch, -1), torch.full((batch, panels), 0.8, dtype=torch.float64))
    with torch.no_grad():  # plain rulings, so that the nodes resolve what the noise makes of them
        cup.rib.zero_()
        cup.length[..., 1:] = 0
    noise = torch.randn(batch, cup.size, generator=torch.Generator().manual_seed(panels), dtype=torch.float64)
    order = torch.arange(terms, dtype=torch.float64)
    order = torch.cat((torch.zeros(panels), order.repeat(2 * panels), torch.zeros(3)))
    return cup, cup.flatten().detach() + 0.06 * noise / (1 + order**2)


@pytest.mark.parametrize("panels", [1, 2, 3, 4])
@pytest.mark.parametrize("wire", WIRES.values(), ids=WIRES)
def test_panels_are_developable_between_the_nodes(wire, panels):
    """Normals at the two ends of every ruling agree, by tangents measured from the edges alone."""
    cup, flat = wavy(wire, panels)
    flat[:, -3:] = 0  # a corner has no tangent to measure
    if panels == 1:
        flat[:, 0] = math.pi / 2  # straight up: leaning in, its rulings would cross
    shape = cup.shape_of(flat)
    assert regularity(shape.tangents[:, :-1], shape.tangents[:, 1:], shape.directions).min() > 0.1
    tangents = sliding_derivative(shape.edges, shape.stations)
    assert torch.allclose(tangents, shape.tangents, rtol=0, atol=1e-4)
    inner = slice(4, -4)
    twist = twist_angle(tangents[:, :-1, inner], tangents[:, 1:, inner], shape.directions[:, :, inner])
    assert torch.rad2deg(twist).max() < 1e-3


def test_half_cylinder_comes_out_exactly():
    """One panel that leaves the half circle straight up, with rulings at right angles, is a cylinder."""
    cup = StripsCup(half_circle(), panels=1, terms=3)
    cup.start(torch.tensor([[0.5]], dtype=torch.float64), torch.tensor([[1.0]], dtype=torch.float64))
    cup.load_flat(torch.tensor([[math.pi / 2, 0, 0, 0, 0.3, 0, 0, 0, 0, 0]], dtype=torch.float64))
    shape = cup.shape()
    height = math.exp(0.3) * (1 - (2 * cup.stations / math.pi - 1) ** 2)
    assert torch.allclose(shape.edges[0, 1, :, :2], shape.edges[0, 0, :, :2], rtol=0, atol=1e-12)
    assert torch.allclose(shape.edges[0, 1, :, 2], height, rtol=0, atol=1e-12)


def test_start_puts_the_middle_of_each_edge_where_it_is_told():
    cup = StripsCup(half_circle(), panels=2, terms=4, nodes=49)
    angles = torch.tensor([[0.7, 1.5]], dtype=torch.float64)
    reaches = torch.tensor([[1.1, 0.9]], dtype=torch.float64)
    cup.start(angles, reaches)
    middle = cup.shape().edges[0, 1:, 100]
    expected = torch.stack((reaches * torch.cos(angles), torch.ones_like(angles), reaches * torch.sin(angles)), dim=-1)
    assert torch.allclose(middle, expected[0], rtol=0, atol=0.05)  # a plain cup's ridge leans a little there


@pytest.mark.parametrize("terms", [None, 4, 6])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_closed_form_derivatives_are_those_of_forward_mode(panels, terms):
    cup, flat = wavy(WIRES["helix"], panels, batch=2, terms=7, nodes=96)
    own, other = cup.linearise(flat, terms), Cup.linearise(cup, flat, terms)
    order = own.columns.argsort()
    assert torch.equal(own.columns[order], other.columns)
    for name in ("table", "margin_columns"):
        assert torch.allclose(getattr(own, name)[..., order], getattr(other, name), rtol=0, atol=1e-10), name
    size = other.unfairness_columns.abs().max()  # third derivatives: less is resolved
    assert (own.unfairness_columns[..., order] - other.unfairness_columns).abs().max() < 1e-8 * size
    assert torch.allclose(own.margin, other.margin, rtol=0, atol=1e-12)
    assert torch.allclose(own.unfairness, other.unfairness, rtol=0, atol=1e-10)


def test_only_the_upper_edge_has_the_corner():
    cup, flat = wavy(half_circle(), 2, stations=2001)
    flat[:, -3:] = 0
    bent = flat.clone()
    bent[:, -3:] = torch.tensor([-1.5, 0.8, 0.2])
    smooth, shape = cup.shape_of(flat), cup.shape_of(bent)
    assert torch.equal(smooth.edges[:, :2], shape.edges[:, :2])
    turn = shape.tangents[0, 2] / shape.tangents[0, 2].norm(dim=-1, keepdim=True)
    bend = (turn[1:] - turn[:-1]).norm(dim=-1)
    place = 2 * shape.stations[int(bend.argmax())].item() / math.pi - 1
    assert place == pytest.approx(0.2, abs=0.02)
    step = sliding_derivative(shape.edges, shape.stations)
    assert torch.allclose(step, shape.tangents, rtol=0, atol=1e-4)


def test_impossible_sizes_are_refused():
    with pytest.raises(ValueError, match="at least 24 nodes"):
        StripsCup(half_circle(), terms=12, nodes=20)
    with pytest.raises(ValueError, match="at least 1 term"):
        StripsCup(half_circle(), terms=0)


def cornered(wire: Wire, panels: int, **options: int) -> tuple[StripsCup, torch.Tensor, torch.Tensor]:
    """Two cups with a corner on the 240th of 401 stations, and a point beside each."""
    cup, flat = wavy(wire, panels, batch=2, stations=401, **options)
    flat[:, -3:] = torch.tensor([[-0.8, 0.9, 0.2], [0.5, -0.7, 0.2]], dtype=torch.float64)
    return cup, flat, torch.tensor([[0.3, 1.2, 0.9], [0.1, 1.1, 1.2]], dtype=torch.float64)


@pytest.mark.parametrize("panels", [1, 2, 3])
@pytest.mark.parametrize("wire", [WIRES["half circle"], WIRES["helix"]], ids=["half circle", "helix"])
def test_the_gap_at_the_corner_is_from_the_upper_edge_there(wire, panels):
    """Between the nodes of the fit, of which none is at the corner."""
    cup, flat, points = cornered(wire, panels, nodes=96)
    gaps = cup.corner_gap(flat, cup.sketch(flat), points)
    assert (cup.grid.x - 0.2).abs().min() > 1e-3
    assert torch.allclose(gaps.vectors[:, 0], cup.shape_of(flat).edges[:, -1, 240] - points, rtol=0, atol=1e-6)


@pytest.mark.parametrize("terms", [None, 6, 4])
@pytest.mark.parametrize("panels", [1, 2])
def test_the_gap_at_the_corner_has_the_derivatives_of_central_differences(panels, terms):
    cup, flat, points = cornered(WIRES["helix"], panels, terms=7, nodes=96)
    linear = cup.linearise(flat, terms)
    free = int((linear.columns >= cup.size - 3).sum())
    columns = cup.corner_gap(flat, linear.shape, points).columns(linear.table, free)
    h = 1e-6
    for k, column in enumerate(linear.columns.tolist()):
        step = torch.zeros_like(flat)
        step[:, column] = h
        ahead, behind = (cup.corner_gap(f, cup.sketch(f), points).vectors for f in (flat + step, flat - step))
        assert torch.allclose(columns[..., k], (ahead - behind) / (2 * h), rtol=0, atol=1e-7), (k, column)


@pytest.mark.parametrize("terms", [1, 2, 8])
@pytest.mark.parametrize("panels", [1, 2, 3, 4])
def test_cups_start_plain_but_for_their_places(panels, terms):
    """Only angles, which do not count, and terms of order 0 tell a start from the plain cup."""
    cup = StripsCup(half_circle(2), panels, terms)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(2, -1), torch.full((2, panels), 0.8, dtype=torch.float64))
    values, counts = cup.plain(torch.full((2,), HEIGHT, dtype=torch.float64))
    assert values.shape == (2, cup.size)
    assert counts.shape == (cup.size,)
    away = cup.split((cup.flatten().detach() - values) * counts)
    for name in ("rib", "length"):
        assert (away[name][..., 1:] == 0).all()
    assert (away["angle"] == 0).all()
    assert (away["corner"] == 0).all()
    count = cup.split(counts[None])["length"]
    assert (count.diff(dim=-1) >= 0).all()
    assert torch.allclose(count[..., :2], torch.ones(()).double(), rtol=0, atol=1e-3)


def test_how_fair_an_edge_is_does_not_depend_on_where_its_corner_lies_between_nodes():
    """Else the corner sticks to nodes. On few nodes as on many, with the corner on a node and between two."""
    coarse, flat = wavy(half_circle(), 2, nodes=48)
    fine, _ = wavy(half_circle(), 2, nodes=480)
    nodes, ratios = coarse.grid.x[22:26], []
    for place in torch.cat((nodes, 0.5 * (nodes[1:] + nodes[:-1]))).tolist():
        flat[:, -3:] = torch.tensor([-1.2, 0.05, place], dtype=torch.float64)
        few, many = (cup.unfairness(flat).square().sum().item() for cup in (coarse, fine))
        ratios.append(few / many)
    assert max(ratios) / min(ratios) < 1.02
    assert ratios == pytest.approx([1.0] * len(ratios), abs=0.03)
