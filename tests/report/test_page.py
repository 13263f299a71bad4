"""The web pages: what they say, and in a real browser what they show."""

import io
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from check_patterns import chromium, shown_title, with_title
from lunes import RADIUS, lune_cup, lune_flat, sphere_points
from readers import MissingReaderError

from brafit.fitting import CupFit, ResultCode, Target
from brafit.landmarks import CupFrame
from brafit.pattern import PatternOptions, Side
from brafit.remarks import Remark
from brafit.report.dimensions import DEPTH, MARKS, survey_of
from brafit.report.html import MEANINGS
from brafit.report.index import MAIN, write_index
from brafit.result import Result
from brafit.underwires.sizes import wire_size

ROOT = Path(__file__).parents[2]
APEX = np.array([RADIUS * np.sin(np.pi / 4), RADIUS + 7.0, RADIUS * np.sin(np.pi / 4) + 6.0])


def result(
    name: str = "lune", side: Side = "left", panels: int = 2, apex: np.ndarray | None = APEX, **options
) -> Result:
    points, _ = sphere_points(2000)
    shape = lune_cup(panels)
    distances = shape.distances(torch.as_tensor(points)).numpy()
    figures = {"rms_mm": float(np.sqrt(np.mean(distances**2))), "twist_deg_max": 0.0, "outline_sd_mm": float("nan")}
    fit = CupFit(name, ResultCode.CONVERGED, "converged", shape, lune_flat(panels), distances, figures, {}, 3, 1.5)
    target = Target(name, points, shape.edges[0].numpy(), apex=apex, strap_point=np.array([0.0, RADIUS, RADIUS]))
    mirror = np.diag((1.0, -1.0, 1.0)) if side == "right" else np.eye(3)
    sources = {"apex": "given", "neckline": "none"}
    return Result(fit, target, side, CupFrame(np.array([1.0, 2.0, 3.0]), mirror), PatternOptions(**options), sources)


def browser(*arguments: object, profile: Path) -> str:
    try:
        return chromium(*arguments, profile=profile)
    except MissingReaderError as reason:
        pytest.skip(str(reason))


def dom(page: Path, script: str, folder: Path) -> str:
    """The title that a script gives the page, as the browser has it when the page is loaded."""
    try:
        return shown_title(with_title(page, script, folder), folder)
    except MissingReaderError as reason:
        pytest.skip(str(reason))


def test_report_is_one_small_file_that_asks_for_nothing(tmp_path):
    for panels in (2, 3):
        result(panels=panels).save(tmp_path)
        text = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert (tmp_path / "report.html").stat().st_size < 2e6
        assert not re.search(r"https?://", text.replace("http://www.w3.org", "")), "nothing from the network"
        assert not re.search(r"<(link|iframe)\b|<script[^>]*\bsrc=|@import|url\(", text)


def test_report_says_what_was_measured_given_and_guessed(tmp_path):
    made = result('a <b> & "c"', material_width=10.0)
    made = replace(made, fit=replace(made.fit, warnings=(Remark("unsure", "the fit was not sure"),)))
    made.save(tmp_path)
    assert "WARNING: the fit was not sure" in (tmp_path / "patterns.svg").read_text(encoding="utf-8")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>a &lt;b&gt; &amp; &quot;c&quot;</h1>" in text
    for words in (
        "wider than the material",
        "the fit was not sure",
        "Finished dimensions",
        "bust point mark to strap point mark, through the air",
        "area of all panels",
        "neckline",
    ):
        assert words in text
    for dimension in made.dimensions():
        assert (f"{dimension.value:.1f} mm" if dimension.unit == "mm" else f"{dimension.value:.1f} cm²") in text
    assert "inches" not in text
    assert "nan" not in re.sub(r'<script.*?</script>|src="data:[^"]*"', "", text, flags=re.DOTALL)


