from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch
from lunes import RADIUS, lune_area, lune_cup, lune_flat
from patterns import small
from shapely import LineString, Point, Polygon

from brafit.errors import ConfigError
from brafit.geometry.development import FlatPanel
from brafit.pattern import CutPiece, Pattern, PatternOptions, Side, finish, marks_on, pieces_from_panels
from brafit.pattern.drawing import Stroke, drawn
from brafit.pattern.piece import Mark

HALF = RADIUS * np.pi / 2
APEX = np.array([RADIUS * np.sin(np.pi / 4), RADIUS, RADIUS * np.sin(np.pi / 4)])
STRAP = np.array([0.0, RADIUS, RADIUS + 1])


def lunes(panels: int = 2, side: Side = "left", apex=APEX, figures=None, **options) -> Pattern:
    marks = marks_on(lune_cup(panels), apex, STRAP)
    pieces = pieces_from_panels(lune_flat(panels), side, marks)
    return finish(pieces, PatternOptions(**options), name="lune", side=side, date="2001-02-03", figures=figures)


def allowance(wire: float, ridge: float, upper: float) -> dict[str, float]:
    return {"wire": wire, "ridge": ridge, "upper": upper}


def tips_apart(points: np.ndarray, piece: CutPiece, reach: float) -> np.ndarray:
    """The points that are not near one of the two tips."""
    lower = piece.sew[0].curve
    away = np.minimum(*(np.linalg.norm(points - tip, axis=1) for tip in (lower.start, lower.end)))
    return points[away > reach]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_cut_line_is_the_allowance_away_from_the_sewing_line(panels, side):
    for piece in lunes(panels, side).pieces:
        sewn = Polygon(piece.sew_outline(1e-4))
        cut = piece.cut_outline(1e-3)
        assert not sewn.contains(LineString(cut))
        far = tips_apart(cut, piece, 12.5)
        assert len(far) > 50
        gaps = [sewn.exterior.distance(Point(*p)) for p in far]
        np.testing.assert_allclose(gaps, 6.0, atol=0.02)
        assert piece.warnings == ()


def test_whole_outline_against_the_mitred_offset_of_shapely():
    """Away from the tips, where shapely bevels at another place, both outlines are the same area."""
    piece = lunes().pieces[0]
    sewn, cut = Polygon(piece.sew_outline(1e-4)), Polygon(piece.cut_outline(1e-4))
    buffered = sewn.buffer(6.0, join_style="mitre", quad_segs=64)
    tips = [Point(*tip).buffer(14.0) for tip in (piece.sew[0].curve.start, piece.sew[0].curve.end)]
    assert cut.symmetric_difference(buffered).difference(tips[0]).difference(tips[1]).area < 3.0


def test_every_edge_has_its_own_allowance():
    lower, upper = lunes(allowance=allowance(9.0, 4.0, 0.0)).pieces
    for piece, widths in ((lower, (9.0, 4.0)), (upper, (4.0, 0.0))):
        cut = LineString(np.vstack((piece.cut_outline(1e-3), piece.cut_outline(1e-3)[:1])))
        for line, width in zip(piece.sew, widths, strict=True):
            for distance in np.linspace(30, line.length - 30, 9):
                assert cut.distance(Point(*line.curve.at(distance)[0])) == pytest.approx(width, abs=0.02)


def test_no_allowance_cuts_along_the_sewing_line():
    for piece in lunes(allowance=allowance(0, 0, 0)).pieces:
        cut, sewn = Polygon(piece.cut_outline(1e-4)), Polygon(piece.sew_outline(1e-4))
        assert cut.symmetric_difference(sewn).area < 1e-3
        assert len(piece.cut) == 2


def past_the_end(piece: CutPiece, name: str, outer: bool) -> float:
    """How far past a seam's end its allowance runs on: the cut line's corner there."""
    number = next(i for i, line in enumerate(piece.sew) if line.name == name)
    line = piece.sew[number]
    curve = line.curve if outer == (number > 0) else line.curve.reversed()  # from that end
    tip, tangent = curve.at(0.0)
    corners = np.concatenate([curve.controls[:, 3] for curve in piece.cut])
    aside = np.abs((corners - tip) @ np.array((-tangent[1], tangent[0])))
    along = -(corners - tip) @ tangent
    return float(along[(np.abs(aside - line.allowance) < 0.02) & (along < 60)].max())


