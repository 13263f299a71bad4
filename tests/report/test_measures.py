"""Measures over the surface: of cylinders, where they are known in closed form, and against libigl and trimesh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from lunes import RADIUS, lune_cup, lune_flat
from scipy.special import ellipeinc

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel
from brafit.report.measures import BustPoints, Cups, over_surface
from brafit.report.sections import sections
from brafit.report.taut import Place, Way, flat_curves, pulled


@dataclass(frozen=True)
class Cup:
    shape: CupShape
    panels: list[FlatPanel]


def lune(panels: int) -> Cup:
    return Cup(lune_cup(panels, n=201), lune_flat(panels, n=201))


def own(cup: Cup, apex: np.ndarray, strap: np.ndarray | None = None) -> dict[str, float]:
    """Measures of a cup."""
    cups = Cups.of([[cup]])
    found, _ = over_surface(cups, BustPoints.of(cups, apex[None]), None if strap is None else strap[None])
    return {name: float(value) for name, (value,) in found.items()}


def on_ruling(panels: int, panel: int, angle: float, share: float) -> np.ndarray:
    """A point of a lune cup: its place along the wire as an angle, and on the ruling."""
    step = np.pi / 2 / panels
    ends = [RADIUS * np.array((np.sin(angle) * np.cos(a), 1 - np.cos(angle), np.sin(angle) * np.sin(a)))
            for a in (panel * step, (panel + 1) * step)]  # fmt: skip
    return (1 - share) * ends[0] + share * ends[1]


def flat_x(panels: int, angle: float) -> float:
    """Of a ruling in the flat lune, from the middle."""
    return RADIUS * float(ellipeinc(angle - np.pi / 2, np.sin(np.pi / 4 / panels) ** 2))


def flat_place(panels: int, panel: int, angle: float, share: float) -> np.ndarray:
    """In the flat lunes laid one above the other so that they touch in the middle of their ridges."""
    half = RADIUS * np.sin(np.pi / 4 / panels)
    return np.array((flat_x(panels, angle), half * ((2 * share - 1) * np.sin(angle) + 2 * panel)))


@pytest.mark.parametrize(("angle", "share"), [(np.pi / 2, 0.3), (1.1, 0.6), (2.0, 0.15)])
def test_taut_tape_within_a_panel_is_a_straight_line_of_its_pattern(angle, share):
    apex, strap = on_ruling(1, 0, angle, share), on_ruling(1, 0, 1.4, 1.0)
    found = own(lune(1), apex, strap)["strap point to bust point"]
    straight = flat_place(1, 0, angle, share) - flat_place(1, 0, 1.4, 1.0)
    assert found == pytest.approx(np.linalg.norm(straight), abs=2e-3)


def test_taut_tape_crosses_ridges_where_its_length_is_least():
    """Straight across in the middle; elsewhere shorter than any way by other crossings."""
    straight = between(Place(2, 100.0, 1.0), Place(0, 100.0, 0.0))
    assert straight.length == pytest.approx(6 * RADIUS * np.sin(np.pi / 12), abs=1e-3)
    aslant = between(Place(2, 140.0, 1.0), Place(0, 70.0, 0.2))
    for shift in ((2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0)):
        moved = replace(aslant, crossings=tuple(np.add(aslant.crossings, shift).tolist()))
        assert moved.length > aslant.length + 1e-3


def between(start: Place, end: Place) -> Way:
    flat = Cups.of([[lune(3)]]).flat[0, 0].numpy()
    return Way.between(flat_curves(flat), start, end).straightest().shortest()


def test_tape_that_would_leave_the_panel_lies_along_its_edge():
    """Round a quarter ring, drawn as gates from its inner to its outer circle."""
    angle = np.linspace(0, np.pi / 2, 400)[1:-1]
    circle = np.stack((np.cos(angle), np.sin(angle)), -1)
    way = pulled(np.array((1.0, 0.0)), np.array((0.0, 1.0)), 3 * circle, circle)
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).sum() == pytest.approx(np.pi / 2, abs=1e-4)
    around = pulled(np.array((1.2, 0.0)), np.array((0.0, 1.2)), 3 * circle, circle)
    tangent = 2 * np.sqrt(1.2**2 - 1) + np.pi / 2 - 2 * np.arccos(1 / 1.2)
    assert np.linalg.norm(np.diff(around, axis=0), axis=1).sum() == pytest.approx(tangent, abs=1e-4)
    assert len(pulled(circle[0] * 2, circle[3] * 2, 3 * circle[1:3], circle[1:3])) == 2


def test_sections_of_cylinders():
    """Upright through the middle a lune's rulings; level a curve of its cross-section."""
    apex = on_ruling(2, 0, np.pi / 2, 0.4)
    found = own(lune(2), apex)
    ruling = 2 * RADIUS * np.sin(np.pi / 8)
    assert found["bust point down to the wire (bottom cup depth)"] == pytest.approx(0.4 * ruling, abs=1e-3)
    assert found["bust point up to the upper edge (upper cup depth)"] == pytest.approx(1.6 * ruling, abs=1e-3)
    assert found["vertical over the bust point"] == pytest.approx(2 * ruling, abs=1e-3)
    assert found["wire line"] == pytest.approx(np.pi * RADIUS, abs=1e-4)
    assert found["neckline"] == pytest.approx(np.pi * RADIUS, abs=1e-4)
    # level, the plane x = c: panel 0 runs between x = R sin(t) and R sin(t) cos(45 degrees)
    assert found["horizontal over the bust point"] == pytest.approx(level_section(2, apex[0]), abs=0.01)


