import io
import re
import subprocess
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pytest
from patterns import pattern, program

from brafit.pattern import write_svg
from brafit.remarks import Remark

SVG = "{http://www.w3.org/2000/svg}"
INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"
LABEL = f"{INKSCAPE}label"
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


def layers(root) -> dict[str, Any]:
    return {g.get(LABEL): g for g in root if g.get(f"{INKSCAPE}groupmode") == "layer"}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("panels", [1, 2, 3])
def test_layers_names_and_lengths_as_another_reader_finds_them(tmp_path, panels, side):
    elements = pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    made = pattern(panels, side, allowance={"wire": 8.0, "ridge": 6.0, "upper": 5.0})
    write_svg(tmp_path / "patterns.svg", [made], "anny_05")
    root = parse(tmp_path / "patterns.svg")
    left, top, width, height = map(float, root.get("viewBox").split())
    assert (left, top) == (0, 0)
    assert (millimetres(root.get("width")), millimetres(root.get("height"))) == (width, height)
    identifiers = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(identifiers) == len(set(identifiers))
    found = layers(root)
    assert list(found) == ["cut", "sew", "notch", "drill", "grain", "text", "info"]
    for name in list(found)[:-1]:
        assert [group.get(LABEL) for group in found[name]] == [piece.name for piece in made.pieces]
    for piece, cut, sew, notch, drill, text in zip(
        made.pieces, *(found[name] for name in ("cut", "sew", "notch", "drill", "text")), strict=True
    ):
        (outline,) = (elements.Path(path.get("d")) for path in cut)
        assert outline.length(error=1e-6) == pytest.approx(sum(c.length for c in piece.cut), abs=0.01)
        box = outline.bbox()
        assert min(box) > 0
        assert box[2] < width
        assert box[3] < height
        assert path_is_closed(cut[0].get("d"))
        for line, path in zip(piece.sew, sew, strict=True):
            assert path.get("class").split() == ["edge", line.kind]
            assert path.get(LABEL) == line.name
            assert elements.Path(path.get("d")).length(error=1e-6) == pytest.approx(line.length, abs=2e-3)
            assert float(path.get("data-length-mm")) == pytest.approx(line.length, abs=1e-3)
            assert len(path.get("d")) < 1500, "few arcs, not many points"
        assert len(notch) == len(piece.notches)
        assert len(drill) == len(piece.holes)
        assert set(piece.label.lines) <= {line.text for line in text}


def path_is_closed(d: str) -> bool:
    return d.startswith("M") and d.endswith("Z") and d.count("M") == 1


def test_drawing_is_not_mirrored_by_the_downward_axis(tmp_path):
    """The wire edge is drawn below the ridge, and runs from left to right as in the piece."""
    elements = pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    write_svg(tmp_path / "p.svg", [pattern()], "x")
    wire, ridge = (elements.Path(path.get("d")) for path in layers(parse(tmp_path / "p.svg"))["sew"][0])
    assert wire.bbox()[3] > ridge.bbox()[3] + 10
    assert wire.first_point.x < wire.current_point.x


def test_warnings_stand_on_the_piece_and_below_the_title(tmp_path):
    write_svg(tmp_path / "p.svg", [pattern(material_width=10.0)], "x")
    found = layers(parse(tmp_path / "p.svg"))
    for group in found["text"]:
        assert any((line.text or "").startswith("WARNING") for line in group)
    assert sum((line.text or "").startswith("WARNING") for line in found["info"].iter(f"{SVG}text")) == 2


def test_warnings_of_the_fit_stand_below_the_title(tmp_path):
    doubt = Remark("proposed_landmarks", "the wire's outer end is a guess")
    write_svg(tmp_path / "p.svg", [pattern(told=[doubt])], "x")
    told = [text.text or "" for text in layers(parse(tmp_path / "p.svg"))["info"].iter(f"{SVG}text")]
    assert told.count("WARNING: the wire's outer end is a guess") == 1