def test_in_inches_all_that_is_cut_or_bought_is(tmp_path):
    """And what is said of the fit stays in mm, which the page tells."""
    made = result(units="inch")
    made.save(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    for dimension in made.dimensions():
        length, area = f"{dimension.value / 25.4:.2f} in<", f"{dimension.value / 6.4516:.1f} in²<"
        assert (length if dimension.unit == "mm" else area) in text
    (depth,) = (d.value for d in made.dimensions() if d.name == DEPTH)
    assert f"<b>{depth / 25.4:.2f} in</b><span>depth of the cup</span>" in text
    assert f"<b>{made.row()['rms_mm']:.2f} mm</b>" in text
    assert "cm²" not in text
    assert "pieces and dimensions in inches" in text


@pytest.mark.parametrize(
    ("units", "sd", "shown"),
    [("mm", 0.04, "± 0.04"), ("inch", 0.04, "± 0.002"), ("inch", 0.004, "± &lt; 0.001"), ("mm", 0.0, "± 0.00")],
)
def test_a_deviation_that_is_small_is_not_shown_as_none(tmp_path, units, sd, shown):
    made = result(units=units)
    survey = replace(survey_of(made.fit, [], np.array([0.0, RADIUS, RADIUS])), deviation={("cup", DEPTH): sd})
    replace(made, fit=replace(made.fit, survey=survey)).save(tmp_path)
    assert f">{shown}</td>" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_report_tells_sizes_as_cut_from_sizes_as_worn(tmp_path):
    made = {"plain": result(), "eased": result(ease={"width": -10.0, "height": 0.0})}
    for name, one in made.items():
        one.save(tmp_path / name)
    plain, eased = ((tmp_path / name / "report.html").read_text(encoding="utf-8") for name in made)
    for words in ("as cut", "as worn"):
        assert words not in plain
    for words in (
        "<th>lower panel (as cut)</th>",
        "<th>cup (as worn)</th>",
        "<th>over the surface (as worn)</th>",
        "<td>area of all panels, as cut</td>",
        "<span>seam sides differ by, as cut</span>",
    ):
        assert words in eased


def test_dimensions_of_a_lune():
    found = {(d.part, d.name): d.value for d in result(apex=np.array([0.0, RADIUS, RADIUS])).dimensions()}
    assert found["cup", "wire span (end to end)"] == pytest.approx(2 * RADIUS)
    assert found["cup", DEPTH] == pytest.approx(RADIUS)
    assert found["cup", "bust point to inner end, through the air"] == pytest.approx(RADIUS * np.sqrt(2))
    assert found["cup", "bust point to bottom of the wire, through the air"] == pytest.approx(RADIUS * np.sqrt(2))
    assert found["cup", MARKS] == pytest.approx(0)
    assert found["lower panel", "wire"] == pytest.approx(np.pi * RADIUS, abs=0.01)
    assert found["lower panel", "height"] == pytest.approx(2 * RADIUS * np.sin(np.pi / 8), abs=0.02)


def test_dimensions_begin_at_the_cups_own_bust_point():
    """Wherever off the cup the mark lies that it is nearest to: here farther out than a lune's tip."""
    on, off = (
        {(d.part, d.name): d.value for d in result(apex=np.array([0.0, RADIUS, far * RADIUS])).dimensions()}
        for far in (1.0, 1.1)
    )
    assert on.pop(("cup", MARKS)) != off.pop(("cup", MARKS))
    assert off == pytest.approx(on)


@pytest.mark.parametrize("side", ["left", "right"])
def test_report_in_a_browser(tmp_path, side):
    from PIL import Image

    made = result(side=side)
    made.save(tmp_path)
    page = tmp_path / "report.html"
    drawn = dom(page, "document.getElementById('view').dataset.drawn", tmp_path)
    assert int(drawn) > 2000 + 1000, "points and facets"
    assert dom(page, "document.querySelector('img.pieces').naturalWidth > 200", tmp_path) == "true"
    script = "(() => { const t = performance.now(); document.getElementById('fold').value = 40;" \
        " document.getElementById('fold').dispatchEvent(new Event('input'));" \
        " return document.getElementById('fold-share').textContent; })()"  # fmt: skip
    assert dom(page, script, tmp_path) == "40 % folded"
    loaded = dom(page, "Math.round(performance.now())", tmp_path)
    assert float(loaded) < 2000
    browser(f"--screenshot={tmp_path / 'shot.png'}", page.as_uri(), profile=tmp_path / "profile")
    with Image.open(tmp_path / "shot.png") as shot:
        picture = np.asarray(shot.convert("RGB")).astype(int)
    stage = picture[300:760, 60:1140]
    red = (stage[..., 0] > stage[..., 2] + 60).sum()
    assert red > 300, "points outside the cup are red"


def test_index_sorts_in_a_browser(tmp_path):
    rows = [
        {"scan": "b & c", "status": "ok", "side": "left", "rms_mm": 10.5, "p95_mm": 3.0},
        {"scan": "a/d", "status": "ok", "side": "left", "rms_mm": 9.25, "p95_mm": None},
        {"scan": "z", "status": "failed", "reason": "no <points>"},
    ]
    write_index(tmp_path / "index.html", rows, [()] * len(rows))
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'href="b%20%26%20c/report.html"' in text
    assert "no &lt;points&gt;" in text
    assert "2 of 3 scans ok" in text
    names = "Array.from(document.querySelectorAll('tbody tr'), r => r.cells[1].textContent).join('|')"
    head = "Array.from(document.querySelectorAll('th')).find(h => h.textContent === 'rms')"
    assert dom(tmp_path / "index.html", names, tmp_path) == "b &amp; c|a/d|z"
    assert dom(tmp_path / "index.html", f"({head}.click(), {names})", tmp_path) == "a/d|b &amp; c|z"
    assert dom(tmp_path / "index.html", f"({head}.click(), {head}.click(), {names})", tmp_path) == "b &amp; c|a/d|z"


def test_index_shows_and_sorts_warnings(tmp_path):
    made = {"a": result("a"), "b": result("b", material_width=10.0), "c": result("c")}
    made["c"] = replace(made["c"], fit=replace(made["c"].fit, warnings=(Remark("unsure", "the <fit> was not sure"),)))
    for name, one in made.items():
        one.save(tmp_path / name)
    warnings = [[*map(str, (*one.fit.warnings, *one.patterns().warnings))] for one in made.values()]
    write_index(tmp_path / "index.html", [one.row() for one in made.values()], warnings)
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "2 with warnings" in text
    assert "the &lt;fit&gt; was not sure" in text
    assert text.count("wider than the material") == len(made["b"].patterns().warnings) == 2
    names = "Array.from(document.querySelectorAll('tbody tr'), r => r.cells[1].textContent).join('|')"
    head = "Array.from(document.querySelectorAll('th')).find(h => h.textContent === 'warnings')"
    assert dom(tmp_path / "index.html", f"({head}.click(), {names})", tmp_path) == "a|c|b"


def test_index_fits_a_window_of_1200_and_shows_all_figures_on_a_tick(tmp_path):
    row = {"scan": "anny_04", "status": "ok", "side": "left"} | dict.fromkeys(MEANINGS, 0.04635)
    write_index(tmp_path / "index.html", [row], [["the fit was not sure"]])
    table, every = "document.querySelector('.scroll')", "document.getElementById('every')"
    shown = "Array.from(document.querySelectorAll('td.number')).filter(cell => cell.offsetWidth > 0).length"
    assert dom(tmp_path / "index.html", f"{table}.scrollWidth <= {table}.clientWidth", tmp_path) == "true"
    assert dom(tmp_path / "index.html", shown, tmp_path) == str(len(MAIN))
    assert dom(tmp_path / "index.html", f"({every}.click(), {shown})", tmp_path) == str(len(MEANINGS))


def test_decimals_of_a_column_align_and_columns_are_explained_without_tooltips(tmp_path):
    values = (0.0004, 0.8612, 10.62, 204.5)
    rows = [{"scan": f"{k}", "status": "ok"} | dict.fromkeys(MEANINGS, value) for k, value in enumerate(values)]
    write_index(tmp_path / "index.html", rows, [()] * len(rows))
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'data-value="0.8612">([^<]*)<', text)[:2] == ["1", "0.86"]
    assert re.findall(r'data-value="0.0004">([^<]*)<', text)[1] == "&lt; 0.01"
    told = dict(re.findall(r"<dt[^>]*>([^<]*)</dt><dd[^>]*>([^<]*)</dd>", text))
    assert list(told) == re.findall(r'<th class="number[^>]*>([^<]*)<', text)
    assert told["outlines ±"].startswith("standard deviation of the sewing lines")
    assert "number of its scans" in told["seconds a scan"]


