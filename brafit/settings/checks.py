"""Checks of settings that types alone do not make. A refusal is one line, which says what is allowed."""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf, flag_override
from omegaconf.errors import InterpolationResolutionError

from brafit.errors import ConfigError
from brafit.settings.refusal import EXTRAS, missing_launcher


def check(config: DictConfig) -> None:
    """Check what types alone do not say. Words that a setting chooses from may have capitals (`Letter`), and are put as
    the choice has them.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    try:
        _check_limits(config, "")
    except InterpolationResolutionError as error:
        raise ConfigError(_unresolved(config, error)) from error
    sources(config)
    check_device(config.device)
    if config.scan.wire not in (None, "detect"):
        from brafit.underwires.sizes import wire_size  # NumPy takes a moment

        wire_size(config.scan.wire)


def sources(config: DictConfig) -> list[str]:
    """The `scans` setting as a list of texts.

    Raises:
        ConfigError: it is something else.
    """
    value = config.scans
    values = list(value) if isinstance(value, ListConfig) else [value]
    if not values or not all(isinstance(item, str) and item for item in values):
        raise ConfigError(f"scans={value}: must be a file, a folder, a glob, or a list of these: scans=[A,B]")
    return values


def check_device(name: str) -> None:
    """Refuse a device that PyTorch does not know or this machine does not have.

    Raises:
        ConfigError: names the device and what is allowed.
    """
    if name == "cpu":
        return
    match = re.fullmatch(r"cuda(?::(\d+))?", name)
    if not match:
        raise ConfigError(f"device={name}: must be cpu, cuda or cuda:N")
    import torch  # costs two seconds, which only this question is worth here

    count = torch.cuda.device_count()
    if int(match[1] or 0) >= count:
        raise ConfigError(f"device={name}: PyTorch sees {count or 'no'} CUDA device(s) here; use device=cpu")


def check_launcher(config: DictConfig) -> None:
    """Refuse a launcher whose package is not installed.

    Raises:
        ConfigError: says what to install.
    """
    target = str(config.hydra.launcher.get("_target_", ""))
    match = re.match(r"(hydra_plugins\.hydra_(\w+)_launcher)\.", target)
    if match and match[2] in EXTRAS and not _importable(match[1]):
        raise ConfigError(missing_launcher(match[2], list(config.hydra.overrides.hydra)))


def check_one_job(overrides: Sequence[str]) -> None:
    """Refuse a launcher that is chosen for a single job, which Hydra would run here without a word.

    Args:
        overrides: of Hydra's own settings.

    Raises:
        ConfigError: says what to add.
    """
    chosen = next((text for text in overrides if text.startswith("hydra/launcher=")), None)
    if chosen and chosen != "hydra/launcher=basic":
        remedy = f"add -m and the values to sweep: brafit -m {chosen} KEY=VALUE,VALUE; a single run shares its work out"
        raise ConfigError(f"{chosen}: launchers run the jobs of a sweep, and this is one job; {remedy} by threads=N")


def _unresolved(config: DictConfig, error: InterpolationResolutionError) -> str:
    """What to say of a setting whose value is taken from another that there is not."""
    key = str(error.full_key or "")
    parent, _, last = key.rpartition(".")
    group = OmegaConf.select(config, parent) if parent else config
    plain = OmegaConf.to_container(group, resolve=False) if isinstance(group, DictConfig) else None
    value = plain.get(last) if isinstance(plain, dict) else None
    cause = str(error).partition("\n")[0]
    return f"{key}={value}: its value cannot be taken from elsewhere ({cause}); write ${{...}} of a setting that exists"


def _importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:
        return False


def _check_limits(node: DictConfig | ListConfig, prefix: str) -> None:
    schema = OmegaConf.get_type(node)
    limits = {item.name: item.metadata for item in fields(schema)} if is_dataclass(schema) else {}
    keys = node if isinstance(node, DictConfig) else range(len(node))
    if wanting := [key for key in keys if OmegaConf.is_missing(node, key)]:
        raise ConfigError(f"{prefix}{wanting[0]}: must have a value: {prefix}{wanting[0]}=VALUE")
    items = node.items() if isinstance(node, DictConfig) else enumerate(node)
    for key, value in items:
        name = f"{prefix}{key}"
        bounds = limits.get(str(key), {})
        # a class from outside may stand where bounds hold for numbers and words
        if isinstance(value, DictConfig) or (isinstance(value, ListConfig) and not bounds):
            _check_limits(value, f"{name}.")
        elif isinstance(node, DictConfig) and _is_choice(value, **bounds):
            with flag_override(node, ["readonly", "struct"], False):
                node[key] = value.lower()
        elif value is not None and (allowed := _refusal(value, **bounds)):
            raise ConfigError(f"{name}={_as_written(value)}: must be {allowed}")


def _is_choice(value: Any, choices: Sequence[str] = (), **_: Any) -> bool:
    """Whether a value is one of the words to choose from, but for capitals."""
    return isinstance(value, str) and value.lower() in choices


def _as_written(value: Any) -> Any:
    """A value as it is told: a text that looks like a number in its quotes, which make it a text."""
    return f"'{value}'" if isinstance(value, str) and re.fullmatch(r"[-+\d.]+", value) else value


def _refusal(
    value: Any,
    least: float | None = None,
    most: float | None = None,
    choices: Sequence[str] | None = None,
    word: str | None = None,
    above: float | None = None,
) -> str | None:
    """What is allowed, if the value is not. With a `word` that is it, or a whole number."""
    if word is not None:
        if value == word:
            return None
        if type(value) is not int:
            return f"{word} or a whole number from {least} to {most}"
    if choices is not None and value not in choices:
        return f"one of {', '.join(choices)}"
    if isinstance(value, float) and not math.isfinite(value):
        return "a finite number"
    if above is not None and value <= above:
        return f"above {above:g}, or null"
    if least is None or (value >= least and (most is None or value <= most)):
        return None
    return f"at least {_short(least)}" if most is None else f"from {_short(least)} to {_short(most)}"


def _short(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"
