"""From scans to results: load, fit in batches, write. Knows no command line; `brafit.app` makes its `Job`.

Of a scan nothing but its row is kept once its batch is written, so memory is bounded by a batch, not by the dataset.
"""

from __future__ import annotations

import math
import platform
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from brafit import __version__
from brafit.errors import InputError
from brafit.fit import CupFit, ResultCode, Step, Target, fit_targets
from brafit.fit.shards import prepare
from brafit.pattern import Pattern, PatternOptions, Side
from brafit.report.page import write_index
from brafit.report.table import format_table, write_fit_json, write_summary
from brafit.report.tensorboard import Recorder
from brafit.result import FILES, Result, write_patterns
from brafit.scan import Scan, find_scans, load_scan, passed_over, point_weights, scan_names, uncovered_share

Row = dict[str, Any]
"""One scan's line of summary.csv, see `brafit.report.table.SUMMARY_KEYS`."""

_TABLE_ROWS = 60


@dataclass(frozen=True)
class Job:
    """What to fit, how, and where the results go.

    Attributes:
        scans: files, folders, glob patterns or `samples`, see `brafit.scan.find_scans`.
        out: folder of the results.
        cup: makes the cup, such as a partial of `brafit.cup.FramesCup`.
        solver, condition: what `brafit.fit.fit_targets` takes.
        pattern: how patterns are finished and which files are written.
        names: what the rows call the cup model (`cup`) and the solver (`solver`).
        scan: keyword arguments of `brafit.scan.load_scan`.
        restarts: starts per scan.
        batch: scans fitted at once.
        device, dtype: where and how precisely the fit computes.
        threads: processor cores that share the scans of a batch; None: all that PyTorch would use.
        settings: anything that says how to repeat the run; goes into every fit.json.
    """

    scans: Sequence[str | Path]
    out: Path
    cup: Callable[..., Any]
    solver: Any
    condition: Any
    pattern: PatternOptions = field(default_factory=PatternOptions)
    names: Mapping[str, Any] = field(default_factory=dict)
    scan: Mapping[str, Any] = field(default_factory=dict)
    restarts: int = 1
    batch: int = 16
    device: str = "cpu"
    dtype: torch.dtype = torch.float64
    threads: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def fit(self, targets: Sequence[Target], callback: Callable[[Step], None] | None = None) -> list[CupFit]:
        """`brafit.fit.fit_targets` as the job wants it."""
        return fit_targets(
            targets,
            self.cup,
            self.solver,
            self.condition,
            restarts=self.restarts,
            dtype=self.dtype,
            device=self.device,
            threads=self.threads or torch.get_num_threads(),
            callback=callback,
        )


def run(job: Job, say: Callable[[str], None] | None = None) -> list[Row]:
    """Fit all scans of a job; the results of a batch are written before the next begins.

    A scan that cannot be read or fitted becomes a row of status `failed` with its reason, and the others go on; what
    nobody expected goes to `errors.log` with its traceback.

    Args:
        say: takes the closing table and where the results are, as a text of several lines; None: nothing is said.

    Returns:
        a row for each scan, in the order of `find_scans`.

    Raises:
        InputError: no scan was found.
        BrafitError: nothing can run (a setting out of its range, Open3D missing).
    """
    paths = find_scans(job.scans)
    for line in passed_over(job.scans):
        tqdm.write(f"note: {line}", file=sys.stderr)
    scans = _by_side(list(zip(scan_names(paths), paths, strict=True)), job.scan.get("side"))
    if torch.device(job.device).type == "cpu":
        prepare(min(len(scans), job.batch), job.threads or torch.get_num_threads())
    batches = [scans[i : i + job.batch] for i in range(0, len(scans), job.batch)]
    rows: list[Row] = []
    nest: list[Pattern] = []
    for number, batch in enumerate(batches, start=1):
        several = len(batches) > 1
        title = f"batch {number}/{len(batches)}" if several else "fit"
        events = job.out / "tensorboard" / (f"batch_{number:04d}" if several else "")
        rows += _run_batch(job, batch, title, events, nest)
        write_summary(job.out / "summary.csv", rows)
        if job.pattern.report:
            write_index(job.out / "index.html", rows)
    if nest:
        write_patterns(job.out, nest, job.out.name, f"{len(nest)} scans", job.pattern.formats)
    if say is not None:
        say(_closing(job, rows))
    return rows


def _by_side(scans: Sequence[tuple[str, Path]], side: str | None) -> list[tuple[str, Path, str | None]]:
    """Name, file and side of what is fitted: for `both` each scan twice."""
    if side != "both":
        return [(name, path, side) for name, path in scans]
    return [(f"{name}_{which}", path, which) for name, path in scans for which in ("left", "right")]


