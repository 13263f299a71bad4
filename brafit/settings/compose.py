"""Settings composed: of the shipped ones and of `key=value` texts, by Hydra."""

from __future__ import annotations

import copy
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, flag_override

from brafit.errors import ConfigError
from brafit.settings.checks import check, sources
from brafit.settings.quoting import quoted, readable
from brafit.settings.refusal import refusal, refused_mark
from brafit.settings.schema import (
    AnnealConfig,
    ConditionConfig,
    Config,
    DatasetConfig,
    FramesConfig,
    LMConfig,
    PaperConfig,
    PatternConfig,
    ScanConfig,
    SinksConfig,
    StripsConfig,
)

SEARCH = "hydra.searchpath"
"""Hydra's setting of the folders in which it looks for groups' choices beside ours."""
LONGEST = 150
"""Letters of a job's folder at most."""


def job_folder(overrides: str, number: int) -> str:
    """A folder's name for a job's own overrides (`cup.panels=2,cup.terms=8`); its number if there are none.

    Quotes are left out, and what a name cannot hold becomes an underscore; long names are cut, and end with the number.
    """
    plain = re.sub("""['"]""", "", overrides)
    name = "".join(c if c.isalnum() or c in "=.,-+[]" else "_" for c in plain).strip(".")
    if not name:
        return str(number)
    return name if len(name) <= LONGEST else f"{name[:LONGEST]}_{number}"


def register() -> None:
    """Make the schema known to Hydra, under the names that the defaults lists in conf/ use."""
    OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)
    # Our settings of launchers have the names that everyone knows; Hydra takes the plugins' own for their schema.
    warnings.filterwarnings("ignore", message=r"\s*'hydra/launcher/\w+' is validated against ConfigStore schema")
    store = ConfigStore.instance()
    store.store(name="config_schema", node=Config)
    for group, name, node in (
        ("cup", "frames_schema", FramesConfig),
        ("cup", "strips_schema", StripsConfig),
        ("solver", "anneal_schema", AnnealConfig),
        ("solver", "lm_schema", LMConfig),
        ("solver", "paper_schema", PaperConfig),
        ("condition", "condition_schema", ConditionConfig),
        ("scan", "scan_schema", ScanConfig),
        ("pattern", "pattern_schema", PatternConfig),
        ("dataset", "dataset_schema", DatasetConfig),
        ("sinks", "sinks_schema", SinksConfig),
    ):
        store.store(group=group, name=name, node=node)


@contextmanager
def _own_hydra() -> Iterator[None]:
    """Our settings within the block, whatever application of Hydra this is called in."""
    state = Singleton.get_state()
    GlobalHydra.instance().clear()
    try:
        register()
        with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
            yield
    finally:
        Singleton.set_state(state)


def from_settings(settings: Sequence[str]) -> DictConfig:
    """The configuration that the command line would make of these settings, checked.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    config, _ = composed(settings)
    return config


def composed(settings: Sequence[str]) -> tuple[DictConfig, dict[str, Any]]:
    """The configuration of `from_settings`, and which choice of each group it makes, with the folders where choices of
    others were looked for (SEARCH).

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    config, choices = _composed(settings)
    check(config)
    return config, choices


def _composed(settings: Sequence[str]) -> tuple[DictConfig, dict[str, Any]]:
    """As `composed`, without checks."""
    given = readable_settings(settings)
    try:
        with _own_hydra():
            config = compose("config", overrides=given, return_hydra_config=True)
    except Exception as error:
        raise ConfigError(explain(error, given)) from error
    choices = dict(config.hydra.runtime.choices) | searched(config.hydra)
    with flag_override(config, ["readonly", "struct"], False):
        del config["hydra"]
    return config, choices


def readable_settings(settings: Sequence[str]) -> list[str]:
    """Settings of the form `key=value` as Hydra can read them.

    Raises:
        ConfigError: one would take a setting away or add one (`~key`, `+key=value`), or its name has letters that no
            setting has.
    """
    for text in settings:
        if line := refused_mark(text, lambda: _choices_only(settings)):
            raise ConfigError(line)
    return [readable(text) for text in settings]