@pytest.mark.parametrize("widths", [(6, 6, 6), (10, 5, 5), (8, 4, 3), (0, 6, 6)])
@pytest.mark.parametrize("panels", [2, 3])
def test_allowances_of_a_seam_end_together(panels, widths):
    """Sewn, the cut lines of both pieces meet past the ends of the seam, though their corners differ."""
    made = lunes(panels, allowance=allowance(*widths))
    for pattern in (made, walked(widths)):
        for below, above in zip(pattern.pieces[:-1], pattern.pieces[1:], strict=True):
            name = below.sew[1].name
            for outer in (False, True):
                ends = [past_the_end(piece, name, outer) for piece in (below, above)]
                assert ends[0] == pytest.approx(ends[1], abs=0.01)
                assert -1e-9 <= ends[0] <= max(widths) + 0.01


def test_a_wide_allowance_runs_past_its_end_only_as_far_as_its_neighbour_is_wide():
    piece = lunes(wire={"casing": 12.0, "play": 0.0, "spring": 0.0}).pieces[0]
    low, high = piece.cut_outline().min(0), piece.cut_outline().max(0)
    start, end = piece.sew[0].curve.start, piece.sew[0].curve.end
    assert past_the_end(piece, "wire", outer=True) == pytest.approx(6.0, abs=0.02)
    assert max(start[0] - low[0], high[0] - end[0]) < 18.0


def walked(widths: tuple[float, float, float]) -> Pattern:
    """Two panels whose corners differ much: one sharp, one blunt, with one seam."""
    x = torch.linspace(0, 100, 401, dtype=torch.float64)
    bump = x * (100 - x) / 2500
    panels = [
        FlatPanel(torch.stack((x, -10 * bump), -1), torch.stack((x, 20 * bump), -1)),
        FlatPanel(torch.stack((x, -20 * bump), -1), torch.stack((x, 90 * bump), -1)),
    ]
    return finish(pieces_from_panels(panels), PatternOptions(allowance=allowance(*widths)), name="x", side="left")


def test_matching_notches_are_at_the_same_distance_and_double_towards_the_outer_end():
    pattern = lunes(3, apex=APEX + np.array((0, 12.0, 0)))
    assert set(pattern.seams) == {"wire", "seam 1", "seam 2", "upper edge"}
    for below, above in zip(pattern.pieces[:-1], pattern.pieces[1:], strict=True):
        name = below.sew[1].name
        sides = [[n for n in piece.notches if n.edge == name] for piece in (below, above)]
        assert len(sides[0]) == len(sides[1]) >= 2
        for piece, notches in zip((below, above), sides, strict=True):
            line = next(line for line in piece.sew if line.name == name)
            curve = line.curve if line is piece.sew[0] else line.curve.reversed()  # from the inner end
            dense = LineString(curve.polyline(1e-6))
            for notch in notches:
                assert dense.project(Point(*notch.foot)) == pytest.approx(notch.distance, abs=0.01)
                assert dense.distance(Point(*notch.foot)) < 1e-3
        for a, b in zip(*sides, strict=True):
            assert (a.name, a.distance, len(a.ticks)) == (b.name, b.distance, len(b.ticks))
        matching = [notch for notch in sides[0] if not notch.name]
        assert [len(notch.ticks) for notch in matching] == [1, 2]
        assert matching[0].distance < pattern.seams[name][0] / 2 < matching[1].distance


def test_notches_begin_on_the_cut_line_and_stay_off_the_sewing_line():
    for piece in lunes(allowance=allowance(3, 9, 6), notch_depth=4.0).pieces:
        cut, sewn = Polygon(piece.cut_outline(1e-4)), Polygon(piece.sew_outline(1e-4))
        for notch in piece.notches:
            width = next(line.allowance for line in piece.sew if line.name == notch.edge)
            for root, end in notch.ticks:
                assert cut.exterior.distance(Point(*root)) < 0.02
                depth = np.linalg.norm(end - root)
                assert depth == pytest.approx(min(4.0, 2 * width / 3), abs=1e-6)
                assert sewn.distance(Point(*end)) == pytest.approx(width - depth, abs=0.02)


