"""Wires by size: their charts, what texts mean, and their shapes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from brafit.cup.wire import Wire
from brafit.errors import ConfigError
from brafit.scan.wiring import WIRE_POINTS
from brafit.underwires.charts import CHARTS, REGULAR, diameter
from brafit.underwires.sizes import CATALOGUE, wire_size

LINES = {
    "orange": (lambda n: 173 + 7.5 * (n - 30), range(30, 53, 2)),
    "harriet": (lambda n: 165 + 7.45 * (n - 30), range(30, 59, 2)),
    "flexlite": (lambda n: 267 + 8.3 * (n - 44), range(44, 61, 2)),
    "france": (lambda n: 127 + 7.5 * (n - 30), range(30, 51, 2)),
}
"""The charts as they were read."""
ROOT = Path(__file__).parents[2]
SHAPES = [*CATALOGUE, wire_size("36"), wire_size("60"), wire_size("36/short"), wire_size("65x180"), wire_size("65x230")]


def length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


@pytest.mark.parametrize("maker", LINES)
def test_lengths_are_those_of_the_makers_charts(maker):
    line, sizes = LINES[maker]
    assert [wire_size(f"{maker}:{n}").length for n in sizes] == pytest.approx([line(n) for n in sizes], abs=1e-9)
    for beyond in (sizes[0] - 2, sizes[-1] + 2, sizes[0] + 1):
        with pytest.raises(ConfigError, match=rf"^scan\.wire={maker}:{beyond}: {maker} does not sell"):
            wire_size(f"{maker}:{beyond}")


def test_every_chart_is_read_twice_and_told_wherever_makers_are():
    """By LINES, by the table in docs/settings.md, and by the comment in conf/scan/default.yaml."""
    assert LINES.keys() == {chart.maker for chart in CHARTS}
    page = (ROOT / "docs/settings.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+):\d+(/\w+)?` \| .*?\b(regular|short), (\d+) to (\d+) ", page, re.MULTILINE)
    told = {(maker, style, int(first), int(last)) for maker, _, style, first, last in rows}
    assert told == {(chart.maker, chart.style, chart.smallest, chart.largest) for chart in CHARTS}
    assert all(form == ("" if style == REGULAR else f"/{style}") for _, form, style, _, _ in rows)
    comment = " ".join((ROOT / "conf/scan/default.yaml").read_text(encoding="utf-8").replace("\n#", "").split())
    (makers,) = re.findall(r"\(a maker's: ([\w, ]+)\)", comment)
    assert makers.split(", ") == [chart.maker for chart in CHARTS]


def test_diameters_are_those_of_the_independent_chart():
    assert [round(diameter(n) / 10, 1) for n in (30, 32, 60)] == [9.7, 10.6, 22.4]


def test_regular_wires_are_longer_than_half_circles_and_short_ones_shorter():
    for chart in CHARTS:
        shares = [chart.length_of(n) / (np.pi * diameter(n) / 2) for n in chart.sizes]
        assert (1.07 < min(shares) <= max(shares) < 1.14) if chart.style == REGULAR else max(shares) < 0.97


def test_a_size_without_maker_is_the_median_of_those_that_sell_it():
    assert wire_size("36").length == pytest.approx((218 + 209.7) / 2)
    assert wire_size("44").length == pytest.approx(269.3)  # Harriet's, between FlexLite's and Orange's
    assert wire_size("60").length == pytest.approx(267 + 8.3 * 16)
    assert wire_size("36/short").length == pytest.approx(172)
    assert wire_size("36").radius == wire_size("36/short").radius == pytest.approx((4 + 5 / 6) * 25.4 / 2)


def test_a_maker_of_short_wires_only_needs_no_style():
    assert wire_size("france:36") == wire_size("france:36/short") == wire_size("France:36")
    assert wire_size("france:36").name == "france:36/short"
    assert wire_size("harriet:36").name == "harriet:36"


@pytest.mark.parametrize("family", ["{}", "{}/short", *(f"{maker}:{{}}" for maker in LINES)])
def test_every_size_is_longer_and_wider_than_the_one_before(family):
    sizes = range(30, 51 if family == "{}/short" else 61, 2) if ":" not in family else LINES[family.split(":")[0]][1]
    wires = [wire_size(family.format(n)) for n in sizes]
    assert np.diff([wire.length for wire in wires]).min() > 5
    assert np.diff([wire.span for wire in wires]).min() > 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("37", "nobody sells a regular wire of size 37"),
        ("62", "nobody sells a regular wire of size 62"),
        ("52/short", "nobody sells a short wire of size 52"),
        ("orange:36/short", "orange does not sell a short wire of size 36"),
        ("purple:36", "no maker purple is known"),
        ("big", "must be null, detect, a size"),
        ("36/long", "must be null, detect, a size"),
        ("harriett:36", "no maker harriett is known; did you mean harriet:36?"),
        ("harriet:", "must be null, detect, a size"),
        ("036", "must be null, detect, a size"),
    ],
)
def test_errors_name_makers_and_sizes_in_one_line(text, words):
    with pytest.raises(ConfigError) as error:
        wire_size(text)
    assert str(error.value).startswith(f"scan.wire={text}: {words}")
    for maker, (_, sizes) in LINES.items():
        assert f"{maker} {sizes[0]} to {sizes[-1]}" in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["65x20", "65x300", "20x80", "300x500"])
def test_a_wire_by_hand_has_limits(text):
    with pytest.raises(ConfigError, match=r"^scan\.wire=\d+x\d+: must be of radius 30 to 200"):
        wire_size(text)


def test_a_wire_laid_and_its_smooth_line_have_the_charts_length():
    for size in SHAPES:
        points = size.line(WIRE_POINTS)
        assert abs(length(points) - size.length) < 0.01, size
        assert abs(Wire.from_polyline(np.column_stack([points, 0 * points[:, 0]])).length.item() - size.length) < 0.01


def test_ends_are_as_far_apart_as_the_diameter_of_a_long_wire_and_the_chord_of_a_short_one():
    for size in SHAPES:
        points = size.line(401)
        np.testing.assert_allclose(points[[0, -1]], [[0, 0], [0, size.span]], atol=1e-9)
        np.testing.assert_allclose(points[::-1] * [1, -1] + [0, size.span], points, atol=1e-6)
        if size.length > np.pi * size.radius:
            assert size.span == pytest.approx(2 * size.radius)
        else:
            centre = [points[:, 0].max() - size.radius, size.span / 2]
            np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), size.radius, atol=1e-5)


def test_a_long_wire_is_tighter_at_the_bottom_straighter_in_the_arms_and_never_curls_inwards():
    for size in SHAPES:
        if size.length < np.pi * size.radius:
            continue
        points = size.line(801)
        turns = np.unwrap(np.arctan2(*np.diff(points, axis=0).T))
        bend = np.abs(np.diff(turns)) / (size.length / 800)
        assert abs(np.degrees(turns[0] - turns[-1])) < 180
        assert bend[400] > 1 / size.radius > 1.2 * bend[0]
        assert np.ptp(points[:, 1]) == pytest.approx(size.span)


def test_the_shape_changes_steadily_where_a_wire_becomes_longer_than_half_a_circle():
    below, above = (wire_size(f"60x{np.pi * 60 + more:.6f}").line(101) for more in (-1e-3, 1e-3))
    assert np.abs(below - above).max() < 0.01
