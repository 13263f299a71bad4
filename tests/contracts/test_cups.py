"""What every cup model promises: batches of independent cups, right derivatives, panels that can be laid flat."""

from __future__ import annotations

import copy
import itertools
import math
import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from cups import half_circle, plain_strips
from house_cup import HouseCup
from shapely import LineString
from torch import Tensor

from brafit.cup import Cup, CupShape, FramesCup, StripsCup, Wire
from brafit.geometry.developable import twist_angle
from brafit.geometry.development import arc_lengths

ROOT = Path(__file__).parents[2]
BLOCK = {name: value[0].tolist() for name, value in plain_strips(1).split(plain_strips(1).flatten().detach()).items()}
NODES = {"terms": 5, "nodes": 40, "stations": 101}
MODELS: dict[str, Callable[..., Cup]] = {
    "strips": partial(StripsCup, **NODES),
    "frames": partial(FramesCup, terms=4, stations=101),
    "house": partial(HouseCup, block=BLOCK, **NODES),
}
ANGLE = np.linspace(0, np.pi, 100)
OVAL = np.stack((70 * np.sin(ANGLE), 55 * (1 - np.cos(ANGLE)), 5 * np.sin(ANGLE) ** 2), axis=-1)
"""A wire that is not planar."""
WIRES = Wire.stack([half_circle(), Wire.from_polyline(OVAL), Wire.from_arc(70.0, 210.0)])


def started(model: str, panels: int = 2, wire: Wire = WIRES, reach: float = 0.9) -> Cup:
    """Cups that stand up from their wires. (A block has two panels.)"""
    own = wire.select(torch.arange(len(wire)))  # which the cup may change to another precision
    make = MODELS[model] if panels == 2 or model != "house" else MODELS["strips"]
    cup = make(own, panels=panels)
    share = torch.arange(1, panels + 1, dtype=torch.float64) / panels
    cup.start((share * math.pi / 2).expand(cup.batch, -1), torch.full((cup.batch, panels), reach, dtype=torch.float64))
    return cup


