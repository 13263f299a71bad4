"""What every writer of patterns promises: true lengths as another program reads them, and whole files or none."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from check_patterns import POINT, pdf_paths
from hpgl import HpglWriter
from patterns import pattern, program

from brafit.atomic import TEMPORARY
from brafit.errors import ConfigError
from brafit.naming import OWN, safe_name
from brafit.pattern import WRITERS, PatternWriter, write_patterns
from brafit.pattern.writers import check_writers

OTHERS: dict[str, PatternWriter] = {"hpgl": HpglWriter()}
"""Writers from outside of brafit."""
EVERY = {**WRITERS, **OTHERS}
SVG = "{http://www.w3.org/2000/svg}"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"


@pytest.mark.parametrize("file", [file for writer in WRITERS.values() for file in writer.files])
def test_no_scan_takes_the_name_of_a_file_that_a_nest_has_in_the_runs_folder(file: str) -> None:
    assert OWN.fullmatch(file)
    assert safe_name(file) != file


def chords(points: Any) -> float:
    return float(np.linalg.norm(np.diff(np.array([(p[0], p[1]) for p in points]), axis=0), axis=1).sum())


def svg_lengths(folder: Path) -> list[float]:
    """Of the sewing lines, by svgelements."""
    elements = pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    groups = ET.parse(folder / "patterns.svg").getroot().iter(f"{SVG}g")  # one in each size, where there are several
    layers = [group for group in groups if group.get(LABEL) == "sew"]
    return [elements.Path(line.get("d")).length(error=1e-6) for layer in layers for line in layer.iter(f"{SVG}path")]


def dxf_lengths(folder: Path) -> list[float]:
    """By ezdxf."""
    filemanagement = pytest.importorskip("ezdxf.filemanagement", reason="the DXF reader ezdxf is not installed")
    document = filemanagement.readfile(folder / "patterns.dxf")
    blocks = [document.blocks[insert.dxf.name] for insert in document.modelspace().query("INSERT")]
    lines = [line for block in blocks for line in block.query('POLYLINE[layer=="14"]')]
    return [chords([v.dxf.location for v in line.vertices]) for line in lines]


def pdf_lengths(folder: Path, file: str = "patterns_sheet.pdf") -> list[float]:
    """Of every path of the large sheet, by poppler."""
    pytest.importorskip("svgelements", reason="the SVG reader svgelements is not installed")
    program("pdftocairo")
    return [curve.length(error=1e-6) * POINT for curve in pdf_paths(folder / file)]


def hpgl_lengths(folder: Path) -> list[float]:
    """By ezdxf's player of HP-GL plots, whose unit is 0.025 mm."""
    api = pytest.importorskip("ezdxf.addons.hpgl2.api", reason="the HP-GL reader ezdxf is not installed")
    document = api.to_dxf((folder / "patterns.plt").read_bytes(), mirror_x=False)
    lines = document.modelspace().query("LINE LWPOLYLINE POLYLINE")
    return [
        0.025 * chords(line.get_points("xy") if line.dxftype() == "LWPOLYLINE" else [line.dxf.start, line.dxf.end])
        for line in lines
    ]


READERS: dict[str, Callable[[Path], list[float]]] = {
    "svg": svg_lengths,
    "dxf": dxf_lengths,
    "pdf": pdf_lengths,
    "projector": lambda folder: pdf_lengths(folder, "patterns_projector.pdf"),
    "hpgl": hpgl_lengths,
}
WITHIN = 0.01
"""Of lengths, mm."""


@pytest.mark.parametrize("name", EVERY)
class TestWriter:
    @staticmethod
    def write(folder: Path, name: str, *patterns: Any, title: str = "lune") -> list[Path]:
        return write_patterns(folder, patterns, title, "left cup, 2 panels", [name if name in WRITERS else EVERY[name]])

    def test_another_program_reads_the_true_lengths(self, name, tmp_path):
        made = pattern(2)
        self.write(tmp_path, name, made)
        found = np.array(READERS[name](tmp_path))
        for piece in made.pieces:
            for line in piece.sew:
                assert np.abs(found - line.length).min() < WITHIN, line.name

    def test_what_it_declares_is_what_it_writes(self, name, tmp_path):
        written = self.write(tmp_path / "new" / "folder", name, pattern(1))
        assert [file.name for file in written] == list(EVERY[name].files)
        assert sorted(file.name for file in (tmp_path / "new" / "folder").iterdir()) == sorted(EVERY[name].files)
        assert all(file.stat().st_size > 100 for file in written)

    def test_the_same_pattern_makes_the_same_lengths_beside_others(self, name, tmp_path):
        """A nest of all scans of a run, pieces of the other side drawn as well."""
        one, other = pattern(2), pattern(3, "right", "other", pair=True)
        self.write(tmp_path / "one", name, one)
        self.write(tmp_path / "both", name, one, other)
        alone, both = (READERS[name](tmp_path / folder) for folder in ("one", "both"))
        assert len(both) > len(alone)
        for own in (one, other):
            for line in (line for piece in own.pieces for line in piece.sew):
                assert np.abs(np.array(both) - line.length).min() < WITHIN

    def test_odd_names_make_a_readable_file(self, name, tmp_path):
        odd = 'a & b <c> "d" \u80f8 \x07\n(%s) PU0,0;'
        self.write(tmp_path, name, pattern(1, name=odd), title=odd)
        assert len(READERS[name](tmp_path)) >= 2

    def test_where_nothing_can_be_written_nothing_is_left(self, name, tmp_path):
        (tmp_path / EVERY[name].files[0]).mkdir()
        with pytest.raises(OSError, match=r"."):
            self.write(tmp_path, name, pattern(1))
        assert not [file for file in tmp_path.iterdir() if file.name.startswith(TEMPORARY)]


class Forgetful(PatternWriter):
    files = ("patterns.tap",)

    def write(self, folder, patterns, title, note):
        """Writes nothing."""


class Greedy(Forgetful):
    files = ("patterns.svg",)


class Astray(Forgetful):
    files = ("../patterns.tap",)


def test_a_writer_that_breaks_its_word_is_told_of():
    with pytest.raises(RuntimeError, match=r"Forgetful did not write patterns\.tap"):
        write_patterns(Path("nowhere"), [pattern(1)], "", "", [Forgetful()])


@pytest.mark.parametrize(
    ("formats", "words"),
    [
        (["step"], "pattern.formats=step: must be a list of svg, dxf, pdf"),
        ([Forgetful], "pattern.formats=Forgetful: must be a list of"),
        ([Greedy()], "Greedy writes patterns.svg, which something else writes"),
        ([Forgetful(), Forgetful()], "Forgetful writes patterns.tap, which something else writes"),
        ([Astray()], "Astray.files must be a tuple of names of files"),
    ],
)
def test_what_is_no_writer_is_refused(formats, words):
    with pytest.raises(ConfigError, match=r"pattern\.formats") as caught:
        check_writers(formats)
    assert words in str(caught.value)
