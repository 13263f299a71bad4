"""Pages of results in windows as narrow as a telephone's, in a real Chromium."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import pytest
from check_marking import chromium_driven
from readers import MissingReaderError
from report.test_page import result

from brafit.report.index import write_index
from brafit.report.table import write_summary
from brafit.run.sweep import SweepJob, gather


@pytest.fixture(scope="module")
def driven() -> Iterator[Any]:
    """A Chromium that opens windows of any width."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with chromium_driven() as one:
                yield one
        except MissingReaderError as missing:
            pytest.skip(str(missing))


@pytest.mark.parametrize("width", [320, 400, 1200])
def test_pages_fit_narrow_windows_and_say_where_a_table_goes_on(tmp_path, driven, width):
    made = result("a_scan_of_a_rather_long_name")
    made.save(tmp_path / "scan")
    write_index(tmp_path / "index.html", [made.row()], [()])
    jobs = [SweepJob("cup.panels=2,cup.terms=4,condition.fairness=0.5", {"cup.panels": "2", "cup.terms": "4"}, 0)]
    write_summary(tmp_path / "sweep" / jobs[0].folder / "summary.csv", [made.row()])
    gather(tmp_path / "sweep", jobs)
    for file in ("index.html", "scan/report.html", "sweep/index.html"):
        page = driven.new_page(viewport={"width": width, "height": 800})
        page.goto((tmp_path / file).as_uri())
        beyond = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert page.evaluate(beyond) == 0, file
        told = "[box.scrollWidth > box.clientWidth + 1, getComputedStyle(box, '::before').content]"
        said = page.evaluate(f"Array.from(document.querySelectorAll('.scroll'), box => {told})")
        assert all(wider == ("goes on to the right" in words) for wider, words in said), file
        assert any(wider for wider, _ in said) == (width < 1000 and file != "scan/report.html")
        page.close()
