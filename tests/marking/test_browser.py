"""The page in a real Chromium: marks are dragged, placed, mirrored, saved, and brafit fits what was saved."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_torso import OUT, UP, WIRE, front, torso_marks, torso_points, write_torso
from check_marking import camera, chromium_driven, dragged, handle_in, opened, place_of, ray, saved
from check_patterns import MissingReaderError

from brafit.cli.mark import main
from brafit.geometry.polyline import distances, polyline_length
from brafit.landmarks import landmarks_path, landmarks_text, read_breasts, read_landmarks
from brafit.landmarks.cup_frame import frame_from_wire
from brafit.underwires.nearest import nearest_wire

POINTS = 25_000


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with chromium_driven() as driven:
                yield driven
        except MissingReaderError as missing:
            pytest.skip(str(missing))


@pytest.fixture
def context(browser: Any) -> Iterator[Any]:
    made = browser.new_context(viewport={"width": 1100, "height": 760}, accept_downloads=True, has_touch=True)
    yield made
    made.close()


def written(folder: Path, *options: str, unit: str = "mm") -> Path:
    """A torso with marks of its left breast, and the folder of its page."""
    path = folder / "torso.npy"
    write_torso(path, torso_points(POINTS), torso_marks(path, unit=unit), unit)
    with pytest.raises(SystemExit) as ended:
        main([str(path), "--out", str(folder / "pages"), *options])
    assert ended.value.code == 0
    return folder / "pages"


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("torso"))


@pytest.fixture
def page(pages: Path, context: Any) -> Iterator[Any]:
    errors: list[Any] = []
    yield opened(context, pages / "torso.html", errors)
    assert errors == []


@pytest.fixture
def proposed(tmp_path: Path, context: Any) -> Any:
    """A page whose marks nobody has looked at; the wire's outer end and the apex are off."""
    path = tmp_path / "torso.npy"
    marks = torso_marks(path)
    assert marks.wire is not None
    points = {**marks.points, "apex": marks.points["apex"] + [0, 0, 10], "wire_bottom": marks.wire[24]}
    write_torso(path, torso_points(POINTS), replace(marks, wire=marks.wire[:35], points=points, proposed=True))
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    return opened(context, tmp_path / "pages" / "torso.html")


def figure(page: Any, name: str) -> float:
    row = page.locator("#figures tr", has_text=name).first
    return float(row.locator("td").last.inner_text().split()[0].replace("−", "-"))


def off_skin(places: np.ndarray) -> np.ndarray:
    """Distances from the front surface, to the first order."""
    x, y, z = places.T
    slope = [(front(x + dx, y + dy) - front(x - dx, y - dy)) / 0.02 for dx, dy in ((0.01, 0), (0, 0.01))]
    return np.abs(z - front(x, y)) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)


def test_marks_that_are_dragged_are_saved_where_they_were_dropped_and_fitted(tmp_path, page):
    page.click("[data-mark=neckline]")
    dropped = {name: dragged(page, name, 9, 7) for name in ("apex", "strap_point", "inner_end", "wire.2", "inner.1")}
    page.click("[data-view=left]")
    page.wait_for_timeout(300)
    dropped["outer_end"] = dragged(page, "outer_end", 6, -8)
    file = saved(page, tmp_path)
    assert file.name == "torso.json"
    marks = read_landmarks(file)
    for name, place in dropped.items():
        assert np.linalg.norm(handle_in(marks, name, place) - place) < 1, name
    assert marks.wire is not None
    assert marks.upper_line is not None
    assert off_skin(marks.wire).max() < 0.5
    assert off_skin(marks.upper_line).max() < 0.5
    # The figures that the page shows are those of the file.
    near = nearest_wire(marks.wire)
    assert figure(page, "Wire, length") == pytest.approx(polyline_length(marks.wire), abs=0.06)
    assert page.locator("#figures b").inner_text() == near.wire.name
    assert figure(page, near.wire.name) == pytest.approx(near.length, abs=0.06)
    cloud = write_torso(tmp_path / "torso.npy", torso_points(POINTS), None)
    settings = ["experiment=quick", "threads=1", f"out={tmp_path / 'run'}"]
    command = [sys.executable, "-m", "brafit", str(cloud), *settings]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    row = json.loads((tmp_path / "run" / "torso" / "fit.json").read_text())
    assert row["status"] == "ok"
    assert row["wire_length_mm"] == pytest.approx(polyline_length(marks.wire), abs=1.0)


