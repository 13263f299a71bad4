"""Nests: what lies on one point, and what independent readers find in the files."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import svgelements
from ezdxf.entities.text import Text
from ezdxf.filemanagement import readfile
from patterns import pattern, program
from shapely import LineString, Polygon

from brafit.pattern import Pattern
from brafit.pattern.drawing import LAYERS, Stroke, Words
from brafit.pattern.marks import MATCH_POINT
from brafit.pattern.svg import page_svg
from brafit.sizing.drawing import FILES, nest_dxf, nest_page, write_nest
from brafit.sizing.nest import ALIGNS, HUES, Align, Layer, anchor, nested

SIZES = ("1", "2", "3")
PATH = "{http://www.w3.org/2000/svg}path"
INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}"


def three() -> list[Pattern]:
    """The same cup with growing ease: three sizes whose pieces have the same names."""
    eases = ({"width": 0.0, "height": 0.0}, {"width": 4.0, "height": 4.0}, {"width": 9.0, "height": 9.0})
    return [pattern(size=size, ease=ease) for size, ease in zip(SIZES, eases, strict=True)]


def strokes_of(layer: Layer) -> dict[str, list[Stroke]]:
    """The lines of a size, piece by piece."""
    found: dict[str, list[Stroke]] = {}
    for item in layer.items:
        if isinstance(item, Stroke):
            found.setdefault(item.group, []).append(item)
    return found


def lengths(one: Pattern) -> list[float]:
    return sorted(line.length for piece in one.pieces for line in piece.sew)


@pytest.mark.parametrize("align", ["apex", "wire"])
def test_pieces_lie_on_one_point_and_are_not_turned(align: Align):
    """All sizes are the same cup made larger about the common point: so their lines are, about it."""
    sizes = three()
    nest = nested(sizes, align)
    for place, piece in enumerate(sizes[0].pieces):
        assert all(list(strokes_of(layer)) == [one.name for one in sizes[0].pieces] for layer in nest.layers)
        own = [strokes_of(layer)[piece.name] for layer in nest.layers]
        lower = [strokes[1].paths[0][0] for strokes in own]  # after the cut line
        fixed = [curve.start + anchor(one.pieces[place], align) - one.pieces[place].sew[0].curve.start
                 for curve, one in zip(lower, sizes, strict=True)]  # fmt: skip
        np.testing.assert_allclose(fixed, np.broadcast_to(fixed[0], (3, 2)), atol=1e-9)
        for curve, ease in zip(lower, (1.0, 1.04, 1.09), strict=True):
            np.testing.assert_allclose((curve.end - curve.start) / ease, lower[0].end - lower[0].start, atol=1e-6)


def test_apex_notches_meet_and_wires_inner_ends_do():
    sizes = three()
    for one in sizes:
        for piece in one.pieces:
            notch = next(notch for notch in piece.notches if notch.name == MATCH_POINT)
            np.testing.assert_allclose(anchor(piece, "apex"), notch.foot)
            np.testing.assert_allclose(anchor(piece, "wire"), piece.sew[0].curve.start)


@pytest.mark.parametrize("align", ALIGNS)
def test_everything_lies_on_the_sheet(align: Align):
    nest = nested(three(), align)
    points = np.concatenate(
        [
            curve.polyline(0.1)
            for layer in nest.layers
            for strokes in strokes_of(layer).values()
            for stroke in strokes
            for path in stroke.paths
            for curve in path
        ]
    )
    assert (points.min(0) > -1e-6).all()
    assert (points.max(0) < (nest.width + 1e-6, nest.height + 1e-6)).all()


def test_side_by_side_no_pieces_meet():
    nest = nested(three(), "none")
    cuts = [strokes[0].paths[0] for layer in nest.layers for strokes in strokes_of(layer).values()]
    shapes = [Polygon(np.concatenate([curve.polyline(0.1) for curve in curves])) for curves in cuts]
    assert len(shapes) == 6
    assert all(a.distance(b) > 5 for i, a in enumerate(shapes) for b in shapes[:i])


def test_colours_differ_as_far_as_there_are_any():
    many = nested([pattern(panels=1, size=str(k)) for k in range(HUES)], "none")
    assert len({layer.colour for layer in many.layers}) == HUES
    assert len({layer.colour_index for layer in many.layers}) == HUES


def test_neighbours_among_many_colours_differ_in_lightness():
    seven = nested([pattern(panels=1, size=str(k)) for k in range(7)], "none")
    assert [layer.shade for layer in seven.layers] == [0, 1, 0, 1, 0, 1, 0]
    assert seven.layers[0].colour == "#bd0000"
    assert [layer.shade for layer in nested(three()).layers] == [0, 0, 0]


def test_names_of_sizes_lie_on_no_other_and_on_no_grain_line():
    names = [f"anny_0{k}" for k in range(7)]
    nest = nested([pattern(panels=3, size=name, ease={"width": k, "height": k}) for k, name in enumerate(names)])
    told = [item for layer in nest.layers for item in layer.items if isinstance(item, Words)]
    boxes = [Polygon(item.corners) for item in [*told, *nest.names]]
    assert len(told) == 21
    assert not any(one.intersects(other) for k, one in enumerate(boxes) for other in boxes[:k])
    arrows = [
        LineString(curve.polyline())
        for layer in nest.layers
        for item in layer.items
        if isinstance(item, Stroke) and item.layer == "grain"
        for path in item.paths
        for curve in path
    ]
    assert not any(box.intersects(arrow) for box in boxes[: len(told)] for arrow in arrows)


def test_pieces_lie_from_the_wire_up_though_the_first_cup_has_fewer():
    nest = nested([pattern(size="two"), pattern(panels=3, size="three")])
    assert [words.text for words in nest.names[:3]] == ["lower panel", "middle panel", "upper panel"]
    assert list(strokes_of(nest.layers[1])) == ["lower panel", "middle panel", "upper panel"]


def test_svg_has_a_layer_a_size_at_true_size():
    sizes = three()
    title = "a title <&>"
    root = ET.fromstring(page_svg(nest_page(nested(sizes), title, "note"), title))
    *layers, info = (g for g in root if g.get(f"{INKSCAPE}groupmode") == "layer")
    assert [g.get(f"{INKSCAPE}label") for g in (*layers, info)] == [*SIZES, "info"]
    for layer in layers:
        assert [g.get(f"{INKSCAPE}label") for g in layer] == list(LAYERS)
        assert all(g.get(f"{INKSCAPE}groupmode") == "layer" for g in layer)
    colours = [{path.get("stroke") for path in g.iter(PATH)} for g in layers]
    assert all(len(own) == 1 for own in colours)
    assert len(set.union(*colours)) == 3
    for layer, one in zip(layers, sizes, strict=True):
        paths = [path for path in layer.iter(PATH) if path.get("class", "").startswith("edge")]
        found = sorted(svgelements.Path(path.get("d")).length(error=1e-6) for path in paths)
        np.testing.assert_allclose(found, lengths(one), atol=0.01)
    assert float(root.get("width", "").removesuffix("mm")) == pytest.approx(float(root.get("viewBox", "").split()[2]))
    square = next(e for e in info if e.get("id") == "control-square")
    box = svgelements.Path(square[0].get("d")).bbox()
    assert box is not None
    np.testing.assert_allclose((box[2] - box[0], box[3] - box[1]), 100.0, atol=1e-4)


def test_dxf_has_layers_of_every_size_in_millimetres(tmp_path: Path):
    sizes = three()
    (tmp_path / "nest.dxf").write_bytes(nest_dxf(nested(sizes)))
    read = readfile(tmp_path / "nest.dxf")
    assert not read.audit().errors
    colours = {layer.dxf.name: layer.dxf.color for layer in read.layers}
    assert len({colours[f"S_{size}"] for size in SIZES}) == 3
    for size, one in zip(SIZES, sizes, strict=True):
        lines = read.modelspace().query(f'POLYLINE[layer=="S_{size}_SEW"]')
        found = [np.array([v.dxf.location for v in line.vertices]) for line in lines]  # type: ignore[attr-defined]
        measured = sorted(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) for points in found)
        np.testing.assert_allclose(measured, lengths(one), atol=0.05)
        assert len(read.modelspace().query(f'POLYLINE[layer=="S_{size}"]')) == 2
        assert colours[f"S_{size}_SEW"] == colours[f"S_{size}"]


def test_dxf_of_patterns_in_inches_is_in_inches(tmp_path: Path):
    """As each one's own file is; and says so, for a reader that asks."""
    sides = {}
    for units in ("mm", "inch"):
        (tmp_path / f"{units}.dxf").write_bytes(nest_dxf(nested([pattern(units=units)])))
        read = readfile(tmp_path / f"{units}.dxf")
        (square,) = read.modelspace().query('POLYLINE[layer=="CONTROL"]')
        points = np.array([v.dxf.location for v in square.vertices])  # type: ignore[attr-defined]
        sides[read.units] = float(np.ptp(points[:, 0]))
    assert sides == pytest.approx({4: 100.0, 1: 100 / 25.4}, abs=1e-5)


