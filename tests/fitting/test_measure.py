from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from lunes import RADIUS, lune_cup, lune_flat, sphere_points
from scipy.interpolate import CubicHermiteSpline
from surfaces import LENSES, stations

from brafit.cup import CupShape
from brafit.fitting.measure import Bend, figures_of, seam_to_apex, wire_places
from brafit.geometry.developable import geodesic_curvature, normals, rulings
from brafit.pattern.caption import INNER
from brafit.pattern.piece import pieces_from_panels


def figures(shape: CupShape, distances=None, neckline=None, wire=None, smoothing: float = 0.0) -> dict[str, float]:
    distances = torch.zeros(1, dtype=torch.float64) if distances is None else distances
    wire = places_on(shape.edges[0], shape.tangents[0], shape.stations) if wire is None else wire
    return figures_of(shape, shape.flat(), distances, neckline, wire, smoothing)


def places_on(edge: torch.Tensor, tangents: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
    """A cubic Hermite curve at `wire_places`, by SciPy."""
    return torch.from_numpy(CubicHermiteSpline(s.numpy(), edge.numpy(), tangents.numpy())(wire_places(s).numpy()))


def circle(s: torch.Tensor) -> torch.Tensor:
    """The exact cups' wire."""
    angle = s / RADIUS
    return RADIUS * torch.stack((torch.sin(angle), 1 - torch.cos(angle), torch.zeros_like(s)), dim=-1)


def twisted(angle: float) -> CupShape:
    """The one-panel cylinder cup with its upper edge's samples moved along that edge: rulings no longer parallel."""
    shape = lune_cup(1)
    s = shape.stations / shape.stations[-1]
    theta = math.pi * (s + angle * torch.sin(2 * math.pi * s))
    speed = 1 + 2 * math.pi * angle * torch.cos(2 * math.pi * s)
    zero = torch.zeros_like(theta)
    edge = RADIUS * torch.stack((zero, 1 - torch.cos(theta), torch.sin(theta)), dim=-1)
    tangent = speed[:, None] * torch.stack((zero, torch.sin(theta), torch.cos(theta)), dim=-1)
    edges = torch.stack((shape.edges[0], edge))
    tangents = torch.stack((shape.tangents[0], tangent))
    d = rulings(edges[:1], edges[1:], tangents[:1], tangents[1:])
    theta = shape.stations / RADIUS
    bend = torch.stack((-torch.sin(theta), torch.cos(theta), torch.zeros_like(theta)), dim=-1) / RADIUS
    geodesic = geodesic_curvature(tangents[:1], bend[None], d)
    normal = normals(tangents[:1], d)
    return replace(shape, edges=edges, tangents=tangents, directions=d, normals=normal, geodesic=geodesic)


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_an_exact_cylinder_cup_is_developable_isometric_and_sews_together(panels):
    shape = lune_cup(panels)
    own = figures(shape, wire=circle(wire_places(shape.stations)))
    assert own["twist_deg_max"] < 1e-6
    assert own["regularity_min"] == pytest.approx(1)
    assert own["isometry_mm"] < 1e-5
    assert own["seam_mismatch_mm"] < 1e-5
    assert own["wire_length_mm"] == pytest.approx(math.pi * RADIUS, rel=1e-9)
    assert own["wire_drift_mm"] < 1e-5
    flat = shape.flat()
    for k, known in enumerate(lune_flat(panels)):
        width = (known.lower[-1] - known.lower[0]).norm()
        torch.testing.assert_close((flat.lower[k, -1] - flat.lower[k, 0]).norm(), width, rtol=1e-8, atol=0)


@pytest.mark.parametrize("name", LENSES)
def test_other_developables_too(name):
    panel = LENSES[name](stations(201))
    own = figures(panel.shape)
    assert own["twist_deg_max"] < 1e-4
    assert own["isometry_mm"] < 1e-7
    assert own["regularity_min"] == pytest.approx(panel.margin.min().item())
    flat = panel.shape.flat()
    torch.testing.assert_close(flat.lower[0], panel.flat_lower, rtol=0, atol=1e-9)
    torch.testing.assert_close(flat.upper[0], panel.flat_upper, rtol=0, atol=1e-9)


def test_a_twisted_cup_is_found_out():
    """Also where the model's own tangents claim the opposite: they are not used."""
    shape = twisted(0.08)
    own = figures(shape)
    assert own["twist_deg_max"] > 10
    assert own["isometry_mm"] > 0.5
    lying = replace(shape, tangents=lune_cup(1).tangents)
    assert figures(lying)["twist_deg_max"] == pytest.approx(own["twist_deg_max"])
    assert figures(twisted(0.01))["twist_deg_max"] < 0.3 * own["twist_deg_max"]


def test_point_distances_to_the_two_panel_cup():
    """In its plane of symmetry the cup is a polygon around the circle's arc: R (cos - cos(pi / 8)) from its sides."""
    a = np.linspace(0.01, np.pi / 2 - 0.01, 40)
    points = RADIUS * np.stack((np.cos(a), np.ones(40), np.sin(a)), axis=1)
    folded = np.abs(a % (np.pi / 4) - np.pi / 8)
    known = RADIUS * (np.cos(folded) - np.cos(np.pi / 8))
    np.testing.assert_allclose(lune_cup(2, 201).distances(torch.from_numpy(points)), known, atol=1e-5)
    points, bound = sphere_points(400)
    own = lune_cup(2, 201).distances(torch.from_numpy(points)).numpy()
    assert (own > -1e-5).all()
    assert (own < bound + 1e-5).all()


def test_distances_are_summed_up():
    d = torch.from_numpy(np.random.default_rng(0).normal(size=1001))
    own = figures(lune_cup(), d, smoothing=0.25)
    size = np.abs(d.numpy())
    assert own["rms_mm"] == pytest.approx(np.sqrt((size**2).mean()))
    assert own["mean_mm"] == pytest.approx(size.mean())
    assert own["p95_mm"] == pytest.approx(np.quantile(size, 0.95))
    assert own["max_mm"] == pytest.approx(size.max())
    assert own["wire_smoothing_mm"] == 0.25


def test_upper_edge_and_wire_drift_are_distances():
    shape = lune_cup(2)
    assert math.isnan(figures(shape)["upper_edge_mm"])
    lifted = shape.edges[-1] + torch.tensor([3.0, 0.0, 0.0], dtype=torch.float64)
    assert figures(shape, neckline=lifted)["upper_edge_mm"] == pytest.approx(3, rel=1e-3)
    aside = circle(wire_places(shape.stations)) + torch.tensor([0.0, 0.0, 0.7], dtype=torch.float64)
    assert figures(shape, wire=aside)["wire_drift_mm"] == pytest.approx(0.7, rel=1e-4)


def test_the_nearest_ridge_to_the_bust_point():
    """Edges are half circles, turned about the chord by equal angles up to 90 degrees: ridges of 3 panels lie at 30 and
    60 degrees.
    """
    shape, middle = lune_cup(3), np.array([0.0, RADIUS, 0.0])

    def at(degrees: float, radius: float) -> np.ndarray:
        angle = math.radians(degrees)
        return middle + radius * np.array([math.cos(angle), 0.0, math.sin(angle)])

    assert seam_to_apex(shape, at(60, RADIUS)) == pytest.approx(0, abs=1e-5)
    assert seam_to_apex(shape, at(30, RADIUS + 4)) == pytest.approx(4, rel=1e-5)
    assert seam_to_apex(shape, at(50, RADIUS)) == pytest.approx(2 * RADIUS * math.sin(math.radians(5)), rel=1e-5)
    assert math.isnan(seam_to_apex(lune_cup(1), at(45, RADIUS)))


@pytest.mark.parametrize(
    ("bend", "edge", "panel"),
    [
        (Bend(1, 0, 4, 8.24, 48.4), "seam 1", "the lower panel"),
        (Bend(2, 2, 5, 8.24, 48.4), "seam 2", "panel 3"),
        (Bend(1, 1, 3, 8.24, 48.4), "the seam", "the upper panel"),
        (Bend(0, 0, 3, 8.24, 48.4), "the wire edge", "the lower panel"),
        (Bend(2, 1, 3, 8.24, 48.4), "the upper edge", "the upper panel"),
    ],
)
def test_a_bend_is_named_as_the_pieces_are(bend, edge, panel):
    piece = pieces_from_panels(lune_flat(bend.edges - 1))[bend.panel]
    assert panel.removeprefix("the ") == piece.name
    assert any(own.name in edge for own in piece.edges)
    assert str(bend) == f"{edge} bends with a radius of 8.2 mm, 48 mm from {INNER}, on {panel}"