def test_untouched_marks_are_saved_as_they_were(tmp_path, context):
    page = opened(context, written(tmp_path, unit="m") / "torso.html")
    given = torso_marks(Path("torso.npy"))
    found = read_landmarks(saved(page, tmp_path))
    assert found.units == "m"
    assert given.wire is not None
    assert found.wire is not None
    np.testing.assert_allclose(1000 * found.wire, given.wire, atol=0.002)
    x, y = place_of(page, "apex")
    page.mouse.click(x, y)
    page.keyboard.press("Alt+ArrowRight")
    moved = read_landmarks(saved(page, tmp_path))
    assert moved.wire is not None
    step = 1000 * (moved.points["apex"] - found.points["apex"])
    assert step[0] == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose(1000 * moved.wire, 1000 * found.wire, atol=1e-9)


def test_lines_given_from_the_outer_end_are_saved_that_way_round_until_they_are_moved(tmp_path, context):
    path = tmp_path / "torso.npy"
    marks = torso_marks(path)
    assert marks.wire is not None
    strap = marks.points["strap_point"]
    corners = (marks.wire[0], strap, marks.wire[-1])
    line = np.concatenate([np.linspace(a, b, 12, endpoint=False) for a, b in pairwise(corners)] + [marks.wire[-1:]])
    given = replace(marks, wire=marks.wire[::-1], upper_line=line[::-1])
    write_torso(path, torso_points(POINTS), given)
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    found = read_landmarks(saved(page, tmp_path))
    for own, was in ((found.wire, marks.wire[::-1]), (found.upper_line, line[::-1])):
        assert own is not None
        np.testing.assert_allclose(own, was, atol=0.002)
    dragged(page, "wire.2", 6, 6)
    moved = read_landmarks(saved(page, tmp_path))
    for own in (moved.wire, moved.upper_line):
        assert own is not None
        np.testing.assert_allclose(own[[0, -1]], marks.wire[[0, -1]], atol=0.1)


@pytest.mark.parametrize("tilt", [0.0, 25.0])
def test_the_depth_is_the_one_of_the_reports(tmp_path, context, tilt):
    """Farthest out of the wire's plane in the cup frame, also where the apex is not marked at the farthest place."""
    path, points = tmp_path / "torso.npy", torso_points(POINTS)
    marks = torso_marks(path)
    assert marks.wire is not None
    wire = marks.wire + np.outer(np.sin(np.linspace(0, np.pi, len(marks.wire))), [0.0, 0.0, tilt])  # off the skin
    apex = marks.wire[20] * 0.2 + marks.points["apex"] * 0.8
    write_torso(path, points, replace(marks, wire=wire, points={**marks.points, "apex": apex}))
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    frame = frame_from_wire(wire, "left", apex, path)
    near = points[np.linalg.norm(points - apex, axis=1) < 40]
    assert frame.to_cup(near)[:, 2].max() > frame.to_cup(apex)[2] + 0.3
    assert figure(page, "Depth of the breast") == pytest.approx(frame.to_cup(near)[:, 2].max(), abs=0.1)


def test_only_a_person_says_that_marks_were_looked_at(tmp_path, proposed):
    doubts = proposed.locator("#origin li")
    before = doubts.all_inner_texts()
    ends = [words for words in before if "outer end" in words]
    assert len(ends) == 1
    assert [words for words in before if "the bust point is 10 mm off" in words]
    dragged(proposed, "apex", 5, 4)
    assert proposed.locator("#looked").is_checked() is False
    assert ends[0] in doubts.all_inner_texts()
    assert not [words for words in doubts.all_inner_texts() if "the bust point" in words]
    assert read_landmarks(saved(proposed, tmp_path)).proposed
    fine, faults = proposed.locator("#faults .fine"), proposed.locator("#faults")
    assert "the doubts above stand" in faults.inner_text()
    dragged(proposed, "outer_end", 8, -8)
    assert doubts.count() == 0
    assert "nobody has looked" in faults.inner_text()
    assert fine.count() == 0
    assert read_landmarks(saved(proposed, tmp_path)).proposed
    proposed.keyboard.press("Control+z")
    assert ends[0] in doubts.all_inner_texts()
    proposed.check("#looked")
    assert doubts.count() == 0
    assert fine.count() == 1
    assert not read_landmarks(saved(proposed, tmp_path)).proposed


