"""How a sheet looks to an independent reader: boxes of texts and marks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from check_pages import sheet_figures
from patterns import pattern, small
from shapely import LineString, Point, Polygon

from brafit.pattern import Pattern, write_svg
from brafit.pattern.drawing import RED, Words
from brafit.pattern.finish import warnings_of
from brafit.pattern.label import text_width
from brafit.pattern.lettering import LEAST, shortened, wrapped
from brafit.pattern.pages import MARGIN, paper_pages
from brafit.pattern.sheet import sheet_page
from brafit.remarks import Remark


@pytest.mark.parametrize("panels", [1, 2, 3])
@pytest.mark.parametrize("options", [{}, {"pair": True, "notch_form": "v", "arrow": "stretch"}])
def test_nothing_overlaps_and_labels_are_on_their_pieces(tmp_path, panels, options):
    pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    channel = {"casing": 10.0, "play": 5.0, "spring": 0.0}
    for made in (pattern(panels, **options), small(panels, wire=channel, **options)):
        write_svg(tmp_path / "p.svg", [made], "lune", "a note")
        figures = sheet_figures(tmp_path / "p.svg")
        assert figures.pop("seam ends: allowances of the two sides end apart") < 0.05
        assert set(figures.values()) == {0}, figures


def test_what_overlaps_is_found(tmp_path):
    pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    write_svg(tmp_path / "p.svg", [pattern()], "lune")
    text = (tmp_path / "p.svg").read_text(encoding="utf-8")
    (tmp_path / "p.svg").write_text(text.replace('font-size="4.0"', "").replace(">piece 1 of 2<", f">{'piece ' * 30}<"))
    figures = sheet_figures(tmp_path / "p.svg")
    assert figures["sheet: texts or marks that overlap"] > 0
    assert figures["sheet: labels not on their piece"] == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "left cup, 2 pieces cut each piece once"),
        ({"pair": True}, "left and right cup, 4 pieces cut each piece once"),
        ({"pair": True, "quantity": 3}, "left and right cup, 4 pieces cut each piece 3 times"),
    ],
)
def test_cover_and_sheet_say_which_sides_and_what_size_are_drawn_and_how_often_each_is_cut(options, words):
    made = pattern(size="75B", **options)
    for page in (paper_pages([made], "lune")[0], sheet_page([made], "lune")):
        info = " ".join(item.text for item in page.items if isinstance(item, Words) and item.layer == "info")
        assert f"size 75B {words}" in info


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "allowances: wire 6.0 mm, seam 6.0 mm, upper 6.0 mm"),
        (
            {"wire": {"casing": 9.0, "play": 0.0, "spring": 0.0}, "units": "inch"},
            "allowances: wire 0.39 in (10 mm), casing 0.35 in (9 mm) more, seam 0.24 in (6 mm), upper 0.00 in",
        ),
    ],
)
def test_cover_and_sheet_list_the_allowances(options, words):
    """Labels of narrow pieces may have no room for them."""
    widths = {"wire": 10.0, "ridge": 6.0, "upper": 0.0} if options else {"wire": 6.0, "ridge": 6.0, "upper": 6.0}
    made = small(3, 0.4, allowance=widths, **options)
    for page in (paper_pages([made], "lune")[0], sheet_page([made], "lune")):
        info = " ".join(item.text for item in page.items if isinstance(item, Words) and item.layer == "info")
        assert words in info


def test_narrow_labels_keep_size_allowance_and_how_often_to_cut():
    """Rather than the scan's name, the piece's number and the cloth, which the legend has."""
    cloth = {"thickness": 2.0, "stretch": 20.0, "stretch_across": 0.0}
    widths = {"wire": 10.0, "ridge": 6.0, "upper": 6.0}
    made = small(4, 0.6, allowance=widths, cloth=cloth, size="75 D", material_width=30.0)
    told = [", ".join(piece.label.lines) for piece in made.pieces]
    assert any("stretch" not in words for words in told), "they are narrow"
    for words in told:
        assert all(one in words for one in ("left cup", "size 75 D", "cut 1", "allowance"))


@pytest.mark.parametrize(
    ("ease", "words"),
    [(0.0, "finished dimensions (sewing lines)"), (-5.0, "finished dimensions (sewing lines, as cut)")],
)
def test_cover_says_that_dimensions_are_as_cut(ease, words):
    cover = paper_pages([pattern(ease={"width": ease, "height": 0.0})], "lune")[0]
    assert words in {item.text for item in cover.items if isinstance(item, Words)}


@cache
def warned() -> Pattern:
    """A narrow cup, each piece of it with a warning of many words."""
    return small(3, 0.45, material_width=30.0)


@pytest.mark.parametrize("name", ["lune", "a name of many words " * 20, "x" * 300])
def test_what_is_told_about_the_pieces_can_be_read_on_paper(name):
    """Warnings are wrapped to lines of the legend's letters, and go on on another page where one is full."""
    narrow = warned()
    several = [replace(narrow, name=f"{name} {k}", size=f"{k}") for k in range(6)]
    pages = [sheet_page([narrow], name), *paper_pages([narrow], name)]
    first = len(pages)
    pages += paper_pages(several, name)
    for page in pages:
        told = [item for item in page.items if isinstance(item, Words) and item.layer == "info"]
        assert min((item.size for item in told), default=LEAST) >= LEAST
        corners = np.concatenate([item.corners for item in told])
        assert corners.min() >= 0
        assert (corners <= (page.width, page.height)).all()
        warnings = [item.corners for item in told if item.colour == RED]
        assert all(box[:, 1].min() > MARGIN for box in warnings), "above the page's number"
    for patterns, own in (([narrow], pages[:1]), (several, pages[first:])):
        texts = [item for page in own for item in page.items if isinstance(item, Words)]
        printed = "".join(item.text for item in texts if item.layer == "info" and item.colour == RED)
        wanted = "".join(f"WARNING: {words}" for words in warnings_of(patterns))
        assert "".join(printed.split()) == "".join(wanted.split())


