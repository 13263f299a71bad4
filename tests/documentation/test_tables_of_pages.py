"""What the pages say in tables is what the code has: settings with their defaults, columns, landmarks, statuses."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from hydra import compose, initialize_config_module
from omegaconf import DictConfig, ListConfig, OmegaConf
from pages import PAGES, ROOT, tables

from brafit.cli.status import ALL_OK, NOTHING_RAN, SOME_FAILED
from brafit.report.table import SUMMARY_KEYS
from brafit.result import FILES
from brafit.settings.compose import register

FILES_PAGE = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
UNWRITTEN = {"scan's name": "", "runs/DATE_TIME": "runs/${now:%Y-%m-%d_%H-%M-%S}"}
"""Defaults in words, and the settings behind them."""


def named(cell: str) -> list[str]:
    """Settings of a cell such as `pattern.ease.width=` (`.height`): a dot begins another last part."""
    keys: list[str] = []
    for word in re.findall(r"`([\w.]+)=?`", cell):
        keys.append(keys[0].rpartition(".")[0] + word if word.startswith(".") else word)
    return keys


def defaults() -> list[tuple[str, str, str]]:
    """Page, setting and default of each row of a table of settings; one default may stand for all of a row."""
    found = []
    for page in PAGES:
        for head, *rows in tables(page):
            for row in rows if head[:2] == ["setting", "default"] else ():
                keys = named(row[0])
                values = re.findall(r"\[.*?\]|[^,`]+", row[1].replace("`", "").replace(", ", ","))
                values = values * len(keys) if len(values) == 1 else values
                found += [(page.name, key, value) for key, value in zip(keys, values, strict=True)]
    return found


@pytest.fixture(scope="module")
def config() -> DictConfig:
    register()
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        return compose("config", return_hydra_config=True)


@pytest.mark.parametrize(("page", "key", "default"), defaults())
def test_settings_have_the_defaults_that_pages_state(page: str, key: str, default: str, config: DictConfig) -> None:
    default = UNWRITTEN.get(default, default)
    if key in config.hydra.runtime.choices:
        assert (config.hydra.runtime.choices[key] or "none") == default
    elif key == "out":
        assert OmegaConf.to_container(config, resolve=False)["out"] == default  # type: ignore[index,call-overload]
    else:
        assert written(OmegaConf.select(config, key, throw_on_missing=True)) == default


def written(value: Any) -> str:
    """A value as one writes it on the command line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, ListConfig):
        return f"[{','.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def test_every_setting_of_patterns_is_on_the_page(config: DictConfig) -> None:
    known = {key for page, key, _ in defaults() if page == "settings.md"}
    for key in config.pattern:
        if not str(key).startswith("_"):
            assert any(name == f"pattern.{key}" or name.startswith(f"pattern.{key}.") for name in known), key


def test_every_column_is_explained() -> None:
    (rows,) = [rows for head, *rows in tables(ROOT / "docs" / "files.md") if head[0] == "column"]
    assert [name for row in rows for name in re.findall(r"`(\w+)`", row[0])] == list(SUMMARY_KEYS)


def test_every_landmark_is_explained() -> None:
    schema = json.loads((ROOT / "brafit" / "landmarks" / "landmarks.schema.json").read_text(encoding="utf-8"))
    marks = schema["properties"].pop("landmarks")["properties"]
    (rows,) = [rows for head, *rows in tables(ROOT / "docs" / "files.md") if head[0] == "field"]
    explained = {name for row in rows for name in named(row[0])}
    assert explained == set(schema["properties"]) | {f"landmarks.{name}" for name in marks}


def test_every_file_of_a_scan_is_in_the_tree_of_results() -> None:
    tree = FILES_PAGE.partition("RESULTS/\n")[2].partition("```")[0]
    for name in FILES:
        stem, _, suffix = name.rpartition(".")
        assert name in tree or (stem in tree and f".{suffix}" in tree), name


def test_exit_statuses_are_those_of_the_command() -> None:
    (rows,) = [rows for head, *rows in tables(ROOT / "docs" / "files.md") if head[0] == "status"]
    assert [int(row[0]) for row in rows] == [ALL_OK, SOME_FAILED, NOTHING_RAN]