def test_an_end_of_the_wire_off_the_skin_is_unusual(page):
    page.evaluate("""(() => {
        const { breast } = brafitMark, at = breast.outer_end;
        brafitMark.set({ ...breast, outer_end: [at[0] + 15, at[1], at[2] + 15] });
    })()""")
    assert "Outer end: " in page.locator("#faults .unsure").inner_text()


def test_copied_marks_bring_none_of_the_doubts_of_those_that_they_replace(tmp_path, context):
    path = tmp_path / "torso.npy"
    left, right = (torso_marks(path, side) for side in ("left", "right"))
    assert right.wire is not None
    write_torso(path, torso_points(POINTS), left)
    text = landmarks_text([left, replace(right, wire=right.wire[:31], proposed=True)])
    landmarks_path(path).write_text(text)
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    panel = page.locator(".panel")
    assert "146 mm" not in panel.inner_text()
    page.click("[data-side=right]")
    assert "146 mm" in panel.locator("#origin .unsure").inner_text()
    page.click("[data-side=left]")
    page.click("#mirror")
    assert "146" not in panel.inner_text()
    assert panel.locator("#origin").inner_text() == "Copied from the other side; look at it."
    assert panel.locator("#faults .fine").count() == 0


def test_how_far_copied_marks_were_moved_onto_the_skin_is_said(tmp_path, context):
    path = tmp_path / "torso.npy"
    marks = torso_marks(path)
    apex = marks.points["apex"] + [0, 0, 4.0]
    write_torso(path, torso_points(POINTS), replace(marks, points={**marks.points, "apex": apex}))
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    page.click("#mirror")
    said = re.search(r"moved marks by up to (\d\.\d) mm; look at it", page.locator("#origin").inner_text())
    assert said is not None
    (copied,) = (one for one in read_breasts(saved(page, tmp_path)) if one.side != marks.side)
    away = np.linalg.norm(copied.points["apex"] * [-1, 1, 1] - apex)
    assert 2 < away < 5
    assert float(said[1]) == pytest.approx(away, abs=0.3)


def test_named_points_that_nobody_touched_are_saved_as_they_were(tmp_path, context):
    path = tmp_path / "torso.npy"
    marks = torso_marks(path)
    assert marks.wire is not None
    points = {**marks.points, "wire_bottom": marks.wire[24], "inner_end": marks.wire[0] + [0.5, 0, 0]}
    write_torso(path, torso_points(POINTS), replace(marks, points=points))
    before = json.loads(landmarks_path(path).read_text())
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    assert json.loads(saved(page, tmp_path).read_text()) == before
    dragged(page, "wire.1", 6, 6)
    after = json.loads(saved(page, tmp_path).read_text())["landmarks"]
    assert after["apex"] == before["landmarks"]["apex"]
    assert after["wire_bottom"] != before["landmarks"]["wire_bottom"]
    assert "outer_end" in after


def test_a_wire_found_in_the_crease_is_saved_once_a_person_looked_at_it(tmp_path, context):
    path = tmp_path / "torso.npy"
    write_torso(path, torso_points(POINTS), replace(torso_marks(path), wire=None))
    before = json.loads(landmarks_path(path).read_text())
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path / "pages")])
    page = opened(context, tmp_path / "pages" / "torso.html")
    assert "found in the crease" in page.locator("#origin").inner_text()
    assert json.loads(saved(page, tmp_path).read_text()) == before
    page.check("#looked")
    marks = read_landmarks(saved(page, tmp_path))
    assert marks.wire is not None
    assert not marks.proposed


def test_the_panel_fits_its_width_and_hides_nothing_behind_the_button(proposed):
    proposed.set_viewport_size({"width": 1300, "height": 900})
    assert proposed.evaluate(
        "document.querySelector('.rest').scrollWidth <= document.querySelector('.rest').clientWidth"
    )
    rest, button = proposed.locator(".rest").bounding_box(), proposed.locator(".save").bounding_box()
    assert rest["y"] + rest["height"] <= button["y"] + 0.5
    assert button["y"] + button["height"] <= 900.5
    proposed.hover("[data-side=left]")
    style = "getComputedStyle(document.querySelector('[data-side=left]'))"
    words, ground = proposed.evaluate(f"[{style}.color, {style}.backgroundColor]")
    assert words == "rgb(255, 255, 255)"
    assert ground == "rgb(11, 83, 148)"