def test_report_tells_what_was_found_out_about_the_scan(tmp_path):
    result().save(tmp_path, {"notes": ["unit found: cm & converted"]})
    assert "unit found: cm &amp; converted" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_thumbnail_and_files_of_a_result(tmp_path):
    from PIL import Image

    files = result().save(tmp_path)
    assert {file.name for file in files} == {file.name for file in tmp_path.iterdir()}
    with Image.open(tmp_path / "thumbnail.png") as picture:
        assert picture.size == (264, 176)
    again = result(formats=["svg"], meshes=[], report=False).save(tmp_path)
    assert {file.name for file in again} == {"patterns.svg", "fit.json"} == {file.name for file in tmp_path.iterdir()}


def test_pictures_and_3d_view_of_a_result():
    from PIL import Image

    made = {side: result(side=side) for side in ("left", "right")}
    for one in made.values():
        pictures = one.pictures()
        assert list(pictures) == ["patterns", "fit"]
        for png in pictures.values():
            with Image.open(io.BytesIO(png)) as picture:
                assert picture.width >= 900
    (left, *_), (right, *_) = (made[side].mesh_view() for side in ("left", "right"))
    assert left.shape == right.shape
    # as they are worn: the outer end of a left cup is on the viewer's right, of a right one on the left
    np.testing.assert_allclose(np.sort(left[:500, 0]), np.sort(-right[:500, 0]), atol=2)
    assert left[: len(left) // 8, 0].std() > 1


def test_what_is_not_asked_for_is_not_made(tmp_path):
    """Patterns alone need neither the meshes nor the modules of other formats."""
    result(formats=["dxf"], meshes=[], report=False).save(tmp_path)
    program = (
        "import sys; sys.path[:0] = ['tests', 'scripts']\n"
        "from report.test_page import result\n"
        "result(formats=['dxf'], meshes=[], report=False).save(sys.argv[1])\n"
        "assert not {'matplotlib', 'reportlab', 'ezdxf', 'PIL', 'tensorboard'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program, tmp_path], check=True, env={**os.environ}, cwd=ROOT)


@pytest.mark.parametrize("units", ["mm", "inch"])
def test_the_wire_to_buy_is_in_the_row_and_on_the_page(tmp_path, units):
    """The lunes' wire is the half circle of RADIUS: the differences are the catalogue's figures less its own."""
    one = result(units=units)
    one.save(tmp_path)
    row = one.row()
    wire = wire_size(row["nearest_wire"])
    assert row["nearest_wire_length_diff_mm"] == pytest.approx(wire.length - np.pi * RADIUS, abs=0.02)
    assert row["nearest_wire_span_diff_mm"] == pytest.approx(wire.span - 2 * RADIUS, abs=1e-6)
    length, span = (one.options.length(abs(row[f"nearest_wire_{key}_diff_mm"])) for key in ("length", "span"))
    longer = "longer" if wire.length > np.pi * RADIUS else "shorter"
    wider = "wider" if wire.span > 2 * RADIUS else "narrower"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<b>{wire.name}</b>, {length} {longer} than the wire line and {span} {wider} from end to end" in page
    assert json.loads((tmp_path / "fit.json").read_text())["nearest_wire"] == wire.name


@pytest.mark.parametrize(("pair", "sides"), [(False, "left cup"), (True, "left and right cup")])
def test_the_second_line_names_the_sides_that_are_drawn(pair, sides):
    one = result(pair=pair)
    assert one.panels == one.row()["panels"] == 2
    assert f">{sides}, 2 panels<" in one._drawing.decode()


def test_pages_need_neither_matplotlib_nor_a_browser():
    program = "import sys, brafit.report.page; assert not {'matplotlib', 'tensorboard', 'open3d'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, env={**os.environ})