@pytest.mark.parametrize("form", ["slit", "v", "t"])
def test_edges_without_allowance_get_no_cut(form):
    """Not even near the edge: nothing that is cut lies in the finished piece."""
    for widths in ((6, 6, 0), (0, 6, 6), (0, 0, 0)):
        for piece in lunes(allowance=allowance(*widths), notch_form=form).pieces:
            sewn = Polygon(piece.sew_outline(1e-4)).buffer(-0.02)
            cut = [notch for notch in piece.notches if notch.is_cut]
            assert not any(sewn.intersects(LineString(line)) for notch in cut for line in notch.strokes)
            bare = {line.name for line in piece.sew if line.allowance == 0}
            assert {notch.edge for notch in piece.notches if not notch.is_cut} == bare & {n.edge for n in piece.notches}
            layers = {item.role: item.layer for item in drawn(piece, "p") if isinstance(item, Stroke)}
            assert layers.get("tick", "text") == "text"
            assert ("tick" in layers) == bool(bare)


def test_landmarks_are_marked_where_they_lie():
    lower, upper = lunes(apex=APEX + np.array((3.0, 12.0, 3.0))).pieces
    # the lune's ridge is the wire turned: arc length is the angle from the inner end
    angle = np.arctan2(12.0, RADIUS + np.hypot(3, 3)) + np.pi / 2
    for piece in (lower, upper):
        (match,) = (n for n in piece.notches if n.name in ("match point", "bust point"))
        assert (match.edge, len(match.ticks)) == ("seam", 1)
        assert match.distance == pytest.approx(RADIUS * angle, abs=0.05)
    (strap,) = (n for n in upper.notches if n.name == "strap point")
    assert strap.distance == pytest.approx(HALF, abs=0.05)
    np.testing.assert_allclose(strap.foot[0], np.ptp(upper.sew_outline()[:, 0]) / 2, atol=0.05)


def test_notches_keep_clear_of_landmarks():
    seam = 2 * HALF
    angle = 2 * np.pi / 3 - 0.02
    apex = RADIUS * np.array([np.sin(angle) / np.sqrt(2), 1 - np.cos(angle), np.sin(angle) / np.sqrt(2)])
    for piece in lunes(apex=apex).pieces:
        places = sorted(n.distance for n in piece.notches if n.edge == "seam")
        assert np.diff(places).min() > 12, "five times as far apart as the cuts of a double notch"
        assert places[-1] > seam * 2 / 3


def test_drill_hole_only_where_the_apex_falls_on_the_piece():
    on_the_ridge = lunes(apex=APEX)
    assert [len(piece.holes) for piece in on_the_ridge.pieces] == [0, 0]
    angle = np.pi / 8
    on_the_lower = lunes(apex=RADIUS * np.array([np.cos(angle), 1.0, np.sin(angle)]))
    assert [len(piece.holes) for piece in on_the_lower.pieces] == [1, 0]
    (hole,) = on_the_lower.pieces[0].holes
    np.testing.assert_allclose(hole.point, (np.ptp(on_the_lower.pieces[0].sew_outline()[:, 0]) / 2, 0), atol=0.05)


@pytest.mark.parametrize("panels", [2, 3])
@pytest.mark.parametrize("grain", [0.0, 45.0, 90.0])
def test_grain_line_keeps_off_sewing_lines_and_leaders_off_the_grain_line(panels, grain):
    for piece in lunes(panels, grain=grain, apex=APEX + np.array((3.0, 12.0, -12.0))).pieces:
        line = LineString(piece.grain)
        assert Polygon(piece.sew_outline(1e-3)).exterior.distance(line) > 3.9
        leaders = [LineString(c.leader) for c in piece.captions if c.leader is not None]
        assert all(leader.distance(line) > 1.5 for leader in leaders)