def test_a_saved_scan_that_nobody_looked_at_is_not_done(tmp_path, context, proposed):
    saved(proposed, tmp_path)
    index = context.new_page()
    index.goto((tmp_path / "pages" / "index.html").as_uri())
    assert index.locator(".state").inner_text().startswith("saved, not looked at: left")
    assert index.locator("#done").inner_text() == "0"
    proposed.check("#looked")
    saved(proposed, tmp_path)
    # The browser tells the other page in its own time.
    index.wait_for_function("document.getElementById('done').textContent === '1'", timeout=10_000)


def test_undo_and_what_a_closed_page_keeps(tmp_path, context, pages, page):
    first = page.evaluate("JSON.stringify(brafitMark.breasts)")
    dragged(page, "apex", 20, 5)
    second = page.evaluate("JSON.stringify(brafitMark.breasts)")
    dragged(page, "wire.1", 5, 5)
    page.keyboard.press("Control+z")
    assert page.evaluate("JSON.stringify(brafitMark.breasts)") == second
    page.keyboard.press("Control+z")
    assert page.evaluate("JSON.stringify(brafitMark.breasts)") == first
    assert page.locator("#undo").is_disabled()
    page.keyboard.press("Control+Shift+Z")
    assert page.evaluate("JSON.stringify(brafitMark.breasts)") == second
    page.close()
    index = context.new_page()
    index.goto((pages / "index.html").as_uri())
    assert index.locator(".state").inner_text().startswith("begun, not saved")
    page = opened(context, pages / "torso.html")
    kept, before = page.evaluate("brafitMark.breast"), json.loads(second)["left"]
    np.testing.assert_allclose(kept["apex"], before["apex"], atol=1e-4)
    np.testing.assert_allclose(kept["wire"]["points"], before["wire"]["points"], atol=1e-4)
    saved(page, tmp_path / "elsewhere")
    index.reload()
    assert index.locator(".state").inner_text().startswith("saved ")
    assert index.locator("#done").inner_text() == "1"


def test_a_breast_is_marked_by_clicks_alone_and_copied_to_the_other_side(tmp_path, page):
    page.click("[data-side=right]")
    page.click("[data-view=front]")
    page.evaluate("brafitMark.camera.look(brafitMark.camera.home.centre, 420); brafitMark.redraw()")
    page.wait_for_timeout(300)
    view = camera(page)
    angle = np.linspace(0, np.pi, 7)
    wire = np.stack([-OUT + WIRE * np.cos(angle), UP - WIRE * np.sin(angle)], axis=1)

    def click(x: float, y: float, count: int = 1) -> None:
        place, towards = ray(view, 0, 0)
        assert towards == pytest.approx([0, 0, 1], abs=0.03)
        right, up, _ = np.array(view["rows"])
        away = np.array([x, y, float(front(np.array(x), np.array(y)))]) - place
        across, down = view["scale"] * float(away @ right), -view["scale"] * float(away @ up)
        page.mouse.click(across, down, click_count=count)

    for x, y in wire[:-1]:
        click(x, y)
    assert "finish it" in page.locator("#hint").inner_text()
    click(*wire[-1], count=2)
    click(-OUT - 5, UP + 80)
    click(-OUT, UP)
    assert page.locator("#hint").inner_text() == "Save when you are done."
    assert page.locator("#faults .fine").count() == 1
    page.click("#mirror")
    assert page.locator("#looked").is_checked() is False
    left, right = sorted(read_breasts(saved(page, tmp_path)), key=lambda breast: breast.side)
    assert (left.side, left.proposed, right.side, right.proposed) == ("left", True, "right", False)
    assert right.wire is not None
    assert left.wire is not None
    true = torso_marks(Path("torso.npy"), "right").wire
    assert true is not None
    assert distances(right.wire, true).max() < 2
    assert off_skin(right.wire).max() < 0.6
    assert right.upper_line is not None
    assert off_skin(right.upper_line).max() < 0.6
    assert distances(left.wire * [-1, 1, 1], right.wire).max() < 0.6
    assert np.linalg.norm(right.points["apex"] - torso_marks(Path("torso.npy"), "right").points["apex"]) < 1


