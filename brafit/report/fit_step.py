"""A step of a batch's fit, as plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class FitStep:
    """What a batch's fit tells of a step.

    Attributes:
        stage, index, total: as in `brafit.fitting.Step`.
        quantiles: of each term its median, 5th and 95th percentile over the batch.
        scans: of the scans that are watched, by name, their objective and RMS.
    """

    stage: str
    index: int
    total: int
    quantiles: Mapping[str, Mapping[str, float]]
    scans: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
