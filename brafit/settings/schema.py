"""The settings: their types and limits."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from omegaconf import MISSING


def limited(least: float, most: float | None = None) -> Any:
    """A dataclass field whose value conf/ gives, and that must lie in [least, most]."""
    return field(default=MISSING, metadata={"least": least, "most": most})


def one_of(*choices: str) -> Any:
    """A dataclass field whose value conf/ gives, and that must be one of these words."""
    return field(default=MISSING, metadata={"choices": choices})


PANELS = {"least": 1, "most": 8, "word": "auto"}
"""Limits of `cup.panels`: a whole number, or that word."""


@dataclass
class FramesConfig:
    """cup=frames"""

    _target_: str = MISSING
    _partial_: bool = True
    panels: Any = field(default=MISSING, metadata=PANELS)
    terms: int = limited(1, 40)
    stations: int = limited(9, 2001)
    basis: str = one_of("cosine", "fourier", "chebyshev")
    tolerance: float = limited(0)


@dataclass
class StripsConfig:
    """cup=strips"""

    _target_: str = MISSING
    _partial_: bool = True
    panels: Any = field(default=MISSING, metadata=PANELS)
    terms: int = limited(1, 40)
    stations: int = limited(9, 2001)
    nodes: int = limited(8, 1000)
    output_nodes: int = limited(8, 1000)
    tolerance: float = limited(0)


@dataclass
class StageConfig:
    """One of solver.stages"""

    optimiser: str = one_of("adam", "lbfgs")
    steps: int = limited(0)
    penalty: float = limited(0)
    rate: float = 0.03
    damping: float = field(default=1e-7, metadata={"least": 0})
    points: int | None = field(default=None, metadata={"least": 0})
    keep: int | None = field(default=None, metadata={"least": 1})


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
    waves: float = field(default=1.0, metadata={"least": 0})
    margin_width: float = field(default=0.0, metadata={"least": 0})
    seam: float = field(default=1.0, metadata={"least": 0})
    leading: bool = False


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
    points: Any = field(default=MISSING, metadata={"choices": ("l2", "l1", "robust")})
    points_width: float = limited(0)
    neckline: float = limited(0)
    neckline_limit: float | None = limited(0)
    neckline_wave: float = limited(0)
    rim: float = limited(0)
    connection: float = limited(0)
    connection_width: float = limited(0)
    seam: str = one_of("closest", "apex")
    ridge_apex: float = limited(0)
    margin: float = MISSING
    margin_width: float = limited(0)
    barrier: float = limited(0)
    fairness: float = limited(0)
    extra: list[Any] = field(default_factory=list)


@dataclass
class ScanConfig:
    """scan=default"""

    points: int | None = limited(10)
    outliers: float | None = field(default=MISSING, metadata={"above": 0})
    neighbours: int = limited(2, 1000)
    side: str | None = one_of("left", "right", "both")
    units: str | None = one_of("mm", "cm", "in", "m")
    wire: str | None = MISSING
    propose: bool = MISSING
    symmetry: bool = MISSING
    bridge: bool = MISSING
    read_seconds: float = limited(1)
    mesh_points: int = limited(1000, 20_000_000)
    readers: list[Any] = field(default_factory=list)


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
class ClothConfig:
    """pattern.cloth"""

    thickness: float = limited(0, 30)
    stretch: float = limited(0, 200)
    stretch_across: float = limited(0, 200)


@dataclass
class WireConfig:
    """pattern.wire"""

    casing: float = limited(0, 100)
    play: float = limited(0, 50)
    spring: float = limited(0, 100)


@dataclass
class PatternConfig:
    """pattern=default"""

    _target_: str = MISSING
    _convert_: str = MISSING
    formats: list[Any] = field(default_factory=list)
    meshes: list[Any] = field(default_factory=list)
    report: bool = MISSING
    allowance: AllowanceConfig = field(default_factory=AllowanceConfig)
    ease: EaseConfig = field(default_factory=EaseConfig)
    cloth: ClothConfig = field(default_factory=ClothConfig)
    notches: int = limited(0, 20)
    notch_depth: float = limited(0, 20)
    notch_form: str = one_of("slit", "v", "t")
    notch_width: float = limited(0, 20)
    grain: float = limited(-360, 360)
    arrow: str = one_of("grain", "stretch")
    wire: WireConfig = field(default_factory=WireConfig)
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
    formats: list[Any] = field(default_factory=list)


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


def is_setting(key: str) -> bool:
    """Whether a name can only be that of a setting: it has a dot, or is a group's or a plain setting's."""
    return "." in key or key in {item.name for item in fields(Config)}