def _run_batch(
    job: Job, batch: Sequence[tuple[str, Path, str | None]], title: str, events: Path, nest: list[Pattern]
) -> list[Row]:
    rows: dict[str, Row] = {}
    loaded: list[Scan] = []
    for name, path, side in batch:
        try:
            loaded.append(load_scan(path, name=name, **{**job.scan, "side": side}))
            for note in loaded[-1].notes:
                tqdm.write(f"note: {note}", file=sys.stderr)
        except InputError as error:
            rows[name] = _failed(job, name, str(error))
            tqdm.write(f"failed: {error}", file=sys.stderr)
    if loaded:
        rows |= _fit_batch(job, loaded, title, events, nest)
    for name, path, _ in batch:
        if rows[name]["status"] == "failed":
            _write_failure(job, rows[name], path)
    return [rows[name] for name, _, _ in batch]


def _fit_batch(job: Job, scans: Sequence[Scan], title: str, events: Path, nest: list[Pattern]) -> dict[str, Row]:
    for stale in events.glob("events.out.tfevents.*"):  # TensorBoard would draw both runs as one
        stale.unlink()
    with Recorder(events) as recorder:
        try:
            fits = _fit(job, scans, title, recorder)
        except Exception as error:
            reason = _unexpected(job, error, "the fit of its batch")
            return {scan.name: _failed(job, scan.name, reason, scan) for scan in scans}
        return {scan.name: _finish(job, scan, fit, recorder, nest) for scan, fit in zip(scans, fits, strict=True)}


def _fit(job: Job, scans: Sequence[Scan], title: str, recorder: Recorder) -> list[CupFit]:
    last = 0
    with _progress(title) as show:

        def callback(step: Step) -> None:
            nonlocal last
            last = step.total
            show(step)
            recorder.step(step)

        fits = job.fit([_bridged(scan) for scan in scans], callback)
    fits = [_of_data(fit, len(scan.points)) for scan, fit in zip(scans, fits, strict=True)]
    figures = {key: torch.tensor([_number(fit.figures[key]) for fit in fits]) for key in fits[0].figures}
    recorder.step(Step("result", last, last, figures))
    return fits


def _finish(job: Job, scan: Scan, fit: CupFit, recorder: Recorder, nest: list[Pattern]) -> Row:
    """The row of a fit; its files and pictures are written if it is ok, and its pattern kept if a nest is asked for."""
    row = _row(job, scan, fit)
    if row["status"] == "ok":
        try:
            result = _result(job, scan, fit, row)
            extra = _scan_facts(scan, fit)
            result.save(job.out / scan.name, extra | _provenance(job, scan.path))
            for warning in (*fit.warnings, *result.patterns().warnings):
                tqdm.write(f"warning: {scan.name}: {warning}", file=sys.stderr)
            recorder.images(scan.name, result.pictures())
            recorder.mesh(scan.name, *result.mesh_view())
            nest += [result.patterns()] * job.pattern.nest
        except Exception as error:
            row |= {"status": "failed", "reason": _unexpected(job, error, "writing its results")}
    return row


def _row(job: Job, scan: Scan, fit: CupFit) -> Row:
    row = {
        **_failed(job, scan.name, fit.reason, scan),
        **{key: _number(value) for key, value in fit.figures.items()},
        "iterations": fit.iterations,
        "seconds": fit.seconds,
    }
    # Without a neckline there is no distance from it, and no deviation is known of cups with constraints.
    absent = {"outline_sd_mm"} | (set() if scan.neckline is not None else {"upper_edge_mm", "neckline_smoothing_mm"})
    needed = {key: value for key, value in fit.figures.items() if key not in absent}
    missing = [key for key, value in needed.items() if not math.isfinite(_number(value))]
    if fit.code in (ResultCode.DIVERGED, ResultCode.UNRESOLVED):
        return row
    if missing:
        return row | {"reason": f"{fit.reason}, but not finite: {', '.join(missing)}"}
    return row | {"status": "ok"}


def _failed(job: Job, name: str, reason: str, scan: Scan | None = None) -> Row:
    """The row of a scan that has no fit yet."""
    row: Row = {
        "scan": name,
        "status": "failed",
        "reason": reason,
        "cup": job.names.get("cup"),
        "solver": job.names.get("solver"),
        "panels": _setting(job, "cup", "panels"),
        "terms": _setting(job, "cup", "terms"),
    }
    return row if scan is None else row | {"side": scan.side, "points": len(scan.points)}


def _setting(job: Job, group: str, key: str) -> Any:
    values = job.settings.get(group)
    return values.get(key) if isinstance(values, Mapping) else None


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _target(scan: Scan) -> Target:
    return Target(
        name=scan.name,
        points=scan.points,
        weights=point_weights(scan.points, scan.curve),
        wire=scan.wire,
        neckline=scan.neckline,
        strap_point=scan.strap_point,
        apex=scan.apex,
    )