def level_section(panels: int, x: float) -> float:
    """Length of the section of a lune cup by a plane of that x, from where its points lie on the rulings."""
    length, step = 0.0, np.pi / 2 / panels
    for panel in range(panels):
        angle = np.linspace(0, np.pi, 2_000_001)
        a, b = (RADIUS * np.sin(angle) * np.cos(step * k) for k in (panel, panel + 1))
        share = (a - x) / np.where(a == b, 1.0, a - b)
        inside = (share >= 0) & (share <= 1)
        y, z = (
            RADIUS * (1 - np.cos(angle)),
            RADIUS * np.sin(angle) * ((1 - share) * np.sin(step * panel) + share * np.sin(step * (panel + 1))),
        )
        both = inside[1:] & inside[:-1]
        length += float(np.hypot(np.diff(y), np.diff(z))[both].sum())
    return length


def test_section_that_does_not_reach_the_rim_twice_is_no_number():
    flat = np.stack(np.meshgrid(np.arange(3.0), np.arange(4.0), (0.0,), indexing="ij"), -1)[:, :, 0]
    two = np.stack((flat, flat))
    (lower, _), (other, _) = sections(two, np.array(((1.5, 1.2, 0.0), (9.0, 9.0, 0.0))), 1)
    assert (lower, other) == pytest.approx((0.5, 1.5))
    assert np.isnan(sections(two, np.full((2, 3), 9.0), 0)).all()


def test_a_section_that_is_a_ring_is_no_number():
    """A bowl that is cut above its bottom and below its rim, beside one whose rim is cut."""
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9), indexing="ij")
    bowl = np.stack((x, y, x**2 + y**2), -1)
    starts = np.array(((0.0, 0.5, 0.25), (0.0, 1.0, 1.0)))
    lower, other = sections(np.stack((bowl, bowl)), starts, 2)
    assert np.isnan(lower[0])
    assert np.isnan(other[0])
    assert np.isfinite(sections(bowl[None], starts[:1], 1)).all()


def test_strap_point_divides_the_upper_edge():
    strap = on_ruling(2, 1, np.pi / 3, 1.0)
    found = own(lune(2), on_ruling(2, 0, 1.5, 0.5), strap)
    assert found["neckline (inner end to strap point)"] == pytest.approx(np.pi * RADIUS / 3, abs=0.05)
    assert found["underarm edge (strap point to outer end)"] == pytest.approx(np.pi * RADIUS * 2 / 3, abs=0.05)


@pytest.mark.parametrize("angle", [1.2, 1.9])
def test_measures_against_libigl_and_trimesh(angle, tmp_path: Path):
    """On the mesh that is written: geodesics by libigl, plane sections by trimesh."""
    pytest.importorskip("igl", reason="libigl is not installed")
    pytest.importorskip("trimesh", reason="trimesh is not installed")
    from check_measures import taped

    from brafit.pattern import pieces_from_panels
    from brafit.report.mesh import panel_meshes, write_cup_obj

    cup = lune(3)
    write_cup_obj(tmp_path / "cup.obj", panel_meshes(cup.shape, pieces_from_panels(cup.panels)))
    apex, strap = on_ruling(3, 0, angle, 0.7), on_ruling(3, 2, 1.5, 1.0)
    measured = own(cup, apex, strap)
    others = taped(tmp_path / "cup.obj", apex, strap, np.eye(3))
    assert len(others) == 5
    for name, value in others.items():
        assert measured[name] == pytest.approx(value, abs=0.05), name
