"""What is written in more than one place agrees: packages, pinned versions, the README's settings."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_module
from omegaconf import ListConfig, OmegaConf

from brafit import __version__
from brafit.report.table import SUMMARY_KEYS
from brafit.settings.compose import register

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
README = (ROOT / "README.md").read_text()


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


@pytest.mark.parametrize(("key", "default"), re.findall(r"^\| `([\w.]+)=` \| `?([^|`]+?)`? \|", README, re.MULTILINE))
def test_readme_names_settings_and_their_defaults(key: str, default: str) -> None:
    register()
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        config = compose("config", return_hydra_config=True)
    if key in config.hydra.runtime.choices:
        assert (config.hydra.runtime.choices[key] or "none") == default
    elif key == "out":
        assert default == "runs/DATE_TIME"
    else:
        value = OmegaConf.select(config, key, throw_on_missing=True)
        assert written(value) == default


def written(value: Any) -> str:
    """A value as one writes it on the command line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, ListConfig):
        return f"[{','.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def test_readme_explains_every_column() -> None:
    for key in SUMMARY_KEYS:
        assert f"`{key}`" in README, key
