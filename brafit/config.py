"""The settings: their types and limits, and the one line that says what is wrong with them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from importlib import resources
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.errors import OverrideParseException
from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf

from brafit.errors import ConfigError


def limited(least: float, most: float | None = None) -> Any:
    """A dataclass field whose value conf/ gives, and that must lie in [least, most]."""
    return field(default=MISSING, metadata={"least": least, "most": most})


def one_of(*choices: str) -> Any:
    """A dataclass field whose value conf/ gives, and that must be one of these words."""
    return field(default=MISSING, metadata={"choices": choices})


@dataclass
class FramesConfig:
    """cup=frames"""

    _target_: str = MISSING
    _partial_: bool = True
    panels: int = limited(1, 8)
    terms: int = limited(1, 40)
    stations: int = limited(9, 2001)
    basis: str = one_of("cosine", "fourier", "chebyshev")


@dataclass
class StripsConfig:
    """cup=strips"""

    _target_: str = MISSING
    _partial_: bool = True
    panels: int = limited(1, 8)
    terms: int = limited(1, 40)
    stations: int = limited(9, 2001)
    nodes: int = limited(8, 1000)
    output_nodes: int = limited(8, 1000)


@dataclass
class StageConfig:
    """One of solver.stages"""

    optimiser: str = one_of("adam", "lbfgs")
    steps: int = limited(0)
    penalty: float = limited(0)
    rate: float = 0.03
    damping: float = field(default=1e-7, metadata={"least": 0})
    points: int | None = field(default=None, metadata={"least": 0})


@dataclass
class AnnealConfig:
    """solver=anneal"""

    _target_: str = MISSING
    _convert_: str = MISSING
    tolerance: float = limited(0)
    stages: list[StageConfig] = field(default_factory=list)


@dataclass
class PaperConfig:
    """solver=paper"""

    _target_: str = MISSING
    rounds: int = limited(1)
    evaluations: int = limited(1)
    penalty: float = limited(0)
    growth: float = limited(1)
    largest: float = limited(0)
    tolerance: float = limited(0)
    seconds: float | None = limited(0)


@dataclass
class LMStageConfig:
    """One of solver.stages of solver=lm"""

    steps: int = limited(1)
    terms: int | None = field(default=None, metadata={"least": 1})
    points: int | None = field(default=None, metadata={"least": 0})
    keep: int | None = field(default=None, metadata={"least": 1})
    penalty: float = field(default=1.0, metadata={"least": 0})
    tolerance: float = field(default=1e-6, metadata={"least": 0})
    fairness: float = field(default=1.0, metadata={"least": 0})
    plainness: float = field(default=1.0, metadata={"least": 0})
    margin_width: float = field(default=0.0, metadata={"least": 0})


@dataclass
class LMConfig:
    """solver=lm"""

    _target_: str = MISSING
    _convert_: str = MISSING
    margin: float = limited(0)
    apart: float = limited(0)
    stages: list[LMStageConfig] = field(default_factory=list)


@dataclass
class ConditionConfig:
    """condition=default"""

    _target_: str = MISSING
    points: str = one_of("l2", "l1", "robust")
    points_width: float = limited(0)
    neckline: float = limited(0)
    neckline_limit: float | None = limited(0)
    neckline_wave: float = limited(0)
    rim: float = limited(0)
    connection: float = limited(0)
    connection_width: float = limited(0)
    ridge_apex: float = limited(0)
    ridge_apex_width: float = limited(0)
    margin: float = MISSING
    margin_width: float = limited(0)
    barrier: float = limited(0)
    fairness: float = limited(0)


@dataclass
class ScanConfig:
    """scan=default"""

    points: int | None = limited(10)
    outliers: float | None = field(default=MISSING)
    neighbours: int = limited(2, 1000)
    side: str | None = one_of("left", "right", "both")
    units: str | None = one_of("mm", "cm", "in", "m")
    wire: str | None = MISSING
    propose: bool = MISSING
    symmetry: bool = MISSING
    bridge: bool = MISSING
    read_seconds: float = limited(1)
    mesh_points: int = limited(1000, 20_000_000)


@dataclass
class AllowanceConfig:
    """pattern.allowance"""

    wire: float = limited(0, 100)
    ridge: float = limited(0, 100)
    upper: float = limited(0, 100)


@dataclass
class EaseConfig:
    """pattern.ease"""

    width: float = limited(-50, 50)
    height: float = limited(-50, 50)


@dataclass
class PatternConfig:
    """pattern=default"""

    _target_: str = MISSING
    _convert_: str = MISSING
    formats: list[str] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    report: bool = MISSING
    allowance: AllowanceConfig = field(default_factory=AllowanceConfig)
    ease: EaseConfig = field(default_factory=EaseConfig)
    notches: int = limited(0, 20)
    notch_depth: float = limited(0, 20)
    grain: float = limited(-360, 360)
    pair: bool = MISSING
    quantity: int = limited(1)
    size: str = MISSING
    units: str = one_of("mm", "inch")
    paper: str = one_of("a4", "letter")
    material_width: float = limited(1)
    seam_tolerance: float = limited(0)
    twist_limit: float = limited(0)
    nest: bool = MISSING


@dataclass
class Config:
    """All settings of a run. The groups cup, solver, condition and pattern hold whatever their `_target_` takes."""

    scans: Any = MISSING
    out: str = MISSING
    restarts: int = limited(1, 1000)
    batch: int = limited(1)
    device: str = MISSING
    dtype: str = one_of("float64", "float32")
    threads: int | None = limited(1)
    scan: ScanConfig = field(default_factory=ScanConfig)
    cup: Any = MISSING
    solver: Any = MISSING
    condition: Any = MISSING
    pattern: Any = MISSING


def register() -> None:
    """Make the schema known to Hydra, under the names that the defaults lists in conf/ use."""
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
    ):
        store.store(group=group, name=name, node=node)


def from_settings(settings: Sequence[str]) -> DictConfig:
    """The configuration that the command line would make of these settings, checked.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    register()
    try:
        with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
            config = compose("config", overrides=list(settings))
    except Exception as error:
        raise ConfigError(explain(error, list(settings))) from error
    check(config)
    return config