def test_the_list_of_sizes_says_what_their_cups_are_like(tmp_path: Path):
    about = ["wire 200.0 mm", "wire 208.0 mm", "wire 218.0 mm"]
    nest = nested([replace(one, size=f"{one.size} {'x' * 80}") for one in three()], about=about)
    told = [item.text for item in nest_page(nest, "title").items if isinstance(item, Words) and item.group == "sizes"]
    assert [words.partition(": ")[2] for words in told] == about
    assert [words[0] for words in told] == list(SIZES)
    assert all("…" in words for words in told), "a name that is too long gives way"
    (tmp_path / "nest.dxf").write_bytes(nest_dxf(nest))
    read = [text.dxf.text for text in readfile(tmp_path / "nest.dxf").modelspace().query("TEXT")]
    assert all(any(words.endswith(f": {one}") for words in read) for one in about)


def test_pdf_is_one_page_at_true_size(tmp_path: Path):
    import subprocess

    nest = nested(three())
    write_nest(tmp_path, nest, "title")
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(FILES)
    told = subprocess.run([program("pdfinfo"), tmp_path / FILES[2]], capture_output=True, text=True, check=True).stdout
    root = ET.fromstring((tmp_path / FILES[0]).read_bytes())
    words = next(line for line in told.splitlines() if line.startswith("Page size")).split()
    assert "Pages:           1" in told
    sizes = [float(root.get(key, "").removesuffix("mm")) for key in ("width", "height")]
    np.testing.assert_allclose([float(words[2]) / 72 * 25.4, float(words[4]) / 72 * 25.4], sizes, atol=0.2)