def test_ease_stretches_pieces_but_not_allowances():
    plain, eased = lunes(), lunes(ease={"width": -8.0, "height": 5.0})
    for a, b in zip(plain.pieces, eased.pieces, strict=True):
        size, stretched = (np.ptp(piece.sew_outline(1e-6), axis=0) for piece in (a, b))
        np.testing.assert_allclose(stretched / size, (0.92, 1.05), atol=1e-6)
        assert b.area / a.area == pytest.approx(0.92 * 1.05, abs=1e-5)
        assert "ease width -8 %, height +5 %" in b.label.lines
        assert "no ease" in a.label.lines
        assert past_the_end(b, "seam", outer=False) == pytest.approx(6.0, abs=0.02)
        for m, n in zip(a.notches, b.notches, strict=True):
            np.testing.assert_allclose(n.foot, m.foot * (0.92, 1.05), atol=1e-9)


def cloth(stretch: float = 0.0, across: float = 0.0, thickness: float = 0.0) -> dict[str, float]:
    return {"thickness": thickness, "stretch": stretch, "stretch_across": across}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("grain", [90.0, 25.0])
def test_cloth_that_stretches_covers_the_cup_again(grain, side):
    """The cut piece, stretched along and across its own grain line as was said, is the piece as it is worn."""
    plain, cut = (lunes(side=side, grain=grain, cloth=own) for own in (cloth(), cloth(stretch=20.0, across=5.0)))
    for worn, piece in zip(plain.pieces, cut.pieces, strict=True):
        along = piece.grain[1] - piece.grain[0]
        along /= np.linalg.norm(along)
        np.testing.assert_allclose(
            abs(along @ (worn.grain[1] - worn.grain[0])), np.linalg.norm(np.diff(worn.grain, axis=0))
        )
        across = np.array((-along[1], along[0]))
        points = piece.sew_outline(1e-4)
        stretched = 1.2 * (points @ along)[:, None] * along + 1.05 * (points @ across)[:, None] * across
        away = [Polygon(worn.sew_outline(1e-4)).exterior.distance(Point(*point)) for point in stretched[::5]]
        assert max(away) < 1e-3
        assert piece.area * 1.2 * 1.05 == pytest.approx(worn.area, abs=1e-3)
        told = piece.label.whole
        assert "stretch 20 % along grain: 16.7 % less" in told
        assert "stretch 5 % across grain: 4.8 % less" in told


def test_pieces_of_the_two_sides_are_mirror_images_whatever_the_grain():
    (left, right) = (lunes(side=side, grain=30.0, cloth=cloth(20.0)).pieces for side in ("left", "right"))
    for one, other in zip(left, right, strict=True):
        outline = Polygon(other.mirrored().sew_outline(1e-3))
        assert Polygon(one.sew_outline(1e-3)).symmetric_difference(outline).area < 1e-3 * one.area


def test_seams_match_in_cloth_that_stretches_alike_both_ways_and_are_told_otherwise():
    pieces = pieces_from_panels([lune_flat(2)[0], a_bent_panel()])
    for along, across, unequal in ((20.0, 20.0, False), (20.0, 0.0, True)):
        options = PatternOptions(cloth=cloth(along, across))
        found = finish(pieces, options, name="x", side="left")
        sides = [line.length for piece in found.pieces for line in piece.sew if line.name == "seam"]
        assert (abs(sides[0] - sides[1]) > 0.5) == unequal
        assert found.reshaped
        assert found.seam_difference == pytest.approx(abs(sides[0] - sides[1]))
        told = [str(one) for one in found.warnings if one.code == "seam_sides_differ" and one.about == "seam"]
        assert len(told) == unequal
        if unequal:
            assert f"with this stretch its sides are {abs(sides[0] - sides[1]):.1f} mm" in told[0]
        else:
            assert max(sides) - min(sides) < 1e-3


def test_labels_name_thick_cloth():
    plain, thick = lunes(), lunes(cloth=cloth(thickness=3.0))
    assert all("cloth 3.0 mm thick" in piece.label.lines for piece in thick.pieces)
    for one, other in zip(plain.pieces, thick.pieces, strict=True):
        np.testing.assert_array_equal(one.cut_outline(), other.cut_outline())