def settings_called(name: str) -> list[str]:
    """Settings of this name in any group, in full; those of a name like it where there are none.

    Args:
        name: with or without its group.
    """
    named = dict(_flat(_choices_only(())))
    return named.get(name) or [full for near in get_close_matches(name, named, n=1) for full in named[near]]


def _flat(tree: DictConfig) -> Iterator[tuple[str, list[str]]]:
    """Each setting's name, alone and with its groups, and the settings that it may mean."""
    meant: dict[str, list[str]] = {}
    waiting = [("", tree)]
    while waiting:
        prefix, group = waiting.pop(0)
        for key, node in group.items_ex(resolve=False):
            full = f"{prefix}{key}"
            for name in dict.fromkeys((str(key), full)):
                meant.setdefault(name, []).append(full)
            if isinstance(node, DictConfig):
                waiting.append((f"{full}.", node))
    yield from meant.items()


def help_text() -> str:
    """What `brafit --help` shows. (Hydra's own way there looks through every group that any plugin brings, which takes
    a second.)
    """
    words = OmegaConf.load(str(resources.files("brafit.conf").joinpath("hydra/help/brafit.yaml")))
    with _own_hydra():
        settings = OmegaConf.to_yaml(compose("config"))
    return f"{words.header}\n{settings}\n{words.footer}"


def searched(hydra: Any) -> dict[str, str]:
    """The setting SEARCH for the folders that Hydra looked in: those of `--config-dir` and of the setting itself; empty
    if there were none.
    """
    sources = [source for source in hydra.runtime.config_sources if source.schema == "file"]
    paths = dict.fromkeys([*hydra.searchpath, *(f"file://{Path(source.path).absolute()}" for source in sources)])
    return {SEARCH: f"[{','.join(quoted(path) for path in paths)}]"} if paths else {}


def plain_settings(config: DictConfig) -> dict[str, Any]:
    """A composed configuration as plain values."""
    settings = OmegaConf.to_container(config, resolve=True)
    assert isinstance(settings, dict)
    return {str(key): value for key, value in settings.items()} | {"scans": sources(config)}


def plain_composed(settings: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What `composed` gives, as plain values. Hydra takes longer over it than a small fit, so it is done once for
    settings that name all they depend on.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    elsewhere = any("$" in text or SEARCH in text for text in settings)  # the environment, or files that may change
    return copy.deepcopy((_plain if elsewhere else _plain_once)(tuple(settings)))


def _plain(settings: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
    config, choices = composed(settings)
    return plain_settings(config), choices


_plain_once = lru_cache(maxsize=64)(_plain)


def varied(
    settings: Mapping[str, Any], names: Mapping[str, Any], overrides: Sequence[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings and the names of their groups' choices, changed by some of the form `key=value`.

    A choice of a group (`cup=frames`) brings that group's own defaults.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    groups = {text.partition("=")[0]: text.partition("=")[2] for text in overrides}
    chosen = {key: value for key, value in groups.items() if key in names}
    base, _ = _composed([f"{key}={value}" for key, value in {**names, **chosen}.items() if value] + ["out=unused"])
    given = {key: value for key, value in settings.items() if key not in chosen}
    plain = [text for text in overrides if text.partition("=")[0] not in chosen]
    try:
        changed = OmegaConf.merge(base, given)
        changed.merge_with_dotlist(plain)
    except Exception as error:
        raise ConfigError(explain(error, list(overrides))) from error
    assert isinstance(changed, DictConfig)
    check(changed)
    content = OmegaConf.to_container(changed, resolve=True)
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}, {**names, **chosen}


def explain(error: BaseException, overrides: Sequence[str]) -> str:
    """One line for a setting that Hydra refused: the key, what came and what is allowed.

    Args:
        error: what composing the configuration raised.
        overrides: the command line's arguments.
    """
    return refusal(error, overrides, lambda: _choices_only(overrides))


def _choices_only(overrides: Sequence[str]) -> DictConfig:
    """The configuration of the command line's choices of groups, without its values."""
    folder = resources.files("brafit.conf")
    pairs = [text.partition("=") for text in overrides]
    chosen = [f"{key}={value}" for key, _, value in pairs if key and value and folder.joinpath(key).is_dir()]
    with _own_hydra():
        try:
            return compose("config", overrides=chosen)
        except HydraException:  # a choice that does not exist
            return compose("config")
