"""The pictures of docs/for-pattern-makers.md: python scripts/make_page_pictures.py [--out DIR]

The printed pages and the report of one fit of a bundled scan, as poppler and Chromium show them (`make readers`).
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path

from check_marking import chromium_driven
from PIL import Image, ImageOps
from readers import program, quietly

import brafit
from brafit.atomic import write_bytes
from brafit.samples import sample_paths

OUT = Path(__file__).parents[1] / "docs" / "images"
GREY, MARGIN = (226, 226, 226), 16
"""Of the ground that pages lie on, and how far apart they lie, pixels."""
RESOLUTION = 55
"""Of a printed page, dots per inch."""
SIZE = (1200, 1160)
"""Of the browser's window that shows the report."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the pictures (docs/images)")
    out = parser.parse_args().out
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        brafit.fit(sample_paths()[1]).save(folder)
        pictures = {"printed_pages.png": laid_out(pages(folder)), "report.png": report(folder)}
    for file, picture in pictures.items():
        write_bytes(out / file, small(picture))
        print(f"{out / file}: {(out / file).stat().st_size / 1000:.0f} kB")


def pages(folder: Path) -> list[Image.Image]:
    """Of the tiled PDF, as they are printed."""
    pdftoppm = program("pdftoppm", "poppler-utils")
    quietly(pdftoppm, "-png", "-r", RESOLUTION, folder / "patterns.pdf", folder / "page")
    return [Image.open(file).convert("RGB") for file in sorted(folder.glob("page-*.png"))]


def laid_out(sheets: list[Image.Image]) -> Image.Image:
    """The first page at the left, the others one below the other beside it."""
    first, *others = sheets
    width = first.width + max(page.width for page in others) + 3 * MARGIN
    height = max(first.height, sum(page.height + MARGIN for page in others) - MARGIN) + 2 * MARGIN
    ground, y = Image.new("RGB", (width, height), GREY), MARGIN
    ground.paste(first, (MARGIN, MARGIN))
    for page in others:
        ground.paste(page, (first.width + 2 * MARGIN, y))
        y += page.height + MARGIN
    return ground


def report(folder: Path) -> Image.Image:
    """The upper part of report.html in a browser."""
    with chromium_driven() as browser:
        page = browser.new_context(viewport=dict(zip(("width", "height"), SIZE, strict=True))).new_page()
        page.goto((folder / "report.html").as_uri())
        page.wait_for_timeout(2000)  # drawn by software
        shown = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return ImageOps.expand(shown, border=2, fill=GREY)


def small(picture: Image.Image) -> bytes:
    """As PNG, in so few colours that the file is small."""
    few = picture.quantize(200, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
    file = io.BytesIO()
    few.save(file, "PNG", optimize=True)
    return file.getvalue()


if __name__ == "__main__":
    main()