@pytest.mark.parametrize("grain", [0.0, 30.0, 90.0])
def test_grain_line_and_label_are_on_the_piece(grain):
    for piece in lunes(3, grain=grain).pieces:
        sewn = Polygon(piece.sew_outline(1e-3))
        start, end = piece.grain
        angle = np.degrees(np.arctan2(*(end - start)[::-1]))
        assert angle == pytest.approx(grain, abs=1e-6)
        assert sewn.contains(LineString(piece.grain))
        assert np.linalg.norm(end - start) > 15
        assert sewn.contains(Polygon(piece.label.corners))
        assert piece.label.size > 2


@pytest.mark.parametrize("panels", [3, 4])
@pytest.mark.parametrize("scale", [0.45, 0.6, 1.0])
def test_labels_stay_on_their_piece_with_cloth_and_warnings(panels, scale):
    """What a cutter needs goes before warnings, which page and DXF file have in full; the name is always there."""
    own = cloth(20.0, thickness=3.0)
    found = small(panels, scale, cloth=own, material_width=30.0)
    assert all(piece.warnings for piece in found.pieces)
    for piece in found.pieces:
        label = piece.label
        assert Polygon(piece.sew_outline(1e-3)).contains(Polygon(label.corners))
        assert label.lines[0].split(", ")[0] == piece.name
        everything = " ".join(label.whole)
        assert all(words in everything for words in ("cut 1", "allowance", "cloth 3.0 mm thick", "stretch 20 %"))
        assert all(words in " ".join(label.whole) for words in map(str, piece.warnings))
        if scale == 1.0 or (panels == 3 and scale == 0.6):  # small letters, before anything of it is left out
            assert all(words in " ".join(label.lines) for words in ("cut 1", "allowance", "cloth 3.0", "stretch 20"))


def test_the_other_side_keeps_the_name_of_a_scan_that_holds_a_side():
    pieces = pieces_from_panels(lune_flat(2))
    made = finish(pieces, PatternOptions(pair=True), name="her left cup again", side="left")
    for piece, other in zip(*made.drawn, strict=True):
        for label, side in ((piece.label, "left"), (other.label, "right")):
            words = ", ".join(label.lines).split(", ")
            assert f"{side} cup" in words
            assert "her left cup again" in words


def test_labels_say_what_a_cutter_needs():
    pattern = lunes(size="75B", pair=True, quantity=2, allowance=allowance(8, 6, 6))
    about = ("size 75B", "cut 2", "allowance wire 8.0 mm, seam 6.0 mm", "no ease", "2001-02-03")
    assert pattern.pieces[0].label.lines == ("lower panel", "piece 1 of 2", "lune", "left cup", *about)
    mirrored = pattern.drawn[1][0].label.lines
    assert mirrored == ("lower panel", "piece 1 of 2", "lune", "right cup", *about), "both sides cut as often"
    assert sum("lune" in line for line in lunes().pieces[1].label.lines) == 1, "the name stands there once"
    inches = lunes(units="inch").pieces[0]
    assert "allowance 0.24 in (6 mm)" in inches.label.lines


def test_wire_channel_is_off_by_default_and_notched_where_the_wire_ends():
    plain = lunes().pieces[0]
    assert not any(notch.name == "wire end" for notch in plain.notches)
    made = lunes(wire={"casing": 12.0, "play": 7.0, "spring": 5.0}).pieces[0]
    wire, ridge = made.sew
    assert (wire.allowance, ridge.allowance) == (18.0, 6.0)
    assert "casing 12.0 mm more" in made.label.lines
    ends = sorted(notch.distance for notch in made.notches if notch.name == "wire end")
    np.testing.assert_allclose(ends, (7.0, wire.length - 7.0), atol=1e-6)
    assert "wire end" in {caption.words for caption in made.captions}
    np.testing.assert_allclose(made.sew_outline(), plain.sew_outline(), atol=1e-9)