def test_warnings_of_several_patterns_name_their_own(tmp_path):
    write_svg(tmp_path / "p.svg", [pattern(name="one", material_width=10.0), pattern(name="two")], "nest")
    told = [text.text or "" for text in layers(parse(tmp_path / "p.svg"))["info"].iter(f"{SVG}text")]
    assert [words.split(":")[1].strip() for words in told if words.startswith("WARNING")] == ["one", "one"]


def test_several_patterns_and_pairs_have_names_of_their_own(tmp_path):
    write_svg(tmp_path / "p.svg", [pattern(pair=True), pattern(name="other")], "x")
    sizes = layers(parse(tmp_path / "p.svg"))
    assert list(sizes) == ["lune", "other", "info"]
    cuts = [layers(sizes[name])["cut"] for name in ("lune", "other")]
    names = [group.get(LABEL) for cut in cuts for group in cut]
    assert len(set(names)) == len(names) == 6
    assert "lune right cup upper panel" in names


def test_kinds_are_told_apart_without_colours(tmp_path):
    write_svg(tmp_path / "p.svg", [pattern()], "x")
    looks = {}
    for path in parse(tmp_path / "p.svg").iter(f"{SVG}path"):
        role, *kind = path.get("class", "").split()[:2] or [""]
        if role in ("edge", "key") and kind != ["cut"]:
            look = (path.get("stroke-dasharray"), path.get("stroke-width"), path.get("stroke"))
            looks.setdefault(kind[0], set()).add(look)
    assert set(looks) == {"wire", "ridge", "upper"}
    assert all(len(look) == 1 for look in looks.values())  # the legend's line looks like the edges
    assert len({next(iter(look))[:2] for look in looks.values()}) == 3


@pytest.mark.parametrize("name", NAMES)
def test_any_name_makes_valid_xml(tmp_path, name):
    write_svg(tmp_path / "p.svg", [pattern(name=name)], name, note=name)
    root = parse(tmp_path / "p.svg")
    title = root.find(f"{SVG}title").text or ""
    legal = re.sub("[\x00-\x08\ud800]", "\ufffd", name)
    assert title == " ".join(legal.split())


def rendered_by_resvg(path) -> np.ndarray:
    resvg = pytest.importorskip("resvg_py", reason="the SVG renderer resvg-py is not installed")
    options: dict[str, Any] = {"background": "white", "skip_system_fonts": True, "shape_rendering": "crisp_edges"}
    return dark(resvg.svg_to_bytes(svg_path=str(path), dpi=254, **options))


def rendered_by_librsvg(path) -> np.ndarray:
    command = [program("rsvg-convert"), "-d", "254", "-p", "254", "-b", "white", path]
    return dark(subprocess.run(command, check=True, capture_output=True).stdout)


def dark(png: bytes) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("L")) < 140


@pytest.mark.parametrize("render", [rendered_by_resvg, rendered_by_librsvg])
def test_true_size_in_an_independent_renderer(tmp_path, render):
    write_svg(tmp_path / "p.svg", [pattern()], "anny_05")
    shown = render(tmp_path / "p.svg")
    root = parse(tmp_path / "p.svg")
    assert shown.shape == pytest.approx(
        (10 * millimetres(root.get("height")), 10 * millimetres(root.get("width"))), abs=1
    )
    square = root.find(f".//{SVG}g[@id='control-square']/{SVG}path").get("d")
    x, y = (round(10 * value) for value in np.array(re.findall(r"([-\d.]+),([-\d.]+)", square), float).min(0))
    columns = np.nonzero(shown[y + 50, x - 20 : x + 1040])[0]
    rows = np.nonzero(shown[y - 20 : y + 1040, x + 50])[0]
    for found in (columns, rows):
        lines = np.split(found, np.nonzero(np.diff(found) > 1)[0] + 1)
        assert len(lines) == 2
        assert lines[1].mean() - lines[0].mean() == pytest.approx(1000, abs=1)
