"""PDF files as poppler renders and converts them."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from check_pages import page_figures
from patterns import pattern, program, small

from brafit.pattern.drawing import PENS, Stroke, Words
from brafit.pattern.options import PAPERS
from brafit.pattern.pages import MARGIN, OVERLAP, Tiled, Whole, arrange, paper_pages
from brafit.pattern.pdf import write_pdf_projector, write_pdf_sheet, write_pdf_tiles
from brafit.pattern.sheet import named_pieces
from brafit.pattern.svg import write_svg
from brafit.remarks import Remark

POINT = 25.4 / 72


def pages(path: Path, dpi: float = 254) -> list[np.ndarray]:
    """Whether each pixel is dark, page by page."""
    from PIL import Image

    subprocess.run([program("pdftoppm"), "-r", str(dpi), "-gray", "-aa", "no", path, path.with_suffix("")], check=True)
    files = sorted(path.parent.glob(f"{path.stem}-*.pgm"))
    return [np.asarray(Image.open(file)) < 128 for file in files]


def longest_runs(dark: np.ndarray, least: int) -> list[tuple[int, int, int]]:
    """Rows with an unbroken dark line of at least that length: row, first and last pixel."""
    found = []
    for row in np.nonzero(dark.sum(1) >= least)[0]:
        steps = np.diff(np.concatenate(([0], dark[row].astype(int), [0])))
        starts, ends = np.nonzero(steps == 1)[0], np.nonzero(steps == -1)[0] - 1
        k = int((ends - starts).argmax())
        if ends[k] - starts[k] + 1 >= least:
            found.append((int(row), int(starts[k]), int(ends[k])))
    return found


def is_square_of_100_mm(dark: np.ndarray) -> bool:
    """Two lines of 1000 +- 1 px (and the stroke's width), 1000 +- 1 px apart."""
    lines = [run for run in longest_runs(dark, 990) if run[2] - run[1] <= 1010]
    rows = np.array([run[0] for run in lines])
    groups = np.split(rows, np.nonzero(np.diff(rows) > 1)[0] + 1)
    spans = [group.mean() for group in groups]
    apart = min((abs(b - a - 1000) for i, a in enumerate(spans) for b in spans[i + 1 :]), default=1e9)
    widths = [last - first for _, first, last in lines]
    return apart <= 1 and any(abs(width - 1000) <= 3 for width in widths)


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_control_square_of_the_tiled_pages(tmp_path, paper):
    write_pdf_tiles(tmp_path / "p.pdf", [pattern(paper=paper)], "lune")
    first = pages(tmp_path / "p.pdf")[0]
    assert first.shape == pytest.approx(tuple(10 * size for size in PAPERS[paper][::-1]), abs=1)
    assert is_square_of_100_mm(first)
    assert is_square_of_100_mm(first.T)


@pytest.mark.parametrize(("units", "squares"), [("mm", [100.0]), ("inch", [25.4, 100.0])])
def test_a_second_square_is_there_for_rulers_in_inches_alone_and_says_so(units, squares):
    first = paper_pages([pattern(units=units)], "lune")[0]
    own = [item for item in first.items if item.group == "control-square"]
    lines = [stroke.paths[0][0].polyline(0.1) for stroke in own if isinstance(stroke, Stroke)]
    assert sorted(float(np.ptp(line[:, 0])) for line in lines) == pytest.approx(squares)
    told = [item.text for item in own if isinstance(item, Words)]
    assert ("or the small one, with a ruler in inches" in told) == (len(squares) > 1)


def test_control_square_of_the_large_sheet(tmp_path):
    write_pdf_sheet(tmp_path / "p.pdf", [pattern()], "lune", "a note")
    (page,) = pages(tmp_path / "p.pdf")
    assert is_square_of_100_mm(page)
    assert is_square_of_100_mm(page.T)


def test_edge_lengths_as_another_reader_finds_them(tmp_path):
    elements = pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    made = pattern(allowance={"wire": 8.0, "ridge": 5.0, "upper": 0.0})
    write_pdf_sheet(tmp_path / "p.pdf", [made], "lune")
    subprocess.run([program("pdftocairo"), "-svg", "-noshrink", tmp_path / "p.pdf", tmp_path / "p.svg"], check=True)
    found: dict[str, list[float]] = {}
    for path in ElementTree.parse(tmp_path / "p.svg").iter("{http://www.w3.org/2000/svg}path"):
        curve = abs(elements.Path(path.get("d")) * elements.Matrix(path.get("transform", "")))  # with it carried out
        colour = re.search(r"stroke:(rgb\([^)]*\))", path.get("style", ""))
        if colour and curve.length() > 200:
            found.setdefault(elements.Color(colour[1]).hex, []).append(curve.length(error=1e-6) * POINT)
    for kind in ("wire", "ridge", "upper"):
        wanted = [line.length for piece in made.pieces for line in piece.sew if line.kind == kind]
        np.testing.assert_allclose(sorted(found[PENS[kind].colour]), sorted(wanted), atol=0.1)


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_pieces_that_fit_are_whole_on_their_pages(tmp_path, paper):
    """As poppler reads the file: none of the cut lines is cut by a page's border."""
    pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    for reader in ("pdfinfo", "pdftocairo"):
        program(reader)
    made = small(pair=True, paper=paper)
    write_pdf_tiles(tmp_path / "patterns.pdf", [made], "lune")
    write_pdf_sheet(tmp_path / "patterns_sheet.pdf", [made], "lune")
    write_svg(tmp_path / "patterns.svg", [made], "lune")
    assert set(page_figures(tmp_path).values()) == {0}
    for part in arrange(named_pieces([made]), paper):
        assert isinstance(part, Whole)
        corners = np.concatenate([np.stack(piece.bounds) for piece, *_ in part.pieces])
        assert (corners > MARGIN - 1e-6).all()
        assert (corners < np.array((part.width, part.height)) - MARGIN + 1e-6).all()
    write_pdf_tiles(tmp_path / "patterns.pdf", [pattern()], "lune")  # what is not there is found missing
    assert page_figures(tmp_path)["pages: pieces that fit on a page but are cut"] > 0


def test_a_piece_just_too_long_is_turned():
    lying = small(1, scale=1.24)
    (whole,) = arrange(named_pieces([lying]), "a4")
    assert isinstance(whole, Whole)
    piece, *_ = whole.pieces[0]
    assert np.ptp(lying.pieces[0].bounds, axis=0)[0] > 277
    assert np.ptp(piece.bounds, axis=0)[0] < 277


def test_pages_follow_the_order_of_the_pieces(tmp_path):
    """Also where the first and the last are larger than the paper, and the one between them is not."""
    lengths = [1.8, 0.6, 1.8]
    made = [replace(small(1, scale), name=f"size {k}") for k, scale in enumerate(lengths)]
    names = [name for _, name, _ in named_pieces(made)]
    parts = arrange(named_pieces(made), "letter")
    assert [type(part) for part in parts] == [Tiled, Whole, Tiled]
    assert [name for part in parts for name in part.names] == names
    write_pdf_tiles(tmp_path / "p.pdf", made, "lune")
    told = subprocess.run([program("pdftotext"), tmp_path / "p.pdf", "-"], check=True, capture_output=True, text=True)
    feet = re.findall(r"page \d+ of \d+: (.*), [A-Z]\d", told.stdout)
    assert list(dict.fromkeys(feet)) == [names[0], names[2]]


def test_tiles_cover_a_large_piece_and_overlap():
    """Every point of its cut line is on some page, and neighbours share the strip that they are glued by."""
    (part, *_) = arrange(named_pieces([small(1, 1.8, paper="letter")]), "letter")
    assert isinstance(part, Tiled)
    tiling = part.tiling
    seen = np.array((tiling.width, tiling.height)) - 2 * MARGIN
    for point in part.sheet.pieces[0].cut_outline():
        corners = [np.array((t.x, t.y)) for t in tiling.tiles]
        assert [low for low in corners if (point >= low).all() and (point <= low + seen).all()]
    names = [t.name for t in tiling.tiles]
    assert len(set(names)) == len(names) >= 2
    for a in tiling.tiles:
        for b in tiling.tiles:
            if (b.row, b.column) == (a.row, a.column + 1):
                assert a.x + seen[0] - b.x == pytest.approx(OVERLAP)
            if (b.row, b.column) == (a.row + 1, a.column):
                assert b.y + seen[1] - a.y == pytest.approx(OVERLAP)


def test_same_place_on_two_neighbouring_pages(tmp_path):
    """What lies in the overlap of two pages is drawn on both, at the places where gluing brings them together."""
    made = small(1, 1.8, paper="letter")
    write_pdf_tiles(tmp_path / "p.pdf", [made], "lune")
    shown = pages(tmp_path / "p.pdf", dpi=127)[1:]  # 5 px a mm
    (part,) = arrange(named_pieces([made]), "letter")
    assert isinstance(part, Tiled)
    tiling = part.tiling
    assert len(shown) == len(tiling.tiles)
    by_place = {(t.row, t.column): page for t, page in zip(tiling.tiles, shown, strict=True)}
    compared = 0
    border, strip = int(5 * MARGIN), int(5 * OVERLAP)
    for (row, column), page in by_place.items():
        for beside, turned in (((row, column + 1), False), ((row + 1, column), True)):
            other = by_place.get(beside)
            if other is None:
                continue
            a, b = (page.T, other.T) if turned else (page, other)  # the strip at the end of a is that at the start of b
            along = slice(border + 60, a.shape[0] - border - 60)  # without the frame and the page's name
            first, second = a[along, -border - strip + 12 : -border - 12], b[along, border + 12 : border + strip - 12]
            if first.sum() > 50:
                around = [np.roll(second, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]  # rounding to pixels
                width = min(first.shape[1], second.shape[1]) - 1
                near = np.any([part[:, 1:width] for part in around], axis=0)
                assert np.mean(near[first[:, 1:width]]) > 0.9
                compared += 1
    assert compared >= 1


def test_each_kind_of_line_and_each_size_is_a_layer(tmp_path):
    """As poppler lists a file's optional content, and as it draws a page without one of them."""
    made = [pattern(name="one", size="75B"), pattern(name="two", size="80C")]
    write_pdf_sheet(tmp_path / "p.pdf", made, "nest")
    raw = (tmp_path / "p.pdf").read_bytes()
    names = re.findall(rb"/Name \(([^)]*)\) /Type /OCG", raw)
    wanted = {f"{size} {kind}" for size in ("75B", "80C") for kind in ("cut", "sew", "notch", "grain", "drill", "text")}
    assert {name.decode() for name in names} == wanted | {"info"}
    hidden = raw.replace(b"/D <<\n/ON", b"/D <<\n/OFF")
    assert hidden != raw
    (tmp_path / "hidden.pdf").write_bytes(hidden)  # one byte longer: readers rebuild the table of objects
    assert pages(tmp_path / "p.pdf", dpi=72)[0].sum() > 1000
    assert pages(tmp_path / "hidden.pdf", dpi=72)[0].sum() == 0


def test_projector_page_is_the_sheet_with_wider_lines(tmp_path):
    write_pdf_sheet(tmp_path / "sheet.pdf", [pattern()], "lune")
    write_pdf_projector(tmp_path / "wide.pdf", [pattern()], "lune")
    (sheet,), (wide,) = (pages(tmp_path / name) for name in ("sheet.pdf", "wide.pdf"))
    assert sheet.shape == wide.shape
    assert wide.sum() > 1.5 * sheet.sum()


def test_what_is_doubtful_of_the_fit_is_printed_with_the_pattern(tmp_path):
    """The sheet goes to a cutter without the report."""
    doubt = Remark("proposed_landmarks", "the wire's outer end is a guess, 56 mm off", remedy="mark it by hand")
    made = pattern(told=[doubt], material_width=50.0)
    write_pdf_tiles(tmp_path / "patterns.pdf", [made], "lune")
    write_pdf_sheet(tmp_path / "sheet.pdf", [made], "lune")
    for name, pages_told in (("patterns.pdf", ["-l", "1"]), ("sheet.pdf", [])):
        command = [program("pdftotext"), *pages_told, tmp_path / name, "-"]
        words = " ".join(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())
        assert words.count(f"WARNING: {doubt}") == 1
        assert "wider than the material" in words


@pytest.mark.parametrize("name", ["anny_05", "", "Größe 胸 \U0001f600", "a\nb\x07", "x" * 300])
def test_any_name_makes_a_readable_file(tmp_path, name):
    write_pdf_tiles(tmp_path / "p.pdf", [pattern(name=name, units="inch")], name, note=name)
    text = subprocess.run([program("pdftotext"), tmp_path / "p.pdf", "-"], check=True, capture_output=True, text=True)
    assert "control square" in text.stdout
    assert "lower panel" in text.stdout
    assert " in" in text.stdout


@pytest.mark.parametrize(
    "name", ["Надія Шевченко", "Ελένη Παπαδοπούλου", "Nguyễn Thị Phương", "Łucja Ďuriš", "Gülşah Öztürk"]
)
def test_names_in_other_scripts_come_out_as_written(tmp_path, name):
    write_pdf_sheet(tmp_path / "p.pdf", [pattern(name=name)], name)
    text = subprocess.run([program("pdftotext"), tmp_path / "p.pdf", "-"], check=True, capture_output=True, text=True)
    assert text.stdout.count(name) >= 3  # title and both labels
    fonts = subprocess.run([program("pdffonts"), tmp_path / "p.pdf"], check=True, capture_output=True, text=True)
    rows = [line.split() for line in fonts.stdout.splitlines()[2:]]
    assert len(rows) == 2
    assert all("yes" in row for row in rows), "embedded"