@pytest.mark.parametrize("form", ["slit", "v", "t"])
def test_forms_of_notches(form):
    """All reach as deep; a V is open on the cut line, a T's bar lies at the end."""
    for piece in lunes(notch_form=form, notch_width=4.0).pieces:
        cut = Polygon(piece.cut_outline(1e-3)).exterior
        for notch in piece.notches:
            lines = notch.strokes
            assert len(lines) == len(notch.ticks) * (2 if form == "t" else 1)
            if form == "v":
                for mouth, tip, other in lines:
                    assert np.linalg.norm(other - mouth) == pytest.approx(4.0)
                    assert max(cut.distance(Point(*p)) for p in (mouth, other)) < 0.3
                    assert cut.distance(Point(*tip)) == pytest.approx(3.0, abs=0.05)
            if form == "t":
                (a, b), tick = lines[1], notch.ticks[0]
                np.testing.assert_allclose((a + b) / 2, tick[1], atol=1e-9)
                assert (b - a) @ (tick[1] - tick[0]) == pytest.approx(0, abs=1e-9)
            if len(notch.ticks) == 2:
                assert np.linalg.norm(notch.ticks[1, 0] - notch.ticks[0, 0]) > (3 if form == "slit" else 6)


def test_line_of_cloth_that_stretches_is_named_so():
    assert {"grain line"} == {c.words for p in lunes().pieces for c in p.captions} & {"grain line", "greatest stretch"}
    stretch = lunes(arrow="stretch", grain=0.0).pieces
    assert all("greatest stretch" in {caption.words for caption in piece.captions} for piece in stretch)
    assert not any("grain line" in {caption.words for caption in piece.captions} for piece in stretch)


def test_bust_point_is_named_where_it_lies_and_no_seam_notch_is_called_so():
    made = lunes(apex=APEX + np.array((3.0, 12.0, -12.0)))
    (holed,) = (piece for piece in made.pieces if piece.holes)
    captions = {caption.words: caption for caption in holed.captions}
    assert np.linalg.norm(captions["bust point"].at - holed.holes[0].point) < 20
    assert all({"match point"} == {n.name for n in p.notches if n.edge == "seam" and n.name} for p in made.pieces)
    on_seam = lunes(apex=APEX)
    assert not any(piece.holes for piece in on_seam.pieces)
    assert all("bust point" in {notch.name for notch in piece.notches} for piece in on_seam.pieces)
    assert all({"centre front", "side seam"} <= {c.words for c in piece.captions} for piece in made.pieces)


def test_pair_is_drawn_as_mirror_images():
    own, other = lunes(pair=True).drawn
    for a, b in zip(own, other, strict=True):
        assert (a.side, b.side) == ("left", "right")
        assert "right cup" in b.label.lines
        assert b.label.along[0] > 0
        np.testing.assert_allclose(b.cut_outline(), a.cut_outline() * (-1, 1))
    assert len(lunes().drawn) == 1


def crossing_panel() -> FlatPanel:
    x = torch.linspace(0, 100, 41, dtype=torch.float64)
    wave = torch.sin(x * torch.pi / 50)
    wave[[0, -1]] = 0
    return FlatPanel(torch.stack((x, 0 * x), -1), torch.stack((x + 0.3 * wave, 10 * wave), -1))


def hollow_panel(radius: float) -> FlatPanel:
    """A panel whose upper edge has a dent of that radius."""
    x = torch.linspace(0, 100, 401, dtype=torch.float64)
    dent = torch.exp(-((x - 50) ** 2) / (2 * 6.0**2)) * 6.0**2 / radius
    return FlatPanel(torch.stack((x, -x * (100 - x) / 60), -1), torch.stack((x, x * (100 - x) / 60 - dent), -1))


def finished(panel: FlatPanel, **options) -> Pattern:
    return finish(pieces_from_panels([panel]), PatternOptions(**options), name="x", side="left")


def test_outline_that_crosses_itself_is_told_on_the_piece():
    pattern = finished(crossing_panel())
    assert [(one.code, one.about) for one in pattern.warnings] == [("crosses_itself", pattern.pieces[0].name)]
    assert [one.code for one in pattern.pieces[0].warnings] == ["crosses_itself"]
    assert "crosses itself" in " ".join(pattern.pieces[0].label.notice)


