from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from brafit.errors import BrafitError
from brafit.scan import find_scans, load_scan
from brafit.simulation.bodies import Bodies

SCRIPT = Path(__file__).parents[2] / "scripts" / "make_scans.py"


def make(folder: Path, *options: str) -> str:
    command = [sys.executable, str(SCRIPT), "--out", str(folder), *options]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_spheres_are_spheres_with_the_defects_asked_for(tmp_path):
    said = make(
        tmp_path,
        "--spheres",
        "--count",
        "3",
        "--points",
        "6000",
        "--noise",
        "0.5",
        "--outliers",
        "0.05",
        "--holes",
        "2",
    )
    scans = [load_scan(path) for path in find_scans(tmp_path)]
    assert len(scans) == len(said.splitlines()) == 3
    for scan, line in zip(scans, said.splitlines(), strict=True):
        radius = float(line.split("radius ")[1].split(" ")[0])
        assert scan.side in line
        assert scan.cleaning.read == 6000
        np.testing.assert_allclose(np.linalg.norm(scan.wire - [0, radius, 0], axis=1), radius, atol=0.1)
        off = np.linalg.norm(scan.dense - [0, radius, 0], axis=1) - radius
        assert 0.4 < np.sqrt(np.mean(np.clip(off, -2, 2) ** 2)) < 0.75
        assert scan.dense[:, 0].min() > -3
        assert scan.apex is not None
        assert 0.9 < scan.apex[2] / radius < 0.99, "a bust point is where the breast is highest"
        assert 150 < scan.cleaning.outliers + scan.cleaning.off_surface < 500
    assert len({scan.wire[-1, 1] for scan in scans}) == 3


def test_the_same_seed_makes_the_same_scans(tmp_path):
    for name in ("one", "two"):
        make(tmp_path / name, "--spheres", "--count", "1", "--points", "500", "--seed", "4")
    make(tmp_path / "other", "--spheres", "--count", "1", "--points", "500", "--seed", "5")
    one, two, other = ((tmp_path / name / "sphere_0001.ply").read_bytes() for name in ("one", "two", "other"))
    assert one == two != other


def test_a_set_goes_on_where_it_was_broken_off(tmp_path):
    make(tmp_path / "whole", "--spheres", "--count", "2", "--points", "500")
    make(tmp_path / "rest", "--spheres", "--first", "2", "--count", "1", "--points", "500")
    assert not (tmp_path / "rest" / "sphere_0001.ply").exists()
    whole, rest = (tmp_path / name / "sphere_0002.ply" for name in ("whole", "rest"))
    assert whole.read_bytes() == rest.read_bytes()


def test_without_the_bodies_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(BrafitError, match=r"pip install 'brafit\[bodies\]'"):
        Bodies()
