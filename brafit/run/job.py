"""A run's parts, as its conductor and its workers pass them on. Imports nothing that takes time."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brafit.run.recipe import Recipe
    from brafit.run.sinks import Sink

Row = dict[str, Any]
"""One scan's line of summary.csv, see `brafit.report.table.SUMMARY_KEYS`."""

KEEP, REDO = "keep", "redo"
PRELOAD = ("brafit.run.imports",)
"""Imported once, before workers are made of it."""


class Doing(Enum):
    """What is done to a scan, in words."""

    READING = "reading it"
    PREPARING = "preparing it"
    FITTING = "fitting it"
    WRITING = "writing its results"


@dataclass(frozen=True)
class Job:
    """What to fit, how, and where the results go.

    Attributes:
        scans, side, manifest, shard: what `brafit.run.dataset.dataset` takes.
        out: folder of the results.
        recipe: makes, in a worker, what loads, fits and finishes scans. It is sent there, so it must pickle.
        sinks: what becomes of rows, steps and pictures besides the scans' own folders.
        batch: scans fitted at once, at most.
        workers: processes that share the work.
        one_fit: only one batch is fitted at a time (for a GPU).
        read_patience: seconds that reading a file may take, and then preparing what it holds.
        patience: seconds that finishing a scan may take, and that a fit may be silent.
        resume: `keep`: scans whose results are there, from the same files and settings, are kept; `redo`: none are.
    """

    out: Path
    recipe: Callable[[], Recipe]
    scans: Sequence[str | Path] = ("samples",)
    side: str | None = None
    manifest: str | None = None
    shard: str | None = None
    sinks: Sequence[Sink] = ()
    batch: int = 56
    workers: int = 1
    one_fit: bool = False
    read_patience: float = 120.0
    patience: float = 300.0
    resume: str = KEEP


@dataclass(frozen=True)
class Done:
    """How one scan ended.

    Attributes:
        position, name: its place in the whole dataset, and its name.
        row: its line of the table.
        warnings: of fit and pattern, in words.
        notes: what was found out about the scan, in words.
        cause: of a failure, without the names and numbers of this one scan, to count by.
        file: that the reason of a failure begins with, if it does.
        kept: it was finished before.
        trace: of an error that nobody expected.
        pictures: PNG files by what they show, if they were asked for.
        mesh: vertices, colours and faces of the 3D view, if it was asked for.
    """

    position: int
    name: str
    row: Row
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    cause: str = ""
    file: str = ""
    kept: bool = False
    trace: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    mesh: tuple | None = None

    @property
    def ok(self) -> bool:
        return self.row["status"] == "ok"


def common_cause(cause: str) -> str:
    """A failure's cause without what is of one scan alone: numbers and what is quoted, so that alike ones count
    together.
    """
    text = re.sub(r"'[^']*'", "'...'", " ".join(cause.split()))
    return re.sub(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?", "N", text).rstrip(". ")[:160]


@dataclass(frozen=True)
class Overview:
    """What sinks know of the run when it begins.

    Attributes:
        out: folder of the results.
        names: of all scans, in order.
        positions: their places in the whole dataset.
        shard: `K/N` or None.
        resumed: results of the same run were there.
        watched: names of the scans of which sinks want every step and pictures.
    """

    out: Path
    names: tuple[str, ...]
    positions: tuple[int, ...]
    shard: str | None = None
    resumed: bool = False
    watched: tuple[str, ...] = ()