@pytest.mark.parametrize("radius", [3.0, 5.0, 8.0])
def test_allowance_follows_a_tight_bend_and_is_nowhere_narrower(radius):
    """Tighter than the allowance is wide, so that the parallel folds back on itself."""
    made = finished(hollow_panel(radius), allowance=allowance(6, 6, 12))
    assert made.warnings == ()
    (piece,) = made.pieces
    cut = Polygon(piece.cut_outline(1e-3))
    assert cut.is_valid
    upper = shapely.points(tips_apart(piece.sew[1].curve.polyline(1e-3), piece, 14.0))
    assert shapely.distance(upper, cut.exterior).min() > 12 - 0.02
    assert shapely.contains(cut, upper).all()
    for curve, after in zip(piece.cut, piece.cut[1:] + piece.cut[:1], strict=True):
        np.testing.assert_allclose(curve.end, after.start, atol=1e-4)


def test_trimmed_outline_is_that_of_shapely_with_its_hollow_rounded():
    (piece,) = finished(hollow_panel(3.0), allowance=allowance(8, 8, 8)).pieces
    buffered = Polygon(piece.sew_outline(1e-3)).buffer(8.0, join_style="mitre", quad_segs=64)
    rounded = buffered.buffer(4.0, quad_segs=64).buffer(-4.0, quad_segs=64)
    tips = [Point(*tip).buffer(20.0) for tip in (piece.sew[0].curve.start, piece.sew[0].curve.end)]
    gap = Polygon(piece.cut_outline(1e-3)).symmetric_difference(rounded)
    assert gap.difference(tips[0]).difference(tips[1]).area < 0.5


def test_hollow_that_the_allowance_bridges_is_told():
    made = finished(hollow_panel(1.0), allowance=allowance(6, 6, 12))
    assert [one.code for one in made.warnings] == ["allowance_bridges"]
    assert "bridges" in " ".join(made.pieces[0].label.notice)
    cut = Polygon(made.pieces[0].cut_outline())
    assert cut.is_valid
    assert cut.buffer(0.05).contains(Polygon(made.pieces[0].sew_outline()))


def test_notches_in_a_hollow_begin_on_the_cut_line():
    deep = finished(hollow_panel(2.0), allowance=allowance(6, 6, 12))
    marked = finish(
        [replace(p, edges=(p.edges[0], replace(p.edges[1], marks=(Mark("strap point", 45.0),))))
         for p in pieces_from_panels([hollow_panel(2.0)])],
        deep.options, name="x", side="left",
    )  # fmt: skip
    (piece,) = marked.pieces
    cut = Polygon(piece.cut_outline(1e-3)).exterior
    (notch,) = (n for n in piece.notches if n.name)
    assert cut.distance(Point(*notch.ticks[0, 0])) < 0.02


@pytest.mark.parametrize("panels", [1, 2, 3, 6])
@pytest.mark.parametrize("side", ["left", "right"])
def test_texts_keep_clear_of_lines_and_of_each_other(panels, side):
    for made in (lunes(panels, side, pair=True), lunes(panels, side, allowance=allowance(0, 3, 0))):
        for piece in (piece for column in made.drawn for piece in column):
            lines = [LineString(np.vstack((line, line[:1]))) for line in (piece.sew_outline(), piece.cut_outline())]
            lines += [LineString(piece.grain), *(LineString(t) for n in piece.notches for t in n.ticks)]
            boxes = [Polygon(piece.label.corners), *(Polygon(caption.corners) for caption in piece.captions)]
            assert len(boxes) >= 3
            assert not any(box.intersects(line) for box in boxes for line in lines)
            assert not any(a.intersects(b) for i, a in enumerate(boxes) for b in boxes[:i])
            assert not any(box.distance(Point(*hole.point)) < 3 for box in boxes for hole in piece.holes)
            low, high = piece.bounds
            corners = np.concatenate([np.asarray(box.exterior.coords) for box in boxes])
            assert (corners > low - 1e-9).all()
            assert (corners < high + 1e-9).all()