def _bridged(scan: Scan) -> Target:
    """The target of the fit: with the places that are assumed where the scan has no data."""
    target = _target(scan)
    if not len(scan.assumed):
        return target
    points = np.concatenate([scan.points, scan.assumed])
    return replace(target, points=points, weights=point_weights(points, scan.curve))


def _of_data(fit: CupFit, count: int) -> CupFit:
    """The fit with the figures of its first points only: those that the scan has."""
    if len(fit.distances) == count:
        return fit
    distances = fit.distances[:count]
    size = np.abs(distances)
    figures = {
        "rms_mm": float(np.sqrt(np.mean(size**2))),
        "mean_mm": float(size.mean()),
        "p95_mm": float(np.quantile(size, 0.95)),
        "max_mm": float(size.max()),
    }
    return replace(fit, distances=distances, figures=fit.figures | figures)


def _side(scan: Scan) -> Side:
    return "right" if scan.side == "right" else "left"


def _result(job: Job, scan: Scan, fit: CupFit, row: Row) -> Result:
    sources = {
        "points": f"{scan.path.name}, {len(scan.points)} used",
        "wire": f"{scan.origin.wire} ({len(scan.wire)} points)",
        "side": f"{scan.origin.marks} ({scan.side})",
        "neckline": "none: only the points say where the cup ends" if scan.neckline is None else scan.origin.neckline,
        "strap point": "none" if scan.strap_point is None else scan.origin.marks,
        "apex": "not given: the cup's point farthest from the chest" if scan.apex is None else scan.origin.marks,
    }
    details = {key: row.get(key) for key in ("reason", "cup", "solver", "panels", "terms")}
    return Result(fit, _target(scan), _side(scan), scan.frame, job.pattern, sources, details)


def _scan_facts(scan: Scan, fit: CupFit) -> dict[str, Any]:
    """What became of the scan before the fit, and how much of the cup has no data."""
    return {
        "cleaning": asdict(scan.cleaning),
        "units": asdict(scan.units),
        "origin": asdict(scan.origin),
        "notes": list(scan.notes),
        "uncovered_share": uncovered_share(fit.shape, scan.dense),
        "assumed_points": len(scan.assumed),
        "landmarks": _landmarks(scan),
    }


def _landmarks(scan: Scan) -> dict[str, Any]:
    return {
        "wire_points": len(scan.wire),
        "neckline_points": 0 if scan.neckline is None else len(scan.neckline),
        "strap_point": scan.strap_point,
        "apex": scan.apex,
    }


def _write_failure(job: Job, row: Row, path: Path) -> None:
    """fit.json of a failed scan; results of an earlier run in the same folder must not pass for its own."""
    folder = job.out / row["scan"]
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    write_fit_json(folder / "fit.json", row, _provenance(job, path))


def _provenance(job: Job, path: Path) -> dict[str, Any]:
    versions = {"brafit": __version__, "torch": torch.__version__, "python": platform.python_version()}
    return {"file": path.absolute(), "settings": job.settings, "versions": versions}


def _unexpected(job: Job, error: Exception, during: str) -> str:
    """The reason for a row; the traceback goes to errors.log, the line to the terminal."""
    what = " ".join(str(error).split())
    reason = f"unexpected {type(error).__name__} in {during}: {what[:200]} (see errors.log)"
    job.out.mkdir(parents=True, exist_ok=True)
    with (job.out / "errors.log").open("a", encoding="utf-8") as log:
        log.write(f"{reason}\n{''.join(traceback.format_exception(error))}\n")
    tqdm.write(f"failed: {reason}", file=sys.stderr)
    return reason


@contextmanager
def _progress(title: str) -> Iterator[Callable[[Step], None]]:
    """A bar on the terminal, a line now and then in a log; gives the callback that moves it."""
    watched = sys.stderr.isatty()
    with tqdm(
        desc=title,
        mininterval=0.2 if watched else 30.0,
        dynamic_ncols=True,
        unit="step",
        leave=not watched,  # a log's line is to be ended
        delay=1,
    ) as bar:

        def callback(step: Step) -> None:
            bar.total = step.total
            bar.set_description_str(f"{title}, {step.stage}", refresh=False)
            bar.set_postfix_str(f"median objective {float(step.terms['objective'].median()):.3g}", refresh=False)
            bar.update(step.index - bar.n)

        yield callback


def _closing(job: Job, rows: Sequence[Row]) -> str:
    failed = [row for row in rows if row["status"] != "ok"]
    shown = list(rows) if len(rows) <= _TABLE_ROWS else failed[:_TABLE_ROWS]
    counts = f"{len(rows) - len(failed)} of {len(rows)} scans ok"
    return f"{format_table(shown)}\n\n{counts}. Results: {job.out}"
