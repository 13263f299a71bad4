"""What is built here runs elsewhere: the wheel holds every file of the package, and its commands use them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def package_files(folder: Path) -> Iterator[Path]:
    """Files below a folder, as paths from it; not what Python writes beside them."""
    for file in folder.rglob("*"):
        if file.is_file() and "__pycache__" not in file.parts:
            yield file.relative_to(folder)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy: a build writes into its source folder."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for folder in ("brafit", "conf"):
        # Hidden files: what editors and file managers leave.
        ignored = shutil.ignore_patterns("__pycache__", ".*", *(["conf"] if folder == "brafit" else []))
        shutil.copytree(ROOT / folder, source / folder, ignore=ignored)
    program = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", program, target], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (file,) = target.glob("*.whl")
    return file


def test_wheel_holds_every_file_and_no_other(wheel: Path) -> None:
    expected = {f"brafit/{file.as_posix()}" for file in package_files(ROOT / "brafit") if file.parts[0] != "conf"}
    expected |= {f"brafit/conf/{file.as_posix()}" for file in package_files(ROOT / "conf")}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == expected


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Programs of an environment that has the wheel, and the packages it depends on from the one that runs the tests.

    A path file names these: one that is found through it does not count, so this clone's own installation is not seen.
    """
    environment = tmp_path_factory.mktemp("environment")
    venv.create(environment, symlinks=True)
    library = sysconfig.get_path("purelib", "venv", {"base": str(environment)})
    Path(library, "packages.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    python = environment / "bin" / "python"
    arguments = ["install", "-q", "--no-index", "--no-deps", "--disable-pip-version-check", "--ignore-installed", wheel]
    subprocess.run([python, "-m", "pip", *arguments], check=True, env=clean())
    return environment / "bin"


def clean() -> dict[str, str]:
    """This environment without what points Python to the clone."""
    return {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}


def ran(programs: Path, folder: Path, command: str, *arguments: str) -> str:
    done = subprocess.run([programs / command, *arguments], cwd=folder, env=clean(), capture_output=True, text=True)
    assert done.returncode == 0, f"{command}: {done.stdout[-1000:]}{done.stderr[-3000:]}"
    return done.stdout


@pytest.mark.slow
def test_commands_run_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    program = "import brafit, pathlib; print(pathlib.Path(brafit.__file__).parents[1])"
    assert ran(installed, tmp_path, "python", "-c", program).strip().startswith(str(installed.parent))
    ran(installed, tmp_path, "brafit", "experiment=quick", "out=cups", "threads=1")
    fits = sorted(tmp_path.glob("cups/*/fit.json"))
    assert [json.loads(fit.read_text())["status"] for fit in fits] == ["ok"] * 3
    assert "experiment" in ran(installed, tmp_path, "brafit", "--help")
    samples = next(installed.parent.glob("lib/python*/site-packages/brafit/samples"))
    ran(installed, tmp_path, "brafit-mark", str(samples), "--out", "marking")
    assert (tmp_path / "marking" / "index.html").stat().st_size > 0
    assert "anny_01" in ran(installed, tmp_path, "brafit-inspect", str(samples))
    for command in ("brafit-sizes", "brafit-nest", "brafit-collect"):
        assert "usage" in ran(installed, tmp_path, command, "--help")