def test_seams_that_ease_makes_unequal_are_told():
    alike = lunes(3, ease={"width": -5.0, "height": -5.0})
    assert alike.warnings == ()
    shifted = finish(
        pieces_from_panels([lune_flat(2)[0], a_bent_panel()]),
        PatternOptions(ease={"width": -20.0, "height": 0.0}), name="x", side="left",
    )  # fmt: skip
    sides = [line.length for piece in shifted.pieces for line in piece.sew if line.name == "seam"]
    assert abs(sides[0] - sides[1]) > 1
    (words,) = (str(one) for one in shifted.warnings if one.code == "seam_sides_differ")
    assert f"{abs(sides[0] - sides[1]):.1f} mm" in words
    assert all("WARNING: seam" in " ".join(piece.label.notice) for piece in shifted.pieces)
    assert all(words in " ".join(p.label.whole) for p in shifted.pieces)


def a_bent_panel() -> FlatPanel:
    """Its lower edge is as long as the lunes' ridge, but a circular arc of a third of a turn."""
    length = 2 * HALF
    angle = torch.linspace(-torch.pi / 3, torch.pi / 3, 101, dtype=torch.float64)
    radius = length / (2 * torch.pi / 3)
    lower = torch.stack((radius * torch.sin(angle), -radius * torch.cos(angle)), -1)
    bump = 30 * torch.cos(1.5 * angle)
    return FlatPanel(lower, lower + torch.stack((0 * bump, bump), -1))


def test_seam_sides_of_different_length_are_told_on_both_pieces():
    a, b = lune_flat(2)
    longer = FlatPanel(b.lower * 1.01, b.upper * 1.01)
    pattern = finish(pieces_from_panels([a, longer]), PatternOptions(), name="x", side="left")
    (told,) = pattern.warnings
    assert (told.code, told.about) == ("seam_sides_differ", "seam")
    assert "2.5" in told.text
    assert all(piece.warnings == (told,) for piece in pattern.pieces)
    quiet = finish(pieces_from_panels([a, longer]), PatternOptions(seam_tolerance=3.0), name="x", side="left")
    assert quiet.warnings == ()


def test_pieces_wider_than_the_material_are_told():
    assert lunes(material_width=260.0).warnings == ()
    assert [one.code for one in lunes(material_width=250.0).warnings] == ["too_wide"] * 2
    assert lunes(material_width=100.0, grain=0.0).warnings == ()


def test_twisted_panels_are_told():
    assert lunes(figures={"twist_deg_max": 2.0}).warnings == ()
    (told,) = lunes(figures={"twist_deg_max": 4.0}).warnings
    assert (told.code, "twist up to 4.0 degrees" in told.text) == ("not_developable", True)


def test_areas_and_lengths_of_the_finished_pieces():
    for piece in lunes().pieces:
        assert piece.area == pytest.approx(lune_area(2), rel=1e-4)
        for line in piece.sew:
            assert line.length == pytest.approx(2 * HALF, abs=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"formats": ["svg", "docx"]}, "pattern.formats=docx"),
        ({"units": "cm"}, "pattern.units=cm"),
        ({"paper": "a0"}, "pattern.paper=a0"),
        ({"allowance": {"wire": 6.0, "ridge": -1.0, "upper": 6.0}}, "pattern.allowance.ridge=-1"),
        ({"allowance": {"wire": 6.0}}, "pattern.allowance.ridge=None"),
        ({"ease": {"width": -80.0, "height": 0.0}}, "pattern.ease.width"),
        ({"cloth": {"thickness": 0.0, "stretch": -5.0, "stretch_across": 0.0}}, "pattern.cloth.stretch=-5"),
        ({"cloth": {"stretch": 0.0, "stretch_across": 0.0}}, "pattern.cloth.thickness=None"),
        ({"quantity": 0}, "pattern.quantity=0"),
        ({"notch_form": "u"}, "pattern.notch_form=u: must be one of slit, v, t"),
        ({"notch_width": -1.0}, "pattern.notch_width=-1"),
        ({"wire": {"casing": 0.0, "play": -2.0, "spring": 0.0}}, "pattern.wire.play=-2"),
        ({"wire": {"casing": 0.0, "play": 0.0}}, "pattern.wire.spring=None"),
    ],
)
def test_wrong_options_are_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        PatternOptions(**options)
