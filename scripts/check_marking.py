"""Marks a scan of 200,000 points by hand, in a real Chromium: how soon its page opens, how it turns, what is saved.

    python scripts/check_marking.py [--points 200000]
    python scripts/check_marking.py --show SCAN --picture docs/marking.png     only a picture of a scan's page

The scan is a torso given by a formula, so that the place where a mark is dropped is known without the page. Prints
each figure beside its limit; status 1 if one is over it. Chromium draws by software here; graphics cards are faster.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from analytic_torso import meets, torso_marks, torso_points, write_torso
from check_patterns import MissingReaderError
from PIL import Image

from brafit.cli.mark import write_page
from brafit.landmarks import Landmarks, read_landmarks

LIMITS = {
    "page, MB": 6.0,
    "opens, s": 3.0,
    "frame while turning, ms, median": 50.0,
    "frame while turning, ms, 95 %": 50.0,
    "saved off where it was dropped, mm, largest of ten": 1.0,
}
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
"""No call to anywhere, and WebGL by software."""
TEN = ("apex", "strap_point", "inner_end", "outer_end", "wire.0", "wire.1", "wire.2", "wire.3", "inner.0", "outer.0")


@contextmanager
def chromium_driven() -> Iterator[Any]:
    """A headless Chromium of playwright that draws by software.

    Raises:
        MissingReaderError: there is no Chromium, or no playwright.
    """
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        raise MissingReaderError("the browser chromium is not installed (make readers)")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise MissingReaderError("the Python package playwright is not installed (extra `test`)") from None
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


def opened(context: Any, file: Path, errors: list[Any] | None = None) -> Any:
    """A page of a scan once it is drawn.

    Args:
        context: of playwright's browser.
        file: the page.
        errors: what goes wrong in the page is added to it.
    """
    page = context.new_page()
    if errors is not None:
        page.on("pageerror", lambda error: errors.append(error))
    page.goto(file.absolute().as_uri())
    page.wait_for_selector("body[data-ready]", timeout=30_000)
    return page


def camera(page: Any) -> dict[str, Any]:
    """How the page looks at the scan: places in mm in the scan's frame, a scale in pixels a mm."""
    script = """(() => {
        const { camera, told } = brafitMark, { rows, centre, scale, width, height } = camera;
        return { rows, centre: centre.map((c, k) => c + told.origin[k]), scale, width, height };
    })()"""
    return page.evaluate(script)


def ray(view: dict[str, Any], x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """A place on the ray of a pixel, and the direction to the viewer."""
    right, up, towards = np.array(view["rows"])
    aside, above = (x - view["width"] / 2) / view["scale"], (view["height"] / 2 - y) / view["scale"]
    return np.array(view["centre"]) + aside * right + above * up, towards


def place_of(page: Any, handle: str) -> tuple[float, float]:
    """The pixel of a handle."""
    x, y, _ = page.evaluate(f"brafitMark.camera.project(brafitMark.placeOf({handle!r}))")
    return x, y


def dragged(page: Any, handle: str, dx: int, dy: int, steps: int = 6) -> np.ndarray:
    """Drag a handle by so many pixels; gives the place of the formula's torso where it was dropped, mm."""
    x, y = place_of(page, handle)
    expected = meets(*ray(camera(page), x + dx, y + dy))
    # Pixels are whole: what is left over stays between pointer and handle.
    page.mouse.move(round(x), round(y))
    page.mouse.down()
    page.mouse.move(round(x) + dx, round(y) + dy, steps=steps)
    page.mouse.up()
    return expected


def saved(page: Any, folder: Path) -> Path:
    """The landmark file that the page's `Save` gives, in a folder."""
    with page.expect_download() as download:
        page.click("#save")
    file = folder / download.value.suggested_filename
    download.value.save_as(file)
    return file


def handle_in(marks: Landmarks, handle: str, near: np.ndarray) -> np.ndarray:
    """A handle's place in a landmark file: a marked point, or the place of the line that is next to `near`."""
    if handle in marks.points:
        return marks.points[handle]
    line = marks.wire if handle.startswith("wire") else marks.upper_line
    assert line is not None
    start, step = line[:-1], np.diff(line, axis=0)
    share = (((near - start) * step).sum(axis=1) / (step**2).sum(axis=1)).clip(0, 1)
    places = start + share[:, None] * step
    return places[np.linalg.norm(places - near, axis=1).argmin()]


def turned(page: Any, moves: int = 60) -> np.ndarray:
    """Milliseconds of each frame while the scan is turned by the mouse."""
    page.evaluate("brafitMark.frames.length = 0")
    page.mouse.move(60, 740)
    page.mouse.down()
    for k in range(moves):
        page.mouse.move(60 + 6 * k, 740 - 3 * k)
    page.mouse.up()
    return np.array(page.evaluate("brafitMark.frames"))


def draw(scan: Path, folder: Path, picture: Path) -> None:
    """A picture of a scan's page, in so few colours that it is small."""
    entry = write_page(scan, scan.stem, folder)
    assert entry.file is not None
    with chromium_driven() as browser:
        page = opened(browser.new_context(viewport={"width": 1120, "height": 800}), folder / entry.file)
        page.evaluate("brafitMark.camera.turn(-0.35, -0.25); brafitMark.told.folder = 'scans'; brafitMark.changed()")
        time.sleep(3.0)
        image = Image.open(io.BytesIO(page.screenshot()))
    few = image.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    few.save(picture, optimize=True)


def measure(points: int, folder: Path) -> dict[str, float]:
    """All figures."""
    cloud = folder / "torso.npy"
    write_torso(cloud, torso_points(points, noise=0.3), torso_marks(cloud))
    entry = write_page(cloud, "torso", folder)
    assert entry.file is not None
    figures = {"page, MB": (folder / entry.file).stat().st_size / 1e6}
    with chromium_driven() as browser:
        context = browser.new_context(viewport={"width": 1280, "height": 800}, accept_downloads=True)
        page = opened(context, folder / entry.file)
        figures["opens, s"] = float(page.evaluate("document.body.dataset.ready")) / 1000
        time.sleep(1.5)
        frames = turned(page)
        figures["frame while turning, ms, median"] = float(np.median(frames))
        figures["frame while turning, ms, 95 %"] = float(np.quantile(frames, 0.95))
        page.click("[data-view=front]")
        page.click("#near")
        page.click("[data-mark=neckline]")
        time.sleep(1.0)
        dropped = {handle: dragged(page, handle, 14, -10) for handle in TEN}
        marks = read_landmarks(saved(page, folder))
        page.close()
    off = [float(np.linalg.norm(handle_in(marks, handle, place) - place)) for handle, place in dropped.items()]
    figures["saved off where it was dropped, mm, largest of ten"] = max(off)
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--show", type=Path, help="a scan; measures nothing")
    parser.add_argument("--picture", type=Path, default=Path("marking.png"), help="where the picture of its page goes")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.show is not None:
            draw(options.show, Path(folder), options.picture)
            return 0
        figures = measure(options.points, Path(folder))
    print(f"{options.points:,} points; load of the machine {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    over = 0
    for name, value in figures.items():
        verdict = "" if value <= LIMITS[name] else "  OVER"
        over += bool(verdict)
        print(f"{name:55s} {value:8.2f}  at most {LIMITS[name]:g}{verdict}")
    return 1 if over else 0


if __name__ == "__main__":
    sys.exit(main())