def test_the_breast_that_is_not_worked_on_stays_in_the_file(tmp_path, context):
    page = opened(context, written(tmp_path, "--side", "right") / "torso.html")
    assert page.locator("[data-side]").count() == 1
    assert page.locator("#hint").inner_text().startswith("Wire: click its inner end")
    (left,) = read_breasts(saved(page, tmp_path))
    given = torso_marks(Path("torso.npy")).wire
    assert left.side == "left"
    assert left.wire is not None
    assert given is not None
    np.testing.assert_allclose(left.wire, given, atol=0.002)


def test_what_brafit_would_refuse_is_said_while_it_is_drawn(page):
    assert page.locator("#faults .warnings").count() == 0
    # Both ends at one place: no bow any more.
    (x, y), (u, v) = place_of(page, "inner_end"), place_of(page, "outer_end")
    dragged(page, "outer_end", round(x - u) + 12, round(y - v), steps=3)
    assert "ends are too near" in page.locator("#faults .warnings").inner_text()


def test_handles_come_and_go(page):
    count = page.evaluate("brafitMark.breast.wire.via.length")
    before = page.evaluate("brafitMark.breast.wire.points")
    (x, y), (u, v) = place_of(page, "wire.1"), place_of(page, "wire.2")
    view = page.evaluate("brafitMark.camera.project(brafitMark.breast.wire.points.reduce((best, p) => {"
        f"const m = [{(x + u) / 2}, {(y + v) / 2}], d = (q) => {{ const s = brafitMark.camera.project(q);"
        "return Math.hypot(s[0] - m[0], s[1] - m[1]); }; return d(p) < d(best) ? p : best; }))")  # fmt: skip
    page.mouse.dblclick(view[0], view[1])
    assert page.evaluate("brafitMark.breast.wire.via.length") == count + 1
    after = np.array(page.evaluate("brafitMark.breast.wire.points"))
    assert distances(after, np.array(before)).max() < 1
    page.keyboard.press("Delete")
    assert page.evaluate("brafitMark.breast.wire.via.length") == count
    page.locator("#scan").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("brafitMark.chosen") == "wire.0"


def test_two_fingers_bring_the_scan_nearer(context, page):
    touch, scale = context.new_cdp_session(page), page.evaluate("brafitMark.camera.scale")
    rows = page.evaluate("brafitMark.camera.rows")

    def fingers(kind: str, *places: tuple[int, int]) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", (300, 400), (400, 400))
    fingers("touchMove", (250, 400), (450, 400))
    fingers("touchEnd")
    assert page.evaluate("brafitMark.camera.scale") == pytest.approx(2 * scale, rel=0.05)
    assert page.evaluate("brafitMark.camera.rows") == rows
    fingers("touchStart", (150, 650))
    for k in range(1, 6):
        fingers("touchMove", (150 + 20 * k, 650))
    fingers("touchEnd")
    assert page.evaluate("brafitMark.camera.rows") != rows


def test_a_hidden_mark_stays_on_its_own_skin(page):
    page.evaluate("brafitMark.camera.show('back'); brafitMark.redraw()")
    page.wait_for_timeout(300)
    before = np.array(page.evaluate("brafitMark.breast.apex"))
    x, y = place_of(page, "apex")
    page.mouse.move(round(x), round(y))
    page.mouse.down()
    page.mouse.move(round(x) + 12, round(y), steps=3)
    page.mouse.up()
    after = np.array(page.evaluate("brafitMark.breast.apex"))
    assert 1 < np.linalg.norm(after - before) < 12
    assert off_skin(after[None] + page.evaluate("brafitMark.told.origin"))[0] < 0.5


def test_a_hole_does_not_draw_copied_marks_to_its_rim(tmp_path, context):
    path, points = tmp_path / "torso.npy", torso_points(POINTS)
    hole = np.array([-OUT, UP - WIRE, float(front(np.array(-OUT), np.array(UP - WIRE)))])
    write_torso(path, points[np.linalg.norm(points - hole, axis=1) > 20], torso_marks(path))
    with pytest.raises(SystemExit):
        main([str(path), "--out", str(tmp_path)])
    page = opened(context, tmp_path / "torso.html")
    page.click("#mirror")
    left, right = sorted(read_breasts(saved(page, tmp_path)), key=lambda breast: breast.side)
    assert left.wire is not None
    assert right.wire is not None
    assert distances(right.wire * [-1, 1, 1], left.wire).max() < 1.5
