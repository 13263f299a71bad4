"""How a sheet looks to an independent reader: boxes of texts and marks."""

import pytest
from check_pages import sheet_figures
from patterns import pattern, small

from brafit.pattern import write_svg


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
