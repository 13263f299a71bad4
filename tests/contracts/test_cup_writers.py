"""What every writer of files of the cup promises: what it declares, whole or not at all, in the frame of the scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hpgl import HpglWriter
from lunes import lune_cup, lune_flat

from brafit.atomic import TEMPORARY, write_text
from brafit.errors import ConfigError
from brafit.pattern import PatternWriter, pieces_from_panels
from brafit.pattern.finish import finish
from brafit.pattern.options import PatternOptions
from brafit.report.cup_writers import WRITERS, CupWriter, FormedCup, check_cup_writers, write_cup

SHIFT = np.array([10.0, -20.0, 300.0])


class EdgesWriter(CupWriter):
    """One from outside of brafit: the edges as rows of numbers."""

    files = ("edges.txt",)

    def write(self, folder, cup):
        rows = cup.place(cup.shape.edges.reshape(-1, 3).numpy())
        write_text(folder / "edges.txt", "\n".join(" ".join(map(str, row)) for row in rows))


class Forgetful(EdgesWriter):
    def write(self, folder, cup):
        """Writes nothing."""


class Greedy(EdgesWriter):
    files = ("cup.ply",)


class Meddling(HpglWriter):
    files = ("cup.glb",)


EVERY: dict[str, CupWriter] = {**WRITERS, "edges": EdgesWriter()}


def formed(panels: int = 2) -> FormedCup:
    pieces = pieces_from_panels(lune_flat(panels, 101))
    points = np.random.default_rng(0).normal(size=(50, 3)) + SHIFT
    pattern = finish(pieces, PatternOptions(), name="lune", side="left", date="2026-01-01")
    return FormedCup(lune_cup(panels, 101), lambda p: p + SHIFT, points, np.linspace(-1, 1, 50), pieces, pattern)


def vertices(file: Path) -> np.ndarray:
    """As other programs read them; glTF's are in metres."""
    if file.suffix == ".txt":
        return np.loadtxt(file)
    places = np.asarray(o3d.io.read_triangle_mesh(file).vertices)
    return places * (1000 if file.suffix == ".glb" and np.ptp(places) < 10 else 1)


@pytest.mark.parametrize("name", EVERY)
class TestCupWriter:
    def test_what_it_declares_is_what_it_writes(self, name, tmp_path):
        folder = tmp_path / "new" / "folder"
        written = write_cup(folder, formed(), [name if name in WRITERS else EVERY[name]])
        assert [file.name for file in written] == list(EVERY[name].files)
        assert sorted(file.name for file in folder.iterdir()) == sorted(EVERY[name].files)
        assert all(file.stat().st_size > 100 for file in written)

    def test_the_cup_lies_where_the_scan_lies(self, name, tmp_path):
        cup = formed()
        EVERY[name].write(tmp_path, cup)
        own = cup.place(cup.shape.edges.reshape(-1, 3).numpy())
        found = vertices(tmp_path / EVERY[name].files[0])
        np.testing.assert_allclose(found.min(0), own.min(0), atol=0.01)
        np.testing.assert_allclose(found.max(0), own.max(0), atol=0.01)

    def test_where_nothing_can_be_written_nothing_is_left(self, name, tmp_path):
        (tmp_path / EVERY[name].files[0]).mkdir()
        with pytest.raises(OSError, match=r"."):
            EVERY[name].write(tmp_path, formed())
        assert not [file for file in tmp_path.iterdir() if file.name.startswith(TEMPORARY)]


def test_a_writer_that_breaks_its_word_is_told_of(tmp_path):
    with pytest.raises(RuntimeError, match=r"Forgetful did not write edges\.txt"):
        write_cup(tmp_path, formed(), [Forgetful()])


@pytest.mark.parametrize(
    ("meshes", "formats", "words"),
    [
        (["stl"], [], "pattern.meshes=stl: must be a list of ply, obj, glb"),
        ([EdgesWriter], [], "pattern.meshes=EdgesWriter: must be a list of"),
        ([Greedy()], [], "pattern.meshes: Greedy writes cup.ply, which something else writes"),
        ([EdgesWriter(), Forgetful()], [], "Forgetful writes edges.txt, which something else writes"),
        (["ply"], [Meddling()], "pattern.formats: Meddling writes cup.glb, which something else writes"),
    ],
)
def test_what_is_no_writer_is_refused(meshes: list[object], formats: list[str | PatternWriter], words: str):
    with pytest.raises(ConfigError) as caught:
        check_cup_writers(meshes, formats)
    assert words in str(caught.value)
