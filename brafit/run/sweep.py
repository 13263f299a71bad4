"""Sweeps: the jobs are checked before the first of them runs, their folders named, and their tables made one."""

from __future__ import annotations

import csv
import itertools
import json
import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import quote

from brafit.atomic import write_text
from brafit.errors import BrafitError, ConfigError
from brafit.report.html import asset, figure, fixed, head, page
from brafit.report.table import SUMMARY_KEYS, write_parquet, write_table
from brafit.run.dataset import dataset
from brafit.run.recipe import Recipe

CHECKED = 100
"""Jobs up to which every combination is checked; of more, each value with the first of the others."""

MEDIANS = ("rms_mm", "p95_mm", "upper_edge_mm", "seam_to_apex_mm", "outline_sd_mm", "tightest_radius_mm", "seconds")
"""Figures by which the page compares jobs."""


@dataclass(frozen=True)
class SweepJob:
    """One finished job of a sweep: its folder's name, its own overrides by key, and its exit status."""

    folder: str
    overrides: Mapping[str, str]
    status: int


def parted(arguments: Sequence[str]) -> tuple[dict[str, list[str]], dict[str, str]]:
    """The swept settings with the values of each, and the others. A sweep over an interval has no list of values.

    Raises:
        ConfigError: `glob(...)` of a setting that has no choices.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.core.override_parser.types import ValueType

    swept: dict[str, list[str]] = {}
    fixed: dict[str, str] = {}
    for override in OverridesParser.create().parse_overrides(list(arguments)):
        key = override.get_key_element()
        swept.pop(key, None)  # the last one counts
        fixed.pop(key, None)
        if not override.is_sweep_override():
            fixed[key] = override.get_value_element_as_str()
        elif override.value_type == ValueType.GLOB_CHOICE_SWEEP:
            swept[key] = _choices(key, override.value())
        elif override.is_discrete_sweep():
            swept[key] = [str(value) for value in override.sweep_string_iterator()]
        else:
            swept[key] = []
    return swept, fixed


def _choices(group: str, named: Any) -> list[str]:
    """The choices of a group that a `glob(...)` names.

    Raises:
        ConfigError: it is no group, or it has none of these.
    """
    folder = resources.files("brafit.conf").joinpath(group)
    files = [file.name for file in folder.iterdir()] if folder.is_dir() else []
    names = sorted(file.removesuffix(".yaml") for file in files if file.endswith(".yaml"))
    found = list(named.filter(names))
    if not found:
        allowed = f"; {group} has {', '.join(names)}" if names else f"; name the values: {group}=VALUE,VALUE"
        raise ConfigError(f"{group}=glob(...): it names choices of groups such as cup, and here none{allowed}")
    return found


def combinations(swept: Mapping[str, Sequence[str]], fixed: Mapping[str, str]) -> Iterable[list[str]]:
    """The settings of the jobs that are worth checking."""
    known = {key: values for key, values in swept.items() if values}
    constant = [f"{key}={value}" for key, value in fixed.items()]
    if math.prod(len(values) for values in known.values()) <= CHECKED:
        chosen: Iterable[Sequence[str]] = itertools.product(*known.values())
    else:
        first = [values[0] for values in known.values()]
        chosen = [[*first[:k], v, *first[k + 1 :]] for k, values in enumerate(known.values()) for v in values]
    for values in chosen:
        yield constant + [f"{key}={value}" for key, value in zip(known, values, strict=True)]


def check_scans(recipes: Iterable[Recipe]) -> None:
    """Refuse a sweep of which no job finds a scan. Where one does, that another finds none is that job's failure.

    Args:
        recipes: of the jobs.

    Raises:
        BrafitError: why the first of them finds none.
    """
    errors = [_no_scans(*sought) for sought in dict.fromkeys(map(_sought, recipes))]
    if errors and all(errors) and errors[0] is not None:
        raise errors[0]


def _sought(recipe: Recipe) -> tuple[Any, ...]:
    """What `brafit.run.dataset.dataset` is told by a job."""
    settings = recipe.settings
    ends = frozenset(end for reader in recipe.scan["readers"] for end in reader.suffixes)
    table = settings["dataset"]
    propose = bool(recipe.scan["propose"])
    return tuple(settings["scans"]), settings["scan"]["side"], table["manifest"], table["shard"], propose, ends


def _no_scans(*sought: Any) -> BrafitError | None:
    try:
        dataset(*sought)
    except BrafitError as error:
        return error
    return None


def gather(folder: Path, jobs: Sequence[SweepJob]) -> None:
    """Write sweep.csv and sweep.parquet (all rows of all jobs, `best` marks each scan's lowest RMS), index.html, and
    each job's settings and figures as hyperparameters for TensorBoard.
    """
    tables = [(job, _rows(folder / job.folder)) for job in jobs]
    swept = list(dict.fromkeys(key for job in jobs for key in job.overrides))
    rows = [{"job": job.folder, **job.overrides, **row, "best": ""} for job, table in tables for row in table]
    best: dict[str, dict[str, Any]] = {}
    for row in rows:
        rms = _number(row.get("rms_mm"))
        if row.get("status") == "ok" and rms is not None and rms < (_rms(best.get(row["scan"])) or math.inf):
            best[row["scan"]] = row
    for row in best.values():
        row["best"] = "1"
    keys = ["job", *(key for key in swept if key not in SUMMARY_KEYS), *SUMMARY_KEYS, "best"]
    write_table(folder / "sweep.csv", keys, rows)
    write_parquet(folder / "sweep.parquet", [_typed(row) for row in rows], keys)
    write_text(folder / "index.html", _page(tables, swept, best))
    _hyperparameters(folder / "tensorboard", tables)


def _rows(folder: Path) -> list[dict[str, Any]]:
    """The rows of a job's table, of the whole dataset or of its shard."""
    rows = []
    for path in sorted(folder.glob("summary*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            rows += list(csv.DictReader(file))
    return rows


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def _rms(row: Mapping[str, Any] | None) -> float | None:
    return None if row is None else _number(row.get("rms_mm"))


def _typed(row: Mapping[str, Any]) -> dict[str, Any]:
    """Cells of a CSV as numbers, where their column has numbers."""
    from brafit.report.table import COUNTS, WORDS

    typed: dict[str, Any] = dict(row)
    for key in SUMMARY_KEYS:
        if key not in WORDS:
            number = _number(row.get(key))
            typed[key] = int(number) if number is not None and key in COUNTS else number
    return typed


def _medians(table: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Medians of the figures of a job's good scans."""
    good = [row for row in table if row.get("status") == "ok"]
    found = {}
    for key in MEDIANS:
        values = [number for row in good if (number := _number(row.get(key))) is not None]
        if values:
            found[key] = statistics.median(values)
    return found


def _page(
    tables: Sequence[tuple[SweepJob, list[dict[str, Any]]]], swept: Sequence[str], best: Mapping[str, Mapping[str, Any]]
) -> str:
    figures = list(dict.fromkeys(key for _, table in tables for key in _medians(table)))
    words = ["ok", "failed", "warnings", *map(head, figures)]
    heads = "".join(f"<th>{escape(word)}</th>" for word in ["job", *swept])
    heads += "".join(f'<th class="number">{escape(word)}</th>' for word in words)
    lines = []
    for job, table in tables:
        good, medians = sum(row.get("status") == "ok" for row in table), _medians(table)
        warnings = sum(int(_number(row.get("warning_count")) or 0) for row in table)
        cells = [f'<td><a href="{quote(job.folder)}/index.html">{escape(job.folder)}</a></td>']
        cells += [f"<td>{escape(job.overrides.get(key, ''))}</td>" for key in swept]
        cells += [f'<td class="number" data-value="{n}">{n}</td>' for n in (good, len(table) - good, warnings)]
        for key in figures:
            value = medians.get(key)
            shown = "" if value is None else escape(figure(key, value))
            cells.append(f'<td class="number" data-value="{"" if value is None else repr(value)}">{shown}</td>')
        lines.append(f"<tr>{''.join(cells)}</tr>")
    chosen = "".join(
        f'<tr><td>{escape(scan)}</td><td><a href="{quote(row["job"])}/{quote(scan)}/report.html">{escape(row["job"])}'
        f'</a></td><td class="number" data-value="{row["rms_mm"]}">{escape(fixed(float(row["rms_mm"])))}</td></tr>'
        for scan, row in sorted(best.items())
    )
    return page(
        "sweep",
        f"<h1>Sweep of {len(tables)} jobs</h1><p>Figures are medians of a job's good scans, lengths in mm; warnings "
        "are counted over all of its scans. Click a heading to sort, a job for its scans and their warnings.</p>"
        f'<div class="scroll"><table class="sortable"><thead><tr>{heads}</tr></thead><tbody>{"".join(lines)}</tbody>'
        "</table></div><h2>Best of each scan</h2><p>The job with the lowest RMS distance; with more panels and terms a "
        "cup mostly comes closer, and there is more to sew.</p>"
        '<div class="scroll"><table class="sortable"><thead><tr><th>scan</th><th>job</th>'
        f'<th class="number">RMS</th></tr></thead>'
        f"<tbody>{chosen}</tbody></table></div><script>{asset('table.js')}</script>",
        wide=True,
    )


def _hyperparameters(folder: Path, tables: Sequence[tuple[SweepJob, list[dict[str, Any]]]]) -> None:
    """A small run of each job, with its settings and the medians of its figures, for TensorBoard's HPARAMS."""
    from tensorboard.plugins.hparams.summary_v2 import hparams_pb

    from brafit.report.tensorboard import Recorder

    for job, table in tables:
        values: dict[str, Any] = {}
        for key, text in job.overrides.items():
            number = _number(text)
            values[key] = text if number is None else number
        with Recorder(folder / job.folder) as recorder:
            recorder.summary(hparams_pb(values, trial_id=job.folder))
            for key, value in _medians(table).items():
                recorder.scalar(f"sweep/{key}", value)


def write_status(folder: Path, number: int, job: SweepJob) -> None:
    """Leave a job's end where the process that the user started finds it."""
    content = {"folder": job.folder, "overrides": dict(job.overrides), "status": job.status}
    write_text(folder / f"{number}.json", json.dumps(content))


def read_statuses(folder: Path) -> list[SweepJob]:
    """What `write_status` left, in the jobs' order."""
    files = sorted(folder.glob("*.json"), key=lambda file: int(file.stem))
    return [SweepJob(**json.loads(file.read_text(encoding="utf-8"))) for file in files]
