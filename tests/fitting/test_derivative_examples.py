"""The examples of derivatives run from a clone, and their numbers are what they say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]


def said(name: str, *arguments: str) -> str:
    """What an example prints."""
    paths = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
    run = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name), *arguments],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": paths},
        check=False,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.slow
def test_the_picture_of_the_points_that_move_the_ridge(tmp_path):
    picture = tmp_path / "ridge.png"
    printed = said("which_points_move_the_ridge.py", str(ROOT / "brafit" / "samples" / "anny_01.ply"), str(picture))
    most, median = (float(v) for v in re.findall(r"([\d.]+) mm a mm", printed))
    assert most > 2 * median > 0
    with Image.open(picture) as image:
        assert len(image.convert("RGB").getcolors(1 << 24) or ()) > 100  # the points' colours


@pytest.mark.slow
def test_one_step_brings_the_pattern_near_the_width_of_cloth():
    printed = said("fit_a_width_of_cloth.py")
    before, wanted = (float(v) for v in re.findall(r"([\d.]+) mm wide; wanted: ([\d.]+)", printed)[0])
    found = float(re.findall(r"its pattern ([\d.]+) mm wide", printed)[0])
    assert wanted < before
    assert abs(found - wanted) < 0.4 * (before - wanted)
