"""A folder in which the commands of the documentation run as they stand: what they name is there, in small."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from pages import ROOT

from brafit.samples import sample_paths

SCANS = ("a", "anna", "berta")
SHARDS = 16
"""Parts into which the pages divide datasets: where a command names one, there are as many scans."""
QUICK = {
    "scan.points": "100",
    "cup.terms": "6",
    "solver.stages": "[{terms: 4, points: 0, steps: 8, tolerance: 1.0e-2, fairness: 0, plainness: 10},"
    " {terms: 6, steps: 12, tolerance: 1.0e-3, fairness: 0, plainness: 10}, {steps: 15, tolerance: 1.0e-3}]",
    "pattern.formats": "[]",
    "pattern.meshes": "[]",
    "pattern.report": "false",
    "sinks.tensorboard": "null",
}
"""Settings that a command gets besides its own: how good a fit is does not matter. For cup=strips with solver=lm."""
FRAMES = {
    "cup.terms": "2",
    "cup.stations": "21",
    "solver.stages": "[{optimiser: adam, steps: 3, penalty: 1.0}, {optimiser: lbfgs, steps: 5, penalty: 10.0}]",
}
"""The same for the paper's model."""


def furnish(folder: Path) -> None:
    """Put everything that the commands name into an empty folder, but for results and many scans."""
    clone = ("brafit", "conf", "docs", "examples", "scripts", "tests", "constraints.txt", "pyproject.toml", "Makefile")
    for name in clone:
        (folder / name).symlink_to(ROOT / name)
    (folder / "FOLDER").mkdir()
    for k, name in enumerate(SCANS):
        copied(k, folder / "FOLDER" / name)
    for name in ("BODIES", "SCANS"):
        (folder / name).symlink_to("FOLDER")
    for k, name in enumerate("ab"):
        copied(k, folder / name)
    (folder / "list.csv").write_text("cloud,side,name,cup.panels\na.ply,left,first,\nb.ply,left,second,3\n")


def many(folder: Path) -> None:
    """Scans for every shard of FOLDER."""
    for k in range(SHARDS - len(SCANS)):
        copied(k, folder / "FOLDER" / f"scan_{k:02}")


def copied(sample: int, to: Path) -> None:
    """A bundled scan under another name."""
    paths = sample_paths()
    for suffix in (".ply", ".json"):
        shutil.copy(paths[sample % len(paths)].with_suffix(suffix), to.with_suffix(suffix))


def extending(folder: Path) -> None:
    """Put what docs/extending.md works with into a folder: the examples, and a scan in the example's format."""
    from brafit.cloud import read_cloud

    shutil.copytree(ROOT / "examples" / "extending", folder, dirs_exist_ok=True)
    sample = sample_paths()[0]
    rows = "\n".join(" ".join(map(repr, point)) + " 0.5" for point in (read_cloud(sample).points / 1000).tolist())
    count = rows.count("\n") + 1
    head = f"{count}\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    (folder / "scan.ptx").write_text(f"{head}{rows}\n")
    marks = json.loads(sample.with_suffix(".json").read_text())
    del marks["units"]  # the cloud is in metres: found
    (folder / "scan.json").write_text(json.dumps(marks))


def programs(folder: Path) -> None:
    """`python`, `tensorboard` and the commands of pyproject.toml as files. BRAFIT_QUICK has settings for `brafit`."""
    folder.mkdir()
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for name, entry in entries.items():
        module, function = entry.split(":")
        more = "sys.argv += [text for text in os.environ.get('BRAFIT_QUICK', '').split('\\n') if text]\n"
        added = more if name == "brafit" else ""
        text = f"#!{sys.executable}\nimport os, sys\nfrom {module} import {function}\n{added}{function}()\n"
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    for name, arguments in (("python", ""), ("tensorboard", "-m tensorboard.main ")):
        (folder / name).write_text(f'#!/bin/sh\nexec {sys.executable} {arguments}"$@"\n')
        (folder / name).chmod(0o755)


def environment(bin_folder: Path, quick: dict[str, str]) -> dict[str, str]:
    """In which the programs are found and `brafit` gets settings besides; the examples' modules are not on the path."""
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path and "extending" not in path]
    return {
        **os.environ,
        "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *paths]),
        "BRAFIT_QUICK": "\n".join(f"{key}={value}" for key, value in quick.items()),
        "OMP_NUM_THREADS": "1",
    }


def run(command: str, folder: Path, bin_folder: Path, quick: dict[str, str] | None = None, seconds: float = 500) -> str:
    """Run a line of the shell; what it printed.

    Args:
        command: the line.
        folder: to run it in.
        bin_folder: where `programs` are.
        quick: settings that `brafit` gets besides.
        seconds: it may take.

    Raises:
        AssertionError: it failed; holds all that it printed.
    """
    done = subprocess.run(
        ["bash", "-ec", command], cwd=folder, env=environment(bin_folder, quick or {}),
        capture_output=True, text=True, timeout=seconds, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr
