"""The stitch list against the OBJ file, and what a sewn cup must be."""

import json

import numpy as np
import pytest
from check_pages import stitch_figures
from lunes import RADIUS, lune_cup, lune_flat

from brafit.pattern import PatternOptions, finish, pieces_from_panels
from brafit.report.mesh import panel_meshes, write_cup_obj
from brafit.report.stitches import write_stitches


def written(folder, panels: int) -> dict:
    pieces = pieces_from_panels(lune_flat(panels))
    meshes = panel_meshes(lune_cup(panels), pieces)
    write_cup_obj(folder / "cup.obj", meshes)
    pattern = finish(pieces, PatternOptions(ease={"width": 5.0, "height": 5.0}), name="lune", side="left")
    write_stitches(folder / "stitches.json", meshes, pattern, "cup.obj")
    return json.loads((folder / "stitches.json").read_text())


@pytest.mark.parametrize("panels", [1, 2, 4])
def test_seams_are_rebuilt_from_the_two_files(tmp_path, panels):
    listed = written(tmp_path, panels)
    assert len(listed["seams"]) == panels - 1
    figures = stitch_figures(tmp_path)
    assert figures["stitches: seams with unequal vertex counts"] == 0
    assert figures["stitches: sewn vertices apart in the cup"] < 1e-6
    assert figures["stitches: lengths differ"] < 0.01
    lengths = [edge["length_mm"] for piece in listed["pieces"] for edge in piece["edges"]]
    np.testing.assert_allclose(lengths, np.pi * RADIUS, atol=0.01)
    objects = [line[2:] for line in (tmp_path / "cup.obj").read_text().splitlines() if line.startswith("o ")]
    assert [piece["object"] for piece in listed["pieces"]] == objects


def test_wrong_stitches_are_found(tmp_path):
    listed = written(tmp_path, 2)
    listed["pieces"][0]["edges"][1]["vertices"].reverse()
    (tmp_path / "stitches.json").write_text(json.dumps(listed))
    assert stitch_figures(tmp_path)["stitches: sewn vertices apart in the cup"] > 10
