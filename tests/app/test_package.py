"""What is written in more than one place agrees: packages, pinned versions."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from brafit import __version__

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


def test_one_version() -> None:
    assert PROJECT["project"]["version"] == __version__