def test_pdf_has_a_layer_for_each_kind_of_line_of_each_size(tmp_path: Path):
    sizes = three()
    write_nest(tmp_path, nested(sizes), "title")
    names = re.findall(rb"/Name \(([^)]*)\) /Type /OCG", (tmp_path / FILES[2]).read_bytes())
    kinds = [kind for kind in LAYERS if kind != "drill" or any(piece.holes for piece in sizes[0].pieces)]
    assert {name.decode() for name in names} == {f"{size} {kind}" for size in SIZES for kind in kinds} | {"info"}


def test_legend_and_sizes_keep_clear_of_each_other_and_of_the_pieces():
    from shapely import box

    page = nest_page(nested(three()), "title", "note")
    own = [item for item in page.items if item.layer == "info"]
    words = [Polygon(item.corners) for item in own if not isinstance(item, Stroke)]
    assert all(box(0, 0, page.width, page.height).contains(one) for one in words)
    assert not any(a.intersects(b) for i, a in enumerate(words) for b in words[:i])
    lines = [curve.polyline(0.1) for item in page.items if isinstance(item, Stroke) and item.layer == "cut"
             for path in item.paths for curve in path]  # fmt: skip
    low = min(line[:, 1].min() for line in lines)
    below = [one for one in words if one.bounds[1] < low]
    assert len(below) > 10
    assert all(one.bounds[3] < low for one in below)


@pytest.mark.parametrize("align", ALIGNS)
def test_pieces_of_a_nest_have_their_names(align: Align, tmp_path: Path):
    """Beside them, clear of all of them; where they lie side by side each has all of its own texts."""
    sizes = three()
    nest = nested(sizes, align)
    named = [piece.name for piece in sizes[0].pieces]
    cloth = [Polygon(np.concatenate([curve.polyline(0.1) for curve in strokes[0].paths[0]]))
             for layer in nest.layers for strokes in strokes_of(layer).values()]  # fmt: skip
    (tmp_path / "nest.dxf").write_bytes(nest_dxf(nest))
    read = [text for text in readfile(tmp_path / "nest.dxf").modelspace() if isinstance(text, Text)]
    if align == "none":
        for layer, one in zip(nest.layers, sizes, strict=True):
            words = {item.text for item in layer.items if isinstance(item, Words)}
            assert {text for piece in one.pieces for text in piece.label.all_lines} <= words
            assert {text for piece in one.pieces for text in piece.label.all_lines} <= {text.dxf.text for text in read}
    else:
        names = [words.text for words in nest.names]
        assert names[: len(named)] == named
        assert not any(Polygon(own.corners).intersects(piece) for own in nest.names[: len(named)] for piece in cloth)
        assert [text.dxf.text for text in read if text.dxf.layer == "NAMES"] == names


