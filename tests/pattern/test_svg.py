import io
import re
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from lunes import lune_flat

from brafit.pattern import pieces_from_panels, write_svg

SVG = "{http://www.w3.org/2000/svg}"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
NAMES = [
    "anny_05",
    "",
    "a & b <c> \"d\" 'e' ]]>",
    "Größe Ω 胸 \U0001f600",
    "bell\x07 null\x00 \ud800 line\nbreak",
    "x" * 300,
]


def parse(path) -> Any:
    return ET.parse(path).getroot()


def millimetres(text: str) -> float:
    assert text.endswith("mm")
    return float(text[:-2])


def path_points(path: Any) -> np.ndarray:
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*", path.get("d"))]
    return np.reshape(numbers, (-1, 2))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_lengths_and_names_as_another_reader_finds_them(tmp_path, panels, side):
    pieces = pieces_from_panels(lune_flat(panels), side)
    write_svg(tmp_path / "patterns.svg", pieces, "anny_05")
    root = parse(tmp_path / "patterns.svg")
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (left, top) == (0, 0)
    assert (millimetres(root.get("width")), millimetres(root.get("height"))) == (width, height)
    groups = {group.get(LABEL): group for group in root.iter(f"{SVG}g") if group.get("class") == "piece"}
    assert set(groups) == {piece.name for piece in pieces}
    identifiers = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(identifiers) == len(set(identifiers))
    for piece in pieces:
        paths = [path for path in groups[piece.name] if path.tag == f"{SVG}path"]
        assert piece.name in [text.text for text in groups[piece.name].iter(f"{SVG}text")]
        for edge, path in zip(piece.edges, paths, strict=True):
            assert path.get("class").split() == ["edge", edge.kind]
            assert path.get(LABEL) == edge.name
            points = path_points(path)
            assert points.min() > 0
            assert (points < (width, height)).all()
            length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
            assert length == pytest.approx(edge.length, abs=1e-3)
            assert float(path.get("data-length-mm")) == pytest.approx(edge.length, abs=1e-3)


def test_drawing_is_not_mirrored_by_the_downward_axis(tmp_path):
    """The wire edge is drawn below the ridge, and the outline runs as it does in the piece."""
    piece = pieces_from_panels(lune_flat(2))[0]
    write_svg(tmp_path / "p.svg", [piece], "x")
    wire, ridge = (
        path_points(path)
        for path in parse(tmp_path / "p.svg").iter(f"{SVG}path")
        if "edge" in path.get("class").split()
    )
    assert wire[:, 1].max() > ridge[:, 1].max() + 10
    assert wire[0, 0] < wire[-1, 0]


def test_kinds_are_told_apart_without_colours(tmp_path):
    write_svg(tmp_path / "p.svg", pieces_from_panels(lune_flat(2)), "x")
    looks = {}
    for path in parse(tmp_path / "p.svg").iter(f"{SVG}path"):
        _, kind = path.get("class").split()
        looks.setdefault(kind, set()).add((path.get("stroke-dasharray"), path.get("stroke-width"), path.get("stroke")))
    assert set(looks) == {"wire", "ridge", "upper"}
    assert all(len(look) == 1 for look in looks.values())  # the legend's line looks like the edges
    assert len({next(iter(look))[:2] for look in looks.values()}) == 3


@pytest.mark.parametrize("name", NAMES)
def test_any_name_makes_valid_xml(tmp_path, name):
    write_svg(tmp_path / "p.svg", pieces_from_panels(lune_flat(2)), name, note=name)
    root = parse(tmp_path / "p.svg")
    title = root.find(f"{SVG}title").text or ""
    legal = re.sub("[\x00-\x08\ud800]", "\ufffd", name)
    assert title == " ".join(legal.split())


def test_true_size_in_an_independent_renderer(tmp_path):
    resvg = pytest.importorskip("resvg_py", reason="the SVG renderer resvg-py is not installed")
    from PIL import Image

    write_svg(tmp_path / "p.svg", pieces_from_panels(lune_flat(2)), "anny_05")
    png = resvg.svg_to_bytes(
        svg_path=str(tmp_path / "p.svg"),
        dpi=254,
        background="white",
        skip_system_fonts=True,
        shape_rendering="crisp_edges",
    )
    dark = np.asarray(Image.open(io.BytesIO(png)).convert("L")) < 128
    root = parse(tmp_path / "p.svg")
    assert dark.shape == pytest.approx(
        (10 * millimetres(root.get("height")), 10 * millimetres(root.get("width"))), abs=1
    )
    square = root.find(f".//{SVG}g[@id='control-square']/{SVG}rect")
    x, y = (round(10 * float(square.get(key))) for key in "xy")
    columns = np.nonzero(dark[y + 50, x - 20 : x + 1040])[0]
    rows = np.nonzero(dark[y - 20 : y + 1040, x + 50])[0]
    for found in (columns, rows):
        lines = np.split(found, np.nonzero(np.diff(found) > 1)[0] + 1)
        assert len(lines) == 2
        assert lines[1].mean() - lines[0].mean() == pytest.approx(1000, abs=1)
