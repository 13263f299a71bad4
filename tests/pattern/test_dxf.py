"""DXF files as ezdxf's auditor, GDAL and trimesh read them."""

import json
import re
import subprocess
from collections import Counter

import ezdxf.filemanagement
import numpy as np
import pytest
from check_patterns import dxf_figures, gdal_figures, trimesh_figures
from ezdxf.lldxf.encoding import decode_dxf_unicode
from patterns import pattern, program, small
from readers import polyline_length

from brafit.pattern.dxf import block_name, write_dxf
from brafit.remarks import Remark

SEWN = {"1", "2", "3", "4", "7", "14", "15"}


def read(path):
    document = ezdxf.filemanagement.readfile(path)
    audit = document.audit()
    assert audit.errors == []
    assert audit.fixes == []
    return document


def blocks(document) -> dict:
    return {insert.dxf.name: document.blocks[insert.dxf.name] for insert in document.modelspace().query("INSERT")}


def texts(entities) -> list[str]:
    return [entity.dxf.text for entity in entities if entity.dxftype() == "TEXT"]


@pytest.mark.parametrize(("unit", "millimetres", "name"), [("mm", 1.0, "METRIC"), ("inch", 25.4, "ENGLISH")])
def test_pieces_layers_and_texts(tmp_path, unit, millimetres, name):
    made = pattern(units=unit, size="75B")
    write_dxf(tmp_path / "p.dxf", [made], "anny 05")
    document = read(tmp_path / "p.dxf")
    assert document.dxfversion == "AC1009"
    found = blocks(document)
    assert set(found) == {"LOWER_PANEL_75B", "UPPER_PANEL_75B", "CONTROL_SQUARE_100MM"}
    for piece in made.pieces:
        block = found[f"{piece.name.upper().replace(' ', '_')}_75B"]
        layers = {entity.dxf.layer for entity in block}
        assert layers == (SEWN | {"13"} if piece.holes else SEWN)
        (cut,) = block.query('POLYLINE[layer=="1"]')
        outline = np.array([v.dxf.location.vec2 for v in cut.vertices]) * millimetres
        np.testing.assert_allclose(outline[0], outline[-1], atol=1e-6)
        assert polyline_length(outline) == pytest.approx(sum(c.length for c in piece.cut), abs=0.05)
        sewn = [
            polyline_length([v.dxf.location.vec2 for v in line.vertices])
            for line in block.query('POLYLINE[layer=="14"]')
        ]
        np.testing.assert_allclose(np.array(sewn) * millimetres, [line.length for line in piece.sew], atol=0.05)
        counts = Counter(entity.dxf.layer for entity in block.query("POINT"))
        assert counts["4"] == sum(len(notch.ticks) for notch in piece.notches)
        assert counts["13"] == len(piece.holes)
        assert counts["2"] == 4  # the two ends of each blunt tip
        assert counts["2"] + counts["3"] == len(outline) - 1
        assert len(block.query('LINE[layer=="7"]')) == 1
        words = texts(block)
        assert {f"Piece Name: {piece.name}", "Size: 75B", "Quantity: 1"} <= set(words)
        assert any("allowance" in line for line in words)
    style = texts(document.modelspace())
    assert {"Style Name: anny 05", f"Units: {name}", "Creation Date: 2001-02-03"} <= set(style)
    (square,) = found["CONTROL_SQUARE_100MM"].query('POLYLINE[layer=="1"]')
    corners = np.array([v.dxf.location.vec2 for v in square.vertices]) * millimetres
    np.testing.assert_allclose(np.ptp(corners, axis=0), (100, 100), atol=1e-9)


def test_every_piece_bears_the_warnings_of_the_fit(tmp_path):
    """A DXF file has neither legend nor cover."""
    doubt = Remark("proposed_landmarks", "the wire's outer end is a guess, 56 mm off", remedy="mark it by hand")
    write_dxf(tmp_path / "p.dxf", [pattern(told=[doubt])], "x")
    found = blocks(read(tmp_path / "p.dxf"))
    for name in ("LOWER_PANEL_LUNE", "UPPER_PANEL_LUNE"):
        lines = [words.removeprefix("Annotation: ") for words in texts(found[name])]
        assert f"WARNING: {doubt}" in " ".join(lines)