def check(config: DictConfig) -> None:
    """Check what types alone do not say.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    _check_limits(config, "")
    sources(config)
    check_device(config.device)


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


def _check_limits(node: DictConfig | ListConfig, prefix: str) -> None:
    schema = OmegaConf.get_type(node)
    limits = {item.name: item.metadata for item in fields(schema)} if is_dataclass(schema) else {}
    items = node.items() if isinstance(node, DictConfig) else enumerate(node)
    for key, value in items:
        name = f"{prefix}{key}"
        if isinstance(value, DictConfig | ListConfig):
            _check_limits(value, f"{name}.")
        elif value is not None and (allowed := _refusal(value, **limits.get(str(key), {}))):
            raise ConfigError(f"{name}={value}: must be {allowed}")


def _refusal(
    value: Any, least: float | None = None, most: float | None = None, choices: Sequence[str] | None = None
) -> str | None:
    """What is allowed, if the value is not."""
    if choices is not None and value not in choices:
        return f"one of {', '.join(choices)}"
    if least is None or (value >= least and (most is None or value <= most)):
        return None
    return f"at least {least:g}" if most is None else f"from {least:g} to {most:g}"


def explain(error: BaseException, overrides: list[str]) -> str:
    """One line for a setting that Hydra refused: the key, what came and what is allowed.

    Args:
        error: what composing the configuration raised.
        overrides: the command line's arguments.
    """
    text, cause = str(error), error.__cause__ or error
    key = getattr(cause, "full_key", None)
    if isinstance(error, OverrideParseException):
        form = "write key=value; a value with brackets and the like needs quotes of its own: \"key='a[1]'\""
        return f"'{error.override}' cannot be read: {form}"
    if match := re.match(r"Ambiguous value for argument '(.*?)=(.*)'", text):
        choice = f"add -m to run each in turn, or write a list: {match[1]}=[{match[2]}]"
        return f"{match[1]}={match[2]}: several values; {choice}"
    if match := re.search(r"Could not find '(\w+)/(\S+)'", text):
        choices = [name for name in re.findall(r"^\t(\w+)$", text, re.MULTILINE) if not name.endswith("_schema")]
        return f"{match[1]}={match[2]}: there is no such choice; allowed: {', '.join(choices) or 'none'}"
    if match := re.match(r"Value '(.*)' of type '\w+' could not be converted to (\w+)", str(cause)):
        kind = {"Integer": "a whole number", "Float": "a number", "Boolean": "true or false"}.get(match[2], match[2])
        return f"{key}={match[1]}: must be {kind}"
    if match := re.match(r"Invalid value assigned: (\w+) is not a ListConfig", str(cause)):
        return f"{key}: must be a list: {key}=[VALUE,VALUE]"
    if key and re.match(r"Key '.*' (is not in struct|not in ')", str(cause)):
        return _unknown_key(str(key), overrides)
    return " ".join(str(cause).split()) or type(cause).__name__


def _unknown_key(key: str, overrides: list[str]) -> str:
    """What to say of a key that does not exist: the names that do, at the deepest level that does."""
    parent, _, last = key.rpartition(".")
    node = OmegaConf.select(_choices_only(overrides), parent) if parent else _choices_only(overrides)
    if not isinstance(node, DictConfig):
        return f"unknown setting '{key}'"
    names = [str(name) for name in node if not str(name).startswith("_")]
    meant = difflib.get_close_matches(last, names, n=1)
    hint = f"did you mean {f'{parent}.' if parent else ''}{meant[0]}? " if meant else ""
    return f"unknown setting '{key}'; {hint}allowed{f' in {parent}' if parent else ''}: {', '.join(names)}"


def _choices_only(overrides: list[str]) -> DictConfig:
    """The configuration of the command line's choices of groups, without its values."""
    folder = resources.files("brafit.conf")
    chosen = [text for text in overrides if "=" in text and folder.joinpath(text.split("=")[0]).is_dir()]
    with initialize_config_module(version_base="1.3", config_module="brafit.conf"):
        return compose("config", overrides=chosen)
