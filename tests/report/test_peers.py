"""What docs/peers.md compares: measures are exact where the truth is known, surfaces are what they should be."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from compare_peers import (
    RADIUS,
    Case,
    Compared,
    Cut,
    Row,
    case_of,
    flattened,
    gathered,
    sphere_scan,
    spread_of,
    surfaces_of,
)
from flattenings import (
    METHODS,
    FoldedError,
    Part,
    Surface,
    areas,
    distances,
    laid_flat,
    made_developable,
    peers,
    seam_gaps,
    strains,
    stretches,
    whole,
)
from lunes import lune_area, lune_cup, lune_flat
from pages import ROOT
from peers_page import FILTER, OURS, Figures, Missing, Setting, Table, page, rows, shown
from scipy.spatial import Delaunay

CAP = 0.6
"""Radians from the middle of the cap to its rim."""
SETTING = Setting(panels=(2, 3), rescans=3, noise=0.5, evaluations=400, patience=1.0, points=2500)


def grid(count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 2) and triangles of a plane square of side 1."""
    places = np.stack(np.meshgrid(*[np.linspace(0, 1, count)] * 2), axis=-1).reshape(-1, 2)
    return places, oriented(places, Delaunay(places).simplices)


def oriented(places: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangles that all run counter-clockwise."""
    a, b = (places[faces[:, k]] - places[faces[:, 0]] for k in (1, 2))
    return np.where((a[:, 0] * b[:, 1] > a[:, 1] * b[:, 0])[:, None], faces, faces[:, ::-1])


def in_space(places: np.ndarray) -> np.ndarray:
    """The plane, turned and moved."""
    frame, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    return np.pad(places, ((0, 0), (0, 1))) @ frame + (1.0, 2.0, 3.0)


def rectangle(length: float, flat: tuple[float, float]) -> Part:
    """Of that length, its lower and upper edges as long as `flat` says in the plane."""
    places = np.array([(0, 0), (length, 0), (length, 10), (0, 10)], dtype=float)
    lower, upper = flat
    laid = np.array([(0, 0), (lower, 0), (upper, 10), (0, 10)], dtype=float)
    return Part(in_space(places), np.array([(0, 1, 2), (0, 2, 3)]), np.array([0, 1]), np.array([3, 2]), laid)


def cap(angle: float = CAP, rings: int = 16) -> tuple[Part, np.ndarray]:
    """A cap of the unit sphere, and its vertices' places on the azimuthal equidistant map."""
    places = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        turn = 2 * np.pi * np.arange(6 * ring) / (6 * ring)
        places.append(angle * ring / rings * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    flat = np.concatenate(places)
    away = np.linalg.norm(flat, axis=1)
    vertices = np.column_stack([np.sinc(away / np.pi)[:, None] * flat, np.cos(away)])
    rim = np.arange(len(flat) - 6 * rings, len(flat))
    half = len(rim) // 2
    faces = oriented(flat, Delaunay(flat).simplices)
    return Part(vertices, faces, rim[: half + 1], np.append(rim[0], rim[: half - 1 : -1])), flat


def test_the_strain_of_a_known_stretch_is_exact():
    places, faces = grid()
    turn = np.array([(0.6, 0.8), (-0.8, 0.6)])
    none = np.array([0])
    part = Part(in_space(places), faces, none, none, (places @ turn) * (1.1, 0.97))
    np.testing.assert_allclose(stretches(part), np.broadcast_to((1.1, 0.97), (len(faces), 2)), atol=1e-9)
    np.testing.assert_allclose(strains([part]), 0.1, atol=1e-9)
    assert areas(part).sum() == pytest.approx(1)


def test_shares_of_the_surface_are_shares_of_its_area():
    """Nine tenths of the area are strained by 1 %, the rest by 4 %."""
    none = np.array([0])
    parts = []
    for size, factor in ((0.9, 1.01), (0.1, 0.96)):
        places, faces = grid(2)
        places = places * (1, size)
        parts.append(Part(in_space(places), faces, none, none, places * factor))
    np.testing.assert_allclose(strains(parts), (0.04, 0.04, 0.013), atol=1e-9)
    parts[0] = replace(parts[0], vertices=parts[0].vertices * 4, flat=parts[0].laid * 4)
    np.testing.assert_allclose(strains(parts)[:2], (0.04, 0.01), atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_a_developable_part_is_laid_flat_without_strain(method, panels):
    pytest.importorskip("igl", reason="the flattening package libigl is not installed")
    for part in Cut.of(lune_cup(panels, 61), lune_flat(panels, 61)).parts:
        flat = laid_flat(replace(part, flat=None), method)
        assert strains([flat])[0] < 1e-6
        for upper in (False, True):
            space, plane = flat.lengths(upper)
            assert plane == pytest.approx(space, rel=1e-6)


def test_a_cap_is_strained_as_its_equidistant_map_says():
    """Distances from the middle stay, circles grow: the most at the rim, by angle over sine."""
    part, flat = cap()
    largest, _, mean = strains([replace(part, flat=flat)])
    assert largest == pytest.approx(CAP / math.sin(CAP) - 1, rel=0.05)
    average = (CAP**2 / 2 + math.cos(CAP) - 1) / (1 - math.cos(CAP))  # of angle over sine, less 1, over the area
    assert mean == pytest.approx(average, rel=0.03)


@pytest.mark.parametrize("method", METHODS)
def test_no_flattening_of_a_cap_strains_it_less_than_is_possible(method):
    """The ratio of the largest to the smallest stretch is angle over sine at least (Milnor), and for a map that keeps
    angles the inverse square of the half angle's cosine at least (Chebyshev).
    """
    pytest.importorskip("igl", reason="the flattening package libigl is not installed")
    part, _ = cap()
    found = stretches(laid_flat(part, method))
    ratio = found.max() / found.min()
    assert ratio > 0.99 * CAP / math.sin(CAP)
    if method == "LSCM":
        assert 0.98 < ratio * math.cos(CAP / 2) ** 2 < 1.2
        np.testing.assert_allclose(found[:, 0], found[:, 1], rtol=0.02)
        assert (areas(part) * found.prod(axis=1)).sum() == pytest.approx(areas(part).sum())
    assert 0.01 < strains([laid_flat(part, method)])[0] < 0.15


def test_the_gap_between_the_sides_of_a_seam():
    parts = [rectangle(100, (100, 101)), rectangle(100, (98.5, 100)), rectangle(100, (100.25, 100))]
    share, apart = seam_gaps(parts)
    assert share == pytest.approx(0.015)
    assert apart == pytest.approx(2.5)
    assert seam_gaps(parts[:1]) == (0, 0)


def sphere_with(noise: float) -> Surface:
    """The surface of a scan of the sphere."""
    (surface,) = surfaces_of(Case("sphere", sphere_scan(0, noise), []))
    return surface


@pytest.fixture(scope="module")
def sphere() -> Surface:
    return sphere_with(0.5)


def test_parts_of_a_noisy_sphere_lie_on_it_and_meet(sphere):
    parts = sphere.parts(lune_cup(3, 101, RADIUS).edges.numpy())
    for part in parts:
        away = np.linalg.norm(part.vertices - (0, RADIUS, 0), axis=1) - RADIUS
        assert np.sqrt(np.mean(away**2)) < 0.25  # of noise of 0.5 mm
    for below, above in pairwise(parts):
        np.testing.assert_array_equal(below.vertices[below.upper], above.vertices[above.lower])
    assert sum(areas(part).sum() for part in parts) == pytest.approx(np.pi * RADIUS**2, rel=0.01)
    vertices, faces, _ = whole(parts)
    assert len(vertices) == sum(len(part.vertices) for part in parts) - 2 * len(parts[0].lower)
    edges = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() == 2


def test_lines_that_cross_are_refused(sphere):
    wire, ridge, upper = lune_cup(2, 101, RADIUS).edges.numpy()
    twisted = ridge.copy()
    twisted[20:80] = ridge[20:80] + 1.5 * (upper - wire)[20:80] * np.sin(np.linspace(0, 4 * np.pi, 60))[:, None]
    with pytest.raises(FoldedError, match="cross"):
        sphere.parts(np.stack([wire, twisted, upper]), every=1)


def test_distances_are_those_from_the_triangles():
    pytest.importorskip("igl", reason="the package libigl is not installed")
    part = rectangle(100, (100, 100))
    normal = np.cross(*(part.vertices[[1, 3]] - part.vertices[0]))
    normal /= np.linalg.norm(normal)
    middle = part.vertices.mean(axis=0)
    points = middle + np.array([[0.0], [2.5], [-4.0]]) * normal
    np.testing.assert_allclose(distances(points, [part]), [0, 2.5, 4], atol=1e-9)


def test_the_filter_moves_the_surface_and_leaves_seams_closed():
    pytest.importorskip("pymeshlab", reason="the package pymeshlab is not installed")
    parts = sphere_with(0.0).parts(lune_cup(2, 101, RADIUS).edges.numpy(), rows=12)
    moved = made_developable(parts, 4000)
    for one, other in zip(parts, moved, strict=True):
        assert 0.5 < np.linalg.norm(one.vertices - other.vertices, axis=1).max() < 5
        np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_array_equal(moved[0].vertices[moved[0].upper], moved[1].vertices[moved[1].lower])


def test_a_cup_that_is_known_has_the_figures_that_are_known():
    cut = Cut.of(lune_cup(2, 201, RADIUS), lune_flat(2, 201, RADIUS))
    figures = cut.figures(1.0, np.array([3.0, -4.0]), math.pi * RADIUS, math.nan)
    assert figures.strain_max < 0.01
    assert figures.developable
    assert figures.wire == pytest.approx(0, abs=2e-3)
    assert figures.apart == pytest.approx(0, abs=1e-9)
    assert figures.rms == pytest.approx(math.sqrt(12.5))
    assert figures.farthest == 4
    assert sum(areas(part).sum() for part in cut.parts) == pytest.approx(2 * lune_area(2, RADIUS), rel=1e-3)
    stretched = Cut([replace(part, flat=1.002 * part.laid) for part in cut.parts])
    other = stretched.figures(1.0, np.zeros(1), math.pi * RADIUS, math.nan)
    assert not other.developable
    assert other.wire == pytest.approx(0.2, abs=0.01)


def test_outlines_that_are_only_moved_are_not_apart():
    cut = Cut.of(lune_cup(2, 61), lune_flat(2, 61))
    moved = Cut([replace(part, flat=part.laid @ [(0.6, 0.8), (-0.8, 0.6)] + (5, 7)) for part in cut.parts])
    longer = Cut([replace(part, flat=part.laid * (1.01, 1)) for part in cut.parts])
    assert spread_of([cut, moved, moved]) < 0.01
    half = max(np.ptp(part.laid[:, 0]) for part in cut.parts) / 2
    assert spread_of([cut, moved, longer, longer]) == pytest.approx(0.01 * half, rel=0.05)


@pytest.mark.parametrize(("gone", "package"), [("igl", "libigl"), ("pymeshlab", "pymeshlab")])
def test_a_row_names_the_package_that_it_lacks(gone, package, sphere, monkeypatch):
    pytest.importorskip("igl", reason="the flattening package libigl is not installed")
    monkeypatch.setitem(sys.modules, gone, None)
    case = Case("sphere", sphere_scan(0, 0.0), [])
    parts = sphere.parts(lune_cup(2, 41, RADIUS).edges.numpy(), rows=8)
    found = {method: flattened(case, [parts], lay) for method, lay in peers(10).items()}
    assert Missing(package) in found.values()
    for method in METHODS:
        assert isinstance(found[method], Missing) == (gone == "igl")
    if gone == "pymeshlab":
        assert found[FILTER] == Missing(package)


def figures(value: float) -> Figures:
    return Figures(*[value] * 10)


def test_rows_of_several_breasts_are_medians_and_of_largest_values_the_largest():
    cases = [Compared([Row(OURS, 2, figures(value)), Row(FILTER, 2, Missing("pymeshlab"))], 1.0) for value in (1, 2, 6)]
    table = gathered(cases)
    ours = table[OURS, 2]
    assert isinstance(ours, Figures)
    assert (ours.strain_max, ours.farthest, ours.rms, ours.strain_most) == (6, 6, 2, 2)
    assert table[FILTER, 2] == Missing("pymeshlab")


def test_the_page_says_what_is_missing_and_tells_the_figures():
    table: Table = {(method, panels): figures(panels + 0.25) for method in METHODS for panels in SETTING.panels}
    table |= {(OURS, panels): figures(0.25 * panels) for panels in SETTING.panels}
    missing = {(FILTER, panels): Missing("pymeshlab") for panels in SETTING.panels}
    text = page({"The quarter sphere": table, "5 breasts": table | missing}, SETTING, 90.0, 0.4)
    assert text.count("not installed: `pip install pymeshlab`") == 2
    assert "in 1.5 CPU minutes" in " ".join(text.split())
    assert "Figures of 5 breasts, 3 panels" in text
    assert "0.50 mm with 2 panels, 0.75 mm with 3 panels" in " ".join(text.split())
    nothing = {(method, panels): Missing("libigl") for method, panels in table if method != OURS}
    only_ours = {(OURS, panels): figures(0.5) for panels in SETTING.panels}
    bare = page({"The quarter sphere": nothing | missing | only_ours}, SETTING, 1.0, 0.4)
    assert "nothing to compare" in bare


def test_the_page_in_the_documentation_has_the_tables_that_the_script_makes():
    made = (ROOT / "docs" / "peers.md").read_text(encoding="utf-8")
    table: Table = {(method, panels): figures(1) for method in (*METHODS, FILTER, OURS) for panels in (2, 3, 4)}
    heads, _, *rest = rows(table).splitlines()
    assert made.count(heads) == 2
    for line in rest:
        assert made.count(line.partition("| 1.00")[0]) == 2


def test_figures_are_told_with_two_decimals_and_small_ones_with_one_digit():
    assert [shown(value) for value in (12.345, 0.1, 0.0321, 4e-7, 0.0, math.nan)] == [
        "12.35", "0.10", "0.03", "4e-07", "0.00", "not measured",
    ]  # fmt: skip


def test_a_case_is_a_clean_scan_and_noisy_ones():
    case = case_of("sphere", sphere_scan, replace(SETTING, rescans=2))
    away = [np.linalg.norm(one.points - (0, RADIUS, 0), axis=1) - RADIUS for one in (case.target, *case.again)]
    assert np.abs(away[0]).max() < 1e-9
    assert [round(float(value.std()), 1) for value in away[1:]] == [0.5, 0.5]
    assert not np.allclose(case.again[0].points, case.again[1].points)
