"""The examples run as they stand, from a clone, and the README shows them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import brafit
from brafit.samples import sample_paths

ROOT = Path(__file__).parents[2]
LOOP = (ROOT / "examples" / "adam_loop.py").read_text()


def printed(code: str) -> tuple[float, float]:
    """RMS and least margin that the training loop tells at its end, its loss having fallen on the way."""
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=300
    )
    *steps, last = run.stdout.splitlines()
    found = re.fullmatch(r"anny_04: RMS (\S+) mm, least margin (\S+)", last)
    assert found, run.stdout
    losses = [float(line.removesuffix(" mm²").rpartition(" ")[2]) for line in steps]
    assert len(losses) == 6
    assert losses[-1] < 0.5 * losses[0]
    return float(found[1]), float(found[2])


def test_the_readme_shows_the_training_loop():
    code = LOOP.split('"""', 2)[2].strip()
    assert code in (ROOT / "README.md").read_text()
    assert len(code.split("\n\n")[1].splitlines()) <= 18


def test_the_training_loop_comes_within_a_tenth_of_levenberg_marquardt():
    rms, margin = printed(LOOP)
    assert rms < 1.1 * brafit.fit(sample_paths()[1]).figures["rms_mm"]
    assert margin > 0.3


@pytest.mark.slow
def test_the_training_loop_fits_frames_too():
    code = LOOP.replace("StripsCup", "FramesCup")
    rms, margin = printed(code)
    assert rms < 6
    assert margin > 0.3
