from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from lunes import lune_flat

from brafit.cup.names import panel_names
from brafit.pattern.piece import pieces_from_panels
from brafit.report.band import SHOWN, band_svg, magnification

SVG = "{http://www.w3.org/2000/svg}"
N = 101


def even(panels: int, *widths: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Deviations that are alike along each edge."""
    return [(np.full(N, widths[0]), np.full(N, widths[-1]))] * panels


@pytest.mark.parametrize("panels", [1, 2, 3])
def test_every_piece_has_two_bands_and_an_outline(panels):
    drawing = ElementTree.fromstring(band_svg(pieces_from_panels(lune_flat(panels, N)), even(panels, 0.3)))
    assert drawing.tag == f"{SVG}svg"
    fills = [path.get("fill") for path in drawing.iter(f"{SVG}path")]
    assert len(fills) == 3 * panels
    assert fills.count("none") == panels
    words = [text.text or "" for text in drawing.iter(f"{SVG}text")]
    assert [line for line in words if "panel" in line] == panel_names(panels)
    assert words[-1] == "a standard deviation of 0.2 mm"
    (key,) = drawing.iter(f"{SVG}rect")
    assert float(key.get("height", "")) == pytest.approx(2 * 0.2 * magnification(even(panels, 0.3)))


def test_bands_are_as_wide_as_the_magnified_deviation():
    lower, upper = 0.1, np.linspace(0.1, 0.3, N)
    deviation = [(np.full(N, lower), upper)]
    drawing = ElementTree.fromstring(band_svg(pieces_from_panels(lune_flat(1, N)), deviation))
    assert magnification(deviation) == 10
    bands = [path.get("d", "") for path in drawing.iter(f"{SVG}path") if path.get("fill") != "none"]
    for path, half in zip(bands, (np.full(N, lower), upper[::-1]), strict=True):  # the upper edge runs back
        points = np.array([[float(v) for v in pair.split(",")] for pair in path.strip("MZ").split("L")])
        width = np.linalg.norm(points[:N] - points[: N - 1 : -1], axis=1)
        np.testing.assert_allclose(width, 2 * 10 * half, atol=0.03)


@pytest.mark.parametrize("widest", [0.01, 0.05, 0.19, 0.21, 0.4, 1.1, 3.9])
def test_the_widest_place_is_as_wide_as_it_may_be(widest):
    factor = magnification([*even(1, widest / 3), *even(1, 0.0, widest)])
    steps = [1, 2, 5, 10, 20, 50, 100]
    assert factor in steps
    assert factor * widest <= SHOWN
    assert all(step * widest > SHOWN for step in steps if step > factor)


def test_very_uncertain_outlines_are_shown_as_they_are():
    assert magnification(even(2, 3 * SHOWN)) == 1


def test_certain_outlines_have_bands_too():
    drawing = ElementTree.fromstring(band_svg(pieces_from_panels(lune_flat(2, N)), even(2, 0.0)))
    assert len(list(drawing.iter(f"{SVG}path"))) == 6
