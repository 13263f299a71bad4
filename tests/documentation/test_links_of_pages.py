"""What the pages point to is there, and nothing that users are to run is left unnamed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pages import PAGES, ROOT, anchors, blocks, links, tables

RUNNABLE = sorted(
    file for folder in ("scripts", "examples") for file in (ROOT / folder).rglob("*") if file.suffix in (".py", ".sh")
)
PARTS = {
    "analytic_torso.py",
    "bends.py",
    "check_cup.py",
    "check_measures.py",
    "check_pages.py",
    "flattenings.py",
    "outlines.py",
    "paper_figures.py",
    "peers_page.py",
    "readers.py",
}
"""Scripts that only others import."""
NAMES = re.compile(r"(?<![\w./-])(?:docs|brafit|scripts|examples|tests|conf)/[\w./-]*\w")
"""Paths of the repository as texts name them."""


def named(file: Path) -> str:
    """A file as tests are called."""
    return str(file.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_link_leads_somewhere(page: Path) -> None:
    for link in links(page):
        path, _, heading = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert target.is_relative_to(ROOT), link
        if heading:
            assert heading in anchors(target), f"{link}: the headings are {sorted(anchors(target))}"


@pytest.mark.parametrize("file", [*PAGES, *RUNNABLE], ids=named)
def test_every_path_that_is_named_exists(file: Path) -> None:
    for name in NAMES.findall(file.read_text(encoding="utf-8")):
        assert any((base / name).exists() for base in (ROOT, ROOT / "examples" / "extending")), name


@pytest.mark.parametrize("file", RUNNABLE, ids=named)
def test_every_script_and_example_is_named_on_a_page(file: Path) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    if file.name in PARTS:
        others = [other.read_text(encoding="utf-8") for other in RUNNABLE if other != file]
        assert any(re.search(rf"^from {file.stem} import ", other, re.MULTILINE) for other in others)
        assert 'if __name__ == "__main__"' not in file.read_text(encoding="utf-8")
    else:
        assert file.name in text


@pytest.mark.parametrize("page", PAGES[1:], ids=named)
def test_every_page_is_named_by_the_readme(page: Path) -> None:
    assert named(page) in links(PAGES[0])


def test_tables_of_the_readme_fit_on_a_screen() -> None:
    found = tables(PAGES[0])
    assert found
    assert max(len(rows) for rows in found) <= 30


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_commands_stand_in_blocks_of_the_shell(page: Path) -> None:
    """Blocks of another kind are not run."""
    for block in blocks(page):
        if block.language != "sh":
            assert not re.search(r"^(brafit[\w-]*|python|make|pip|tensorboard)( |$)", block.text, re.MULTILINE), block


def test_the_picture_is_small_and_wide() -> None:
    from PIL import Image

    file = ROOT / "docs" / "images" / "overview.png"
    assert file.stat().st_size < 300_000
    with Image.open(file) as image:
        assert image.width >= 1200