def test_annotations_are_whole_whatever_the_room_for_labels(tmp_path):
    """On narrow pieces lines of labels are joined and warnings point to a legend, which DXF has not."""
    cloth = {"thickness": 3.0, "stretch": 20.0, "stretch_across": 0.0}
    made = small(3, 0.6, pair=True, units="inch", cloth=cloth, material_width=30.0)
    labels = [piece.label for piece in made.pieces]
    assert any(", " in label.lines[0] for label in labels)
    assert any("see legend" in " ".join(label.notice) for label in labels)
    write_dxf(tmp_path / "p.dxf", [made], "x")
    found = blocks(read(tmp_path / "p.dxf"))
    for column in made.drawn:
        for number, piece in enumerate(column, start=1):
            block = found[f"{piece.name} {piece.side}_lune".upper().replace(" ", "_")]
            lines = [words.removeprefix("Annotation: ") for words in texts(block)]
            wanted = [f"piece {number} of 3", f"{piece.side} cup", "cut 1"]
            wanted += ["allowance 0.24 in (6 mm)", "cloth 0.12 in (3 mm) thick"]
            assert [lines.count(words) for words in wanted] == [1] * 5
            assert not any("see legend" in words for words in lines)
            assert [" ".join(lines).count(f"WARNING: {words}") for words in map(str, piece.warnings)] == [1]


def test_a_scan_whose_name_begins_like_a_size_keeps_it(tmp_path):
    made = pattern(name="size_42 of anna", size="75B")
    write_dxf(tmp_path / "p.dxf", [made], "x")
    for block in blocks(read(tmp_path / "p.dxf")).values():
        if block.name.endswith("PANEL_75B"):
            words = texts(block)
            assert "Annotation: size_42 of anna" in words
            assert "Annotation: size 75B" not in words


def test_notches_with_a_bar_have_the_layer_of_t_notches(tmp_path):
    made = pattern(notch_form="t")
    write_dxf(tmp_path / "p.dxf", [made], "lune")
    found = blocks(read(tmp_path / "p.dxf"))
    for piece in made.pieces:
        block = found[f"{piece.name.upper().replace(' ', '_')}_LUNE"]
        counts = Counter(entity.dxf.layer for entity in block.query("POINT"))
        notch = block.query('POINT[layer=="80"]').first
        assert (notch.dxf.location.z, notch.dxf.thickness) == pytest.approx((3.0, 3.0))
        assert (counts["80"], counts["4"]) == (sum(len(notch.ticks) for notch in piece.notches), 0)


def test_ticks_on_an_edge_without_allowance_are_drawn_lines(tmp_path):
    made = pattern(notch_form="t", allowance={"wire": 6.0, "ridge": 6.0, "upper": 0.0})
    write_dxf(tmp_path / "p.dxf", [made], "lune")
    found = blocks(read(tmp_path / "p.dxf"))
    for piece in made.pieces:
        block = found[f"{piece.name.upper().replace(' ', '_')}_LUNE"]
        cuts = sum(len(notch.ticks) for notch in piece.notches if notch.is_cut)
        ticks = sum(len(notch.ticks) for notch in piece.notches if not notch.is_cut)
        assert len(block.query('POINT[layer=="80"]')) == cuts
        assert len(block.query('LINE[layer=="8"]')) == ticks
    assert ticks == 1, "the strap point of the upper panel"


def test_several_sizes_lie_apart_in_one_file(tmp_path):
    made = [pattern(size="75B"), pattern(size="80C", name="other"), pattern(size="75B", pair=True)]
    write_dxf(tmp_path / "p.dxf", made, "nest")
    found = blocks(read(tmp_path / "p.dxf"))
    assert len(found) == 2 + 2 + 4 + 1
    assert {"LOWER_PANEL_75B", "LOWER_PANEL_80C", "LOWER_PANEL_LEFT_75B", "LOWER_PANEL_RIGHT_75B"} <= set(found)
    boxes = []
    for block in found.values():
        (cut,) = block.query('POLYLINE[layer=="1"]')
        points = np.array([v.dxf.location.vec2 for v in cut.vertices])
        boxes.append((points.min(0), points.max(0)))
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            assert np.maximum(low - other_high, other_low - high).max() > 5


