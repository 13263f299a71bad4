from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from lunes import RADIUS, lune_area, lune_flat

from brafit.geometry.development import FlatPanel
from brafit.pattern import Edge, Piece, layout, pieces_from_panels


@pytest.mark.parametrize("panels", [1, 2, 3, 4])
def test_edges_of_lunes_have_the_wires_length_and_seams_share_a_name(panels):
    pieces = pieces_from_panels(lune_flat(panels, n=801))
    assert len(pieces) == panels
    assert len({piece.name for piece in pieces}) == panels
    for piece in pieces:
        for edge in piece.edges:
            assert edge.length == pytest.approx(np.pi * RADIUS, rel=1e-6)
        assert piece.area == pytest.approx(lune_area(panels), rel=1e-5)
    assert [edge.kind for piece in pieces for edge in piece.edges] == ["wire", *["ridge"] * (2 * panels - 2), "upper"]
    for below, above in pairwise(pieces):
        assert below.edges[1].name == above.edges[0].name
    assert len({edge.name for piece in pieces for edge in piece.edges}) == panels + 1


def test_names_of_the_usual_cups():
    names = [[piece.name for piece in pieces_from_panels(lune_flat(k))] for k in (1, 2, 3)]
    assert names == [["panel"], ["lower panel", "upper panel"], ["lower panel", "middle panel", "upper panel"]]


def test_outline_is_closed_and_has_each_corner_once():
    (piece,) = pieces_from_panels(lune_flat(1, n=51))
    lower, upper = piece.edges
    np.testing.assert_allclose(lower.points[[0, -1]], upper.points[[-1, 0]], atol=1e-9)
    assert len(piece.outline) == 2 * 51 - 2


def a_lopsided_panel() -> FlatPanel:
    x = torch.linspace(0, 100, 21, dtype=torch.float64)
    bump = x * (100 - x) / 2500
    return FlatPanel(torch.stack((x, -10 * bump), -1), torch.stack((x, 30 * bump * (1 + x / 100)), -1))


def test_pieces_lie_level_whichever_way_they_come():
    straight = a_lopsided_panel()
    angle = 1.0
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = FlatPanel(straight.lower @ turn + 7, straight.upper @ turn + 7)
    (a,), (b,) = pieces_from_panels([straight]), pieces_from_panels([turned])
    np.testing.assert_allclose(a.outline, b.outline, atol=1e-9)


def test_right_pieces_are_mirror_images_that_no_turning_makes_left():
    (left,), (right,) = pieces_from_panels([a_lopsided_panel()]), pieces_from_panels([a_lopsided_panel()], "right")
    np.testing.assert_allclose(left.outline * (-1, 1), right.outline)
    assert left.area == pytest.approx(right.area)
    turned = -right.outline  # the only turn that keeps the chord level
    assert np.abs(np.sort(turned[:, 1]) - np.sort(left.outline[:, 1])).max() > 1


SIDE: Any = "middle"


def test_nonsense_is_refused():
    with pytest.raises(ValueError, match="at least one panel"):
        pieces_from_panels([])
    with pytest.raises((ValueError, TypeError), match="side"):  # the checks of a test run come first
        pieces_from_panels(lune_flat(), SIDE)


@pytest.mark.parametrize("panels", [1, 2, 3, 5])
def test_layout_keeps_pieces_apart_and_on_the_sheet(panels):
    pieces = pieces_from_panels(lune_flat(panels))
    sheet = layout(pieces, gap=7)
    corners = [piece.bounds for piece in sheet.pieces]
    for low, high in corners:
        assert (low > -1e-9).all()
        assert high[0] < sheet.width + 1e-9
        assert high[1] < sheet.height + 1e-9
    for i, (low, high) in enumerate(corners):
        for other_low, other_high in corners[:i]:
            distance = np.maximum(low - other_high, other_low - high)
            assert distance.max() > 7 - 1e-9
    for before, after in zip(pieces, sheet.pieces, strict=True):
        shift = after.outline - before.outline
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-9)


def polygon(*corners: tuple[float, float]) -> Piece:
    return Piece("polygon", (Edge("wire", "wire", np.array([*corners, corners[0]], float)),))


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_outlines_of_lunes_do_not_cross_themselves(panels):
    assert all(len(piece.crossings()) == 0 for piece in pieces_from_panels(lune_flat(panels)))


def test_crossing_is_found_where_it_is():
    np.testing.assert_allclose(polygon((0, 0), (10, 10), (10, 0), (0, 10)).crossings(), [(5, 5)])
    assert len(polygon((0, 0), (10, 0), (10, 10), (0, 10)).crossings()) == 0
    assert len(polygon((0, 0), (10, 0), (2, 2), (0, 10)).crossings()) == 0


def test_crossing_through_a_corner_is_found():
    piece = polygon((0, 0), (10, 0), (10, 5), (5, 0), (4, -5), (0, -5))
    np.testing.assert_allclose(piece.crossings()[0], (5, 0), atol=1e-12)


def test_edges_that_change_sides_make_an_outline_that_crosses():
    x = torch.linspace(0, 100, 41, dtype=torch.float64)
    wave = torch.sin(x * torch.pi / 50)
    wave[[0, -1]] = 0
    panel = FlatPanel(torch.stack((x, 0 * x), -1), torch.stack((x + 0.3 * wave, 10 * wave), -1))
    (piece,) = pieces_from_panels([panel])
    crossings = piece.crossings()
    assert len(crossings) >= 1
    np.testing.assert_allclose(crossings[:, 0], 50, atol=3)