@pytest.mark.parametrize("align", ["apex", "wire"])
def test_marks_of_a_nest_are_named_once_with_a_line_to_each(align: Align):
    """The legend shows most of them as one tick. Names meet nothing that is drawn; a line ends at each mark."""
    sizes = three()
    nest = nested(sizes, align)
    marks = nest.names[len(sizes[0].pieces) :]
    wanted = [{*(n.name for n in piece.notches if n.name), *(h.name for h in piece.holes)} for piece in sizes[0].pieces]
    assert sorted(words.text for words in marks) == sorted(name for own in wanted for name in own)
    boxes = [Polygon(words.corners) for words in marks]
    for layer, one in zip(nest.layers, sizes, strict=True):
        texts = [Polygon(item.corners) for item in layer.items if isinstance(item, Words)]
        assert not any(box.intersects(text) for box in boxes for text in texts)
        for piece in one.pieces:
            strokes = strokes_of(layer)[piece.name]
            drawn = [LineString(curve.polyline(0.1)) for stroke in strokes if stroke.role != "leader"
                     for path in stroke.paths for curve in path]  # fmt: skip
            assert not any(box.intersects(line) for box in boxes for line in drawn)
            shift = next(s for s in strokes if s.role == "edge wire" or s.role == "edge ridge").paths[0][0].start
            feet = [n.foot for n in piece.notches if n.name] + [h.point for h in piece.holes]
            ends = [s.paths[0][0].end for s in strokes if s.role == "leader"]
            np.testing.assert_allclose(
                sorted(np.round(ends, 6).tolist()),
                sorted(np.round(feet + shift - piece.sew[0].curve.start, 6).tolist()),
                atol=1e-5,
            )


def test_legend_tells_the_cloth_of_each_pattern_where_they_differ():
    foam = {"thickness": 3.0, "stretch": 0.0, "stretch_across": 0.0}

    def told(*patterns: Pattern) -> list[str]:
        page = nest_page(nested(patterns), "title")
        return [item.text for item in page.items if isinstance(item, Words) and item.group == "legend"]

    alike = told(pattern(size="1", cloth=foam), pattern(size="2", cloth=foam))
    assert alike.count("cloth 3.0 mm thick") == 1
    cloths = told(pattern(size="1"), pattern(size="2", cloth=foam))
    assert {"1: thin cloth without stretch", "2: cloth 3.0 mm thick"} <= set(cloths)
    assert "cloth 3.0 mm thick" not in cloths
    units = told(pattern(size="1", cloth=foam), pattern(size="2", cloth=foam, units="inch"))
    assert {"1: mm, cloth 3.0 mm thick", "2: inch, cloth 0.12 in (3 mm) thick"} <= set(units)
    assert not any(words.startswith(("units:", "lengths in")) for words in units)


def test_legend_tells_the_allowances_of_each_pattern_where_they_differ():
    widths = {"wire": 10.0, "ridge": 6.0, "upper": 0.0}
    page = nest_page(nested([pattern(size="1"), pattern(size="2", allowance=widths, quantity=2)]), "title")
    told = " ".join(item.text for item in page.items if isinstance(item, Words) and item.group == "legend")
    assert "1: cut each piece once 2: cut each piece 2 times" in told
    for words in ("1: allowances: wire 6.0 mm, seam 6.0 mm", "2: allowances: wire 10.0 mm, seam 6.0 mm, upper 0.0 mm"):
        assert words in told


def test_names_of_any_letters_are_kept_apart(tmp_path: Path):
    nest = nested([pattern(size="größe"), pattern(size="größt"), pattern(size="a" * 60), pattern(size="a" * 61)])
    (tmp_path / "nest.dxf").write_bytes(nest_dxf(nest))
    names = {layer.dxf.name for layer in readfile(tmp_path / "nest.dxf").layers if layer.dxf.name.endswith("_SEW")}
    assert len(names) == 4
    drawn = svgelements.SVG.parse(str(_written(tmp_path / "nest.svg", page_svg(nest_page(nest, "x"), "x"))))
    assert drawn.width > 100
    with pytest.raises(ValueError, match="at least one pattern"):
        nested([])


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_names_of_the_list_are_shortened_only_without_room_and_never_to_the_same():
    about = "wire 182.3 mm, depth of cup 60.1 mm"
    names = [f"{'a_long_folder_of_runs/' * many}cup.panels={k}/anny_01" for many in (1, 9) for k in (2, 3)]
    for own in (names[:2], names):
        patterns = [pattern(size=name) for name in own]
        nest = nested(patterns, about=[about] * len(own))
        page = nest_page(nest, "sizes")
        told = [item for item in page.items if isinstance(item, Words) and item.group == "sizes"]
        assert len({item.text for item in told}) == len(own)
        assert [item.text for item in told[:2]] == [f"{name}: {about}" for name in names[:2]]
        assert all(item.corners[:, 0].max() <= page.width for item in told)