def test_only_what_the_oldest_readers_know_is_written(tmp_path):
    """Release 12 has no splines and no light polylines; some apparel systems refuse headers and tables."""
    write_dxf(tmp_path / "p.dxf", [pattern(notch_form="t"), pattern(name="other")], "x")
    lines = (tmp_path / "p.dxf").read_text(encoding="ascii").splitlines()
    kinds = {value.strip() for code, value in zip(lines[::2], lines[1::2], strict=True) if int(code) == 0}
    shapes = {"POLYLINE", "VERTEX", "SEQEND", "POINT", "LINE", "TEXT"}
    assert kinds == shapes | {"SECTION", "ENDSEC", "BLOCK", "ENDBLK", "INSERT", "EOF"}


def test_block_names_are_fit_for_release_12():
    taken: set[str] = set()
    names = [
        block_name(text, taken) for text in ("lower panel_Größe 胸", "x" * 50, "X" * 50, "", "lower panel_Größe 胸")
    ]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[A-Z0-9_-]{1,31}", name) for name in names)


def test_odd_names_stay_readable_files(tmp_path):
    write_dxf(tmp_path / "p.dxf", [pattern(name='Größe "胸"\n\x07')], "a\nb\x00é")
    document = read(tmp_path / "p.dxf")
    assert len(blocks(document)) == 3
    assert "Style Name: a b é" in map(decode_dxf_unicode, texts(document.modelspace()))
    labels = [decode_dxf_unicode(line) for block in blocks(document).values() for line in texts(block)]
    assert any('Größe "胸"' in line for line in labels)
    (tmp_path / "p.dxf").read_text(encoding="ascii")


def test_gdal_reads_the_same_lengths(tmp_path):
    ogr2ogr = program("ogr2ogr")
    made = pattern()
    write_dxf(tmp_path / "p.dxf", [made], "lune")
    options = [
        "-f",
        "GeoJSON",
        "--config",
        "DXF_INLINE_BLOCKS",
        "FALSE",
    ]  # every block by itself, in the layer `blocks`
    command = [ogr2ogr, *options, tmp_path / "p.json", tmp_path / "p.dxf", "blocks"]
    subprocess.run(command, check=True, capture_output=True)
    features = json.loads((tmp_path / "p.json").read_text())["features"]
    collections = {f["properties"]["Block"]: f["geometry"] for f in features if "geometries" in f["geometry"]}
    assert set(collections) == {"LOWER_PANEL_LUNE", "UPPER_PANEL_LUNE", "CONTROL_SQUARE_100MM"}
    lengths = {
        block: [polyline_length(p["coordinates"]) for p in shape["geometries"] if p["type"] == "LineString"]
        for block, shape in collections.items()
    }
    for piece in made.pieces:
        cut, grain = sum(c.length for c in piece.cut), float(np.linalg.norm(np.subtract(*piece.grain)))
        wanted = [cut, *(line.length for line in piece.sew), grain]
        found = lengths[f"{piece.name.upper().replace(' ', '_')}_LUNE"]
        np.testing.assert_allclose(sorted(found), sorted(wanted), atol=0.05)
    assert max(lengths["CONTROL_SQUARE_100MM"]) == pytest.approx(400, abs=1e-9)
    words = [f["properties"].get("Text") for f in features]
    assert {"Piece Name: lower panel", "Size: lune", "Quantity: 1"} <= set(words)


@pytest.mark.parametrize("options", [{}, {"units": "inch"}])
def test_all_readers_find_the_lengths_of_the_edges(tmp_path, options):
    program("ogr2ogr")
    made = pattern(3, **options)
    write_dxf(tmp_path / "p.dxf", [made], "lune")
    edges = {piece.name: {line.name: line.length for line in piece.sew} for piece in made.pieces}
    for read in (dxf_figures, gdal_figures, trimesh_figures):
        found = {figure: value for figure, value in read(tmp_path / "p.dxf", edges).items() if "points" not in figure}
        assert all(value <= 0.05 for value in found.values()), found
        wrong = {piece: {name: length + 1 for name, length in lines.items()} for piece, lines in edges.items()}
        assert max(read(tmp_path / "p.dxf", wrong).values()) > 0.9
