"""How a sheet looks to an independent reader: boxes of texts and marks."""

import pytest
from check_pages import sheet_figures
from patterns import pattern, small

from brafit.pattern import write_svg
from brafit.pattern.drawing import Words
from brafit.pattern.pages import paper_pages
from brafit.pattern.sheet import sheet_page


@pytest.mark.parametrize("panels", [1, 2, 3])
@pytest.mark.parametrize("options", [{}, {"pair": True, "notch_form": "v", "stretch": True}])
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
        ({}, "left cup, 2 pieces"),
        ({"pair": True}, "left and right cup, 4 pieces"),
        ({"pair": True, "quantity": 3}, "left and right cup, 4 pieces, cut each 3 times"),
    ],
)
def test_cover_and_sheet_say_which_sides_and_what_size_are_drawn(options, words):
    made = pattern(size="75B", **options)
    for page in (paper_pages([made], "lune")[0], sheet_page([made], "lune")):
        info = {item.text for item in page.items if isinstance(item, Words) and item.layer == "info"}
        assert {words, "size 75B"} <= info


@pytest.mark.parametrize(
    ("ease", "words"),
    [(0.0, "finished dimensions (sewing lines)"), (-5.0, "finished dimensions (sewing lines, as cut)")],
)
def test_cover_says_that_dimensions_are_as_cut(ease, words):
    cover = paper_pages([pattern(ease={"width": ease, "height": 0.0})], "lune")[0]
    assert words in {item.text for item in cover.items if isinstance(item, Words)}