def test_a_warning_is_not_broken_across_pages():
    """However far down on the cover the last one begins."""
    words = "of so many words that it takes lines " * 6
    for above in range(6):
        told = [f"short {k}" for k in range(above)] + [f"doubt {k}, {words} end {k}" for k in range(12)]
        made = replace(warned(), fit_warnings=tuple(Remark("unsure", one) for one in told))
        pages = paper_pages([made], "lune")
        texts = [[item for item in page.items if isinstance(item, Words) and item.layer == "info"] for page in pages]
        read = [" ".join(item.text for item in own if item.colour == RED) for own in texts]
        assert sum("doubt" in page for page in read) > 1
        for k in range(12):
            (page,) = (page for page in read if f"doubt {k}," in page)
            assert f"end {k}" in page


def test_a_sentence_is_wrapped_and_a_name_is_shortened_in_its_middle():
    words = "one of many words, " * 9
    lines = wrapped(words, 3.4, 90.0, bold=True)
    assert " ".join(lines) == words.strip()
    assert all(text_width(line, 3.4, bold=True) <= 90 for line in lines)
    name = shortened("a" * 99 + "z", 3.0, 60.0)
    assert (name[0], name[-1], name.count("…")) == ("a", "z", 1)
    assert 50 < text_width(name, 3.0) <= 60
    assert shortened("anna", 3.0, 60.0) == "anna"


@pytest.mark.parametrize(("panels", "options"), [(2, {}), (3, {"pair": True}), (4, {"scale": 0.4})])
def test_both_pieces_of_a_seam_bear_its_name_beside_it(panels, options):
    """So a middle panel, whose two edges look alike, is not sewn in upside down."""
    made = (small if "scale" in options else pattern)(panels, **options)
    for piece in (piece for column in made.drawn for piece in column):
        seams = {line.name: line for line in piece.sew if line.kind == "ridge"}
        named = {caption.words: caption for caption in piece.captions if caption.words in seams}
        assert set(named) == set(seams)
        cut = Polygon(piece.cut_outline())
        for name, caption in named.items():
            away = {
                key: LineString(line.curve.polyline(0.05)).distance(Point(caption.at)) for key, line in seams.items()
            }
            assert min(away, key=lambda key: away[key]) == name
            assert away[name] < 6
            assert cut.contains(Polygon(caption.corners))