def beside(cup: Cup, amount: float = 0.02, seed: int = 3) -> Tensor:
    """Parameters off the cup's own, the less the more they change a cup."""
    noise = torch.randn(cup.batch, cup.size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return cup.flatten().detach() + amount * noise * cup.steps.double()


def test_every_model_that_comes_with_a_file_of_settings_is_here():
    """Those of conf/, and of the examples."""
    files = [
        *(ROOT / "conf" / "cup").glob("*.yaml"),
        *(ROOT / "examples" / "extending" / "conf" / "cup").glob("*.yaml"),
    ]
    assert {file.stem for file in files} == set(MODELS)
    for file in files:
        target = yaml.safe_load(file.read_text())["_target_"]
        assert target.endswith(f".{type(started(file.stem)).__name__}")


@pytest.mark.parametrize("model", MODELS)
class TestCup:
    def test_parameters_go_to_and_fro(self, model):
        cup, flat = started(model), beside(started(model))
        cup.load_flat(flat)
        torch.testing.assert_close(cup.flatten(), flat, rtol=1e-15, atol=0)
        assert {name: tuple(v.shape[1:]) for name, v in cup.split(flat).items()} == cup.layout
        assert sum(math.prod(shape) for shape in cup.layout.values()) == cup.size
        assert {name for name, _ in cup.named_parameters()} == set(cup.layout)

    def test_its_state_can_be_kept(self, model):
        cup, other = started(model), started(model, wire=WIRES.select(torch.tensor([1, 1, 1])))
        cup.load_flat(beside(cup))
        other.load_state_dict(cup.state_dict())
        for one in (other, copy.deepcopy(cup), pickle.loads(pickle.dumps(cup))):
            assert type(one) is type(cup)
            assert torch.equal(one.shape().edges, cup.shape().edges)

    def test_each_cup_is_as_if_alone(self, model):
        cup = started(model)
        flat = beside(cup)
        shape, linear = cup.shape_of(flat), cup.linearise(flat)
        for k in range(cup.batch):
            one = cup.select(torch.tensor([k]))
            alone, own = one.shape_of(flat[k : k + 1]), one.linearise(flat[k : k + 1])
            assert torch.allclose(alone.edges[0], shape.edges[k], rtol=0, atol=1e-13)
            for name in ("table", "margin_columns"):
                assert torch.allclose(getattr(own, name)[0], getattr(linear, name)[k], rtol=0, atol=1e-11)
            plain = started(model, wire=WIRES.select(torch.tensor([k]))).shape_of(flat[k : k + 1])
            assert torch.allclose(plain.edges[0, 0], shape.edges[k, 0], rtol=0, atol=1e-13)

    def test_cups_are_taken_out_and_set_on_other_wires(self, model):
        cup = started(model)
        cup.load_flat(beside(cup))
        part = cup.select(torch.tensor([2, 0, 2]))
        assert type(part) is type(cup)
        assert torch.equal(part.shape().edges, cup.shape().edges[[2, 0, 2]])
        moved = cup.on(WIRES.select(torch.tensor([1, 0, 2])))
        assert type(moved) is type(cup)
        torch.testing.assert_close(moved.flatten(), cup.flatten(), rtol=1e-14, atol=1e-15)
        wires = moved.wire.sample(moved.stations)
        assert torch.allclose(moved.shape_of(moved.flatten()).edges[:, 0], wires, rtol=0, atol=1e-10)
        single = cup.on(copy.deepcopy(WIRES).float())
        assert single.shape().edges.dtype == torch.float32
        assert torch.allclose(single.shape().edges.double(), cup.shape().edges, rtol=0, atol=2e-3)
        height = torch.linspace(0.3, 0.6, cup.batch, dtype=torch.float64)
        if (plain := cup.plain(height)) is not None and (other := moved.plain(height)) is not None:
            assert plain[0].shape == cup.flatten().shape
            assert torch.equal(plain[0], other[0])

    @pytest.mark.parametrize("panels", [1, 2, 3])
    def test_derivatives_are_those_of_central_differences(self, model, panels):
        """Of samples, margins, unfairness and constraints, with all terms free and with some."""
        cup = started(model, panels)
        flat, h = beside(cup), 1e-6
        for terms in (None, 3):
            linear = cup.linearise(flat, terms)
            order = torch.zeros(cup.size, dtype=flat.dtype)
            order[linear.columns] = torch.randn(len(linear.columns), dtype=flat.dtype)
            step = order * cup.steps
            values = [self.watched(cup, flat + sign * h * step) for sign in (1, -1)]
            columns = {
                "table": linear.table,
                "margin": linear.margin_columns,
                "unfairness": linear.unfairness_columns,
                **linear.constraints,
            }
            for name, ahead in values[0].items():
                known = (ahead - values[1][name]) / (2 * h)
                found = (columns[name] * step[linear.columns]).sum(-1)
                assert (found - known).abs().max() < 5e-5 * max(1.0, known.abs().max().item()), (name, terms)

    @staticmethod
    def watched(cup: Cup, flat: Tensor) -> dict[str, Tensor]:
        shape = cup.sketch(flat)
        table = torch.cat((shape.edges.flatten(1, 2), shape.tangents.flatten(1, 2)), dim=1)
        own = {"table": table, "margin": shape.margin, "unfairness": cup.unfairness(flat)}
        return own | cup.constraints(shape)

    def test_gradients_reach_every_parameter(self, model):
        cup = started(model)
        flat = beside(cup)
        for name in ("corner",) if "corner" in cup.layout else ():
            cup.split(flat)[name][:] = 0.1  # a flat corner may stand anywhere
        cup.load_flat(flat)
        edges = cup.shape().edges
        (edges * torch.randn(edges.shape, dtype=edges.dtype)).sum().backward()
        for name in cup.layout:
            gradient = cup.get_parameter(name).grad
            assert gradient is not None
            assert gradient.isfinite().all()
            assert (gradient.flatten(1) != 0).all(), name

    @pytest.mark.parametrize("panels", [1, 2, 3])
    def test_edges_begin_with_the_wire_and_meet_in_its_ends(self, model, panels):
        cup = started(model, panels)
        shape = cup.shape_of(cup.flatten())
        wire = cup.wire.sample(cup.stations)
        assert shape.edges.shape == (3, panels + 1, len(cup.stations), 3)
        assert torch.allclose(shape.edges[:, 0], wire, rtol=0, atol=1e-10)
        for end in (0, -1):
            assert torch.allclose(
                shape.edges[:, :, end], wire[:, None, end].expand(-1, panels + 1, -1), rtol=0, atol=1e-10
            )
        reach = shape.edges[:, 1:] - shape.edges[:, :-1]
        assert ((reach * shape.directions).sum(-1)[..., 1:-1] > 0).all()

    def test_exact_panels_are_developable_and_keep_their_lengths(self, model):
        """Others say by their constraints how far they are from that."""
        cup = started(model)
        flat = beside(cup)
        assert cup.constrained == bool(cup.constraints(cup.sketch(flat)))
        assert cup.developable == (not cup.constrained)  # of these models
        if cup.constrained:
            assert max(v.abs().max() for v in cup.constraints(cup.sketch(flat)).values()) > 1e-3
            cup = started(model, wire=half_circle(3), reach=1.0)  # half circles, all panels cylinders
            flat = cup.flatten().detach()
            assert max(v.abs().max() for v in cup.constraints(cup.sketch(flat)).values()) < 1e-9
        shape = cup.shape_of(flat)
        inner = slice(1, -1)
        lower, upper = shape.tangents[:, :-1, inner], shape.tangents[:, 1:, inner]
        assert torch.rad2deg(twist_angle(lower, upper, shape.directions[:, :, inner])).max() < 1e-3
        flat_panels = shape.flat()
        space = arc_lengths(shape.edges, shape.stations)[..., -1]
        for edges, known in ((flat_panels.lower, space[:, :-1]), (flat_panels.upper, space[:, 1:])):
            assert torch.allclose(arc_lengths(edges, shape.stations)[..., -1], known, rtol=0, atol=2e-5)
        rulings = (flat_panels.upper - flat_panels.lower).norm(dim=-1)
        assert torch.allclose(rulings, shape.lengths, rtol=0, atol=2e-5)

    def test_the_margin_is_negative_where_rulings_cross(self, model):
        """As neighbouring rulings do in the flat pattern; cups from sound to folded. Panels that are not developable
        have no flat pattern: their surface turns over between its two edges there.
        """
        cup = started(model, wire=half_circle(24))
        amount = torch.linspace(0.0, 1.5, 24, dtype=torch.float64)[:, None]
        start = cup.flatten().detach()
        flat = start + amount * (beside(cup, 1.0, seed=7) - start)
        shape = cup.shape_of(flat)
        assert (shape.margin[0] > 0.1).all()
        seen = {True: 0, False: 0}
        for k in range(24):
            for panel in range(2):
                margin = shape.margin[k, panel, 2:-2].min().item()
                if not math.isfinite(margin) or abs(margin) < 0.15:
                    continue
                crossing = self.crossing if cup.developable else self.turning
                assert (margin < 0) == crossing(shape, k, panel), (k, panel, margin)
                seen[margin < 0] += 1
        assert min(seen.values()) >= 3, seen

    @staticmethod
    def crossing(shape: CupShape, k: int, panel: int) -> bool:
        laid = shape.flat()
        ends = torch.stack((laid.lower[k, panel, 2:-2], laid.upper[k, panel, 2:-2]), dim=1).tolist()
        rulings = [LineString(end) for end in ends]
        return any(one.crosses(other) for one, other in itertools.pairwise(rulings))

    @staticmethod
    def turning(shape: CupShape, k: int, panel: int) -> bool:
        ruling, tangents = shape.directions[k, panel], shape.tangents[k, panel : panel + 2]
        lower, upper = torch.linalg.cross(tangents, ruling[None])
        return bool(((lower * upper).sum(-1)[2:-2] < 0).any())

    def test_single_precision_follows_double(self, model):
        cup = started(model)
        flat = beside(cup)
        single = started(model).float()
        own, exact = single.shape_of(flat.float()), cup.shape_of(flat)
        assert own.edges.dtype == torch.float32
        assert torch.allclose(own.edges.double(), exact.edges, rtol=0, atol=1e-4)

    def test_finer_grids_keep_the_cup(self, model):
        cup = started(model)
        flat = beside(cup)
        cup.load_flat(flat)
        fine = cup.refined()
        step = (len(fine.stations) - 1) // (len(cup.stations) - 1)
        assert torch.allclose(fine.shape().edges[:, :, ::step], cup.shape().edges, rtol=0, atol=1e-6)
        assert cup.finer().sketch(flat).edges.shape[2] >= cup.sketch(flat).edges.shape[2]
        assert torch.equal(cup.finer().flatten(), cup.flatten())

    def test_a_wire_that_is_none_and_panels_that_are_none_are_refused(self, model):
        make = MODELS[model]
        with pytest.raises(ValueError, match="at least 1 panel"):
            make(WIRES, panels=0)
        with pytest.raises(ValueError, match="a wire must be an array"):
            make([1.0, 2.0])
