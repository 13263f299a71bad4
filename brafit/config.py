"""The settings: their types and limits, and the one line that says what is wrong with them."""

from __future__ import annotations

import importlib.util
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from importlib import resources
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton
from hydra.errors import HydraException
from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf

from brafit.errors import ConfigError
from brafit.quoting import readable
from brafit.refusal import EXTRAS, missing_launcher, refusal, refused_mark


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
class DatasetConfig:
    """dataset=default"""

    manifest: str | None = MISSING
    shard: str | None = MISSING


@dataclass
class TableConfig:
    """sinks.table"""

    _target_: str = MISSING
    parquet: bool = MISSING


@dataclass
class IndexConfig:
    """sinks.index"""

    _target_: str = MISSING
    wanted: bool = MISSING


@dataclass
class BoardConfig:
    """sinks.tensorboard"""

    _target_: str = MISSING
    scans: int = limited(0, 10_000)
    batches: int = limited(0, 1000)


@dataclass
class ProgressConfig:
    """sinks.progress"""

    _target_: str = MISSING
    seconds: float = limited(0.1)
    details: int = limited(0)


@dataclass
class NestConfig:
    """sinks.nest"""

    _target_: str = MISSING
    wanted: bool = MISSING
    formats: list[str] = field(default_factory=list)


@dataclass
class ErrorsConfig:
    """sinks.errors"""

    _target_: str = MISSING


@dataclass
class SinksConfig:
    """sinks=default"""

    table: TableConfig | None = field(default_factory=TableConfig)
    index: IndexConfig | None = field(default_factory=IndexConfig)
    tensorboard: BoardConfig | None = field(default_factory=BoardConfig)
    progress: ProgressConfig | None = field(default_factory=ProgressConfig)
    nest: NestConfig | None = field(default_factory=NestConfig)
    errors: ErrorsConfig | None = field(default_factory=ErrorsConfig)


@dataclass
class Config:
    """All settings of a run. The groups cup, solver, condition and pattern hold whatever their `_target_` takes."""

    scans: Any = MISSING
    out: str = MISSING
    resume: str = one_of("keep", "redo")
    patience: float = limited(1)
    restarts: int = limited(1, 1000)
    batch: int = limited(1)
    device: str = MISSING
    dtype: str = one_of("float64", "float32")
    threads: int | None = limited(1)
    dataset: DatasetConfig = field(default_factory=DatasetConfig)
    sinks: SinksConfig = field(default_factory=SinksConfig)
    scan: ScanConfig = field(default_factory=ScanConfig)
    cup: Any = MISSING
    solver: Any = MISSING
    condition: Any = MISSING
    pattern: Any = MISSING


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
    given = readable_settings(settings)
    try:
        with _own_hydra():
            config = compose("config", overrides=given)
    except Exception as error:
        raise ConfigError(explain(error, given)) from error
    check(config)
    return config


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


def help_text() -> str:
    """What `brafit --help` shows. (Hydra's own way there looks through every group that any plugin brings, which takes
    a second.)
    """
    words = OmegaConf.load(str(resources.files("brafit.conf").joinpath("hydra/help/brafit.yaml")))
    with _own_hydra():
        settings = OmegaConf.to_yaml(compose("config"))
    return f"{words.header}\n{settings}\n{words.footer}"


def choices_of(settings: Sequence[str]) -> dict[str, Any]:
    """Which choice of each group these settings make."""
    with _own_hydra():
        return dict(compose("config", overrides=list(settings), return_hydra_config=True).hydra.runtime.choices)


def check(config: DictConfig) -> None:
    """Check what types alone do not say.

    Raises:
        ConfigError: names the key, what came and what is allowed.
    """
    _check_limits(config, "")
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


def is_setting(key: str) -> bool:
    """Whether a name can only be that of a setting: it has a dot, or is a group's or a plain setting's."""
    return "." in key or key in {item.name for item in fields(Config)}


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
    base = from_settings([f"{key}={value}" for key, value in {**names, **chosen}.items() if value] + ["out=unused"])
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


def _importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ImportError:
        return False


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
