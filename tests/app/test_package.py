"""What is written in more than one place agrees: packages, pinned versions."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

from brafit import __version__
from brafit.cloud.open3d_runtime import LIBRARIES

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def plain(name: str) -> str:
    return re.split(r"[\[<>=;! ]", name)[0].lower().replace("_", "-")


def test_every_package_is_installed() -> None:
    found = {".".join(file.parent.relative_to(ROOT).parts) for file in (ROOT / "brafit").rglob("__init__.py")}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == found | {"brafit.conf"}


def test_every_dependency_is_pinned() -> None:
    pinned = {plain(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line}
    project = PROJECT["project"]
    wanted = project["dependencies"] + [name for extra in project["optional-dependencies"].values() for name in extra]
    assert {plain(name) for name in wanted} - {"brafit", "open3d"} <= pinned


def test_set_up_brings_the_libraries_that_a_failed_import_names() -> None:
    script = (ROOT / "scripts" / "setup.sh").read_text()
    listed = {name: value.split() for name, value in re.findall(r'^open3d_(\w+)="(.+)"$', script, re.MULTILINE)}
    assert [re.sub(r"\.so\..*", ".so", name) for name in listed["libraries"]] == list(LIBRARIES)
    assert listed["packages"] == list(LIBRARIES.values())


def test_one_version() -> None:
    assert PROJECT["project"]["version"] == __version__


def test_a_folder_of_its_name_does_not_hide_it(tmp_path: Path) -> None:
    """As one does that a clone lies in."""
    (tmp_path / "brafit").mkdir()
    code = "import brafit, brafit.conf; print(brafit.__version__)"
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == __version__
