"""What workers do: find the scans, load, fit and finish them. Each call gets the run's recipe, and tells what it is at.

Scans and fits travel as bytes, which the conductor hands on unread: it needs none of what computes.
"""

from __future__ import annotations

import io
import pickle
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from brafit import __version__
from brafit.atomic import TEMPORARY, write_bytes
from brafit.cloud import read_cloud
from brafit.cloud.open3d_runtime import open3d
from brafit.errors import BrafitError, InputError
from brafit.fitting import CupFit, Step
from brafit.fitting.loop import Winners
from brafit.report.fit_step import FitStep
from brafit.report.row import failed_row, fitted_row
from brafit.report.table import write_fit_json
from brafit.result import result_files
from brafit.run.dataset import ScanRef
from brafit.run.dataset import dataset as dataset_of
from brafit.run.fitting import fitted, measured, result_of, solved, with_surveys
from brafit.run.job import Doing, Done, common_cause
from brafit.run.recipe import READING, Recipe
from brafit.run.store import key_of, nest_file, restored
from brafit.scan import Scan, load_sides

Tell = Callable[[Any], None]
QUANTILES = {"median": 0.5, "p05": 0.05, "p95": 0.95}


@lru_cache(maxsize=16)
def _recipe(source: bytes, overrides: tuple[str, ...] = ()) -> Recipe:
    """The run's recipe, made once in every process, with a scan's own settings."""
    recipe: Recipe = pickle.loads(source)()
    if not overrides:
        return recipe
    from brafit.run.recipe import recipe_from_settings
    from brafit.settings.compose import varied

    settings, names = varied(recipe.settings, recipe.names, overrides)
    return recipe_from_settings(settings, names)


def begin(
    source: bytes, scans: Sequence[str | Path], side: str | None, manifest: str | None, shard: str | None, tell: Tell
) -> tuple[list[ScanRef], list[str], Mapping[str, Any]]:
    """Make the recipe, so that wrong settings are known before anything else, and find the scans. Its settings are
    given back too.

    Args:
        source: the pickled maker of the recipe.
        scans: as `find_scans` takes them.
        side: `left`, `right`, `both`, or None: as the landmark files say.
        manifest: a table of scans in place of `scans`, or None.
        shard: such as `3/16`, or None.
        tell: takes what the worker is at.
    """
    recipe = _recipe(source)
    if recipe.scan.get("points", 1) is not None or recipe.scan.get("outliers", 1) is not None:
        open3d()  # what cannot be imported is to be known before anything else as well
    ends = frozenset(end for reader in recipe.scan.get("readers", ()) for end in reader.suffixes)
    return *dataset_of(scans, side, manifest, shard, bool(recipe.scan.get("propose")), ends), recipe.settings


def load(source: bytes, ref: ScanRef, out: Path, resume: bool, tell: Tell) -> list[Done | bytes]:
    """Each breast of a file: what was kept of it or why it failed, or the scan as bytes.

    Args:
        source: the pickled maker of the recipe.
        ref: the file and the breasts that are wanted of it.
        out: the run's folder.
        resume: take what an earlier run finished.
        tell: takes what the worker is at.
    """
    try:
        recipe = _recipe(source, ref.overrides)
    except BrafitError as error:
        plain = _recipe(source)
        return [_failure(plain, ref, k, str(error), str(error), out) for k in range(len(ref.names))]
    results: list[Done | bytes] = []
    tell(Doing.READING)
    keys = [key_of(ref, side, recipe.settings) for side in ref.sides]
    places = list(zip(ref.names, ref.positions, keys, strict=True))
    kept = [restored(out, *place, recipe.pattern.nest) if resume else None for place in places]
    left = [k for k, done in enumerate(kept) if done is None]
    scans = _loaded(recipe, ref, [ref.sides[k] for k in left], tell) if left else []
    found = dict(zip(left, scans, strict=True))
    for k, done in enumerate(kept):
        scan = found.get(k)
        if isinstance(scan, BrafitError):
            cause, file = (scan.cause, scan.file) if isinstance(scan, InputError) else (str(scan), "")
            results.append(_failure(recipe, ref, k, str(scan), cause, out, file=file))
        elif scan is not None:
            named = replace(scan, name=ref.names[k])
            results.append(pickle.dumps((ref, k, keys[k], named), pickle.HIGHEST_PROTOCOL))
        elif done is not None:
            results.append(done)
    return results


def _loaded(recipe: Recipe, ref: ScanRef, sides: Sequence[str | None], tell: Tell) -> Sequence[Scan | BrafitError]:
    """The breasts of a file, from one reading of it."""
    settings = dict(recipe.scan)
    reading = {key: settings.pop(key) for key in READING if key in settings}
    try:
        limits = {"seconds" if key == "read_seconds" else key: value for key, value in reading.items()}
        cloud = read_cloud(ref.path, **limits, apart=False)  # this process is watched, and may be lost
        tell(Doing.PREPARING)
        return load_sides(cloud, sides, landmarks=ref.landmarks, **settings)
    except BrafitError as error:
        return [error] * len(sides)


def fit(source: bytes, scans: Sequence[bytes], watched: Sequence[str], tell: Tell) -> list[bytes]:
    """The fits of a batch, in its order; all scans of a batch have the same settings of their own. What another device
    solves is measured by whoever finishes the scan: one process measures more slowly than the device solves.

    Args:
        source: the pickled maker of the recipe.
        scans: as `load` gave them.
        watched: names of those whose course is reported one by one.
        tell: takes a `FitStep` after every step.
    """
    loaded = [pickle.loads(data) for data in scans]
    recipe = _recipe(source, loaded[0][0].overrides)
    scans = [scan for *_, scan in loaded]
    names = [scan.name for scan in scans]

    def told(step: Step) -> None:
        tell(_told(step, names, watched))

    if recipe.device != "cpu" and not recipe.compares:
        return [_packed(part) for part in solved(recipe, scans, told)]
    return [_packed(fit) for fit in with_surveys(recipe, scans, fitted(recipe, scans, told))]


class _Packer(pickle.Pickler):
    """Packs of a tensor what is its own: PyTorch's way takes along all that it is a part of, such as a whole batch."""

    def reducer_override(self, thing: Any) -> Any:
        if type(thing) is torch.Tensor and thing.device.type == "cpu" and not thing.requires_grad:
            return torch.from_numpy, (thing.numpy().copy(),)
        return NotImplemented


def _packed(fit: CupFit | Winners) -> bytes:
    file = io.BytesIO()
    _Packer(file, pickle.HIGHEST_PROTOCOL).dump(fit)
    return file.getvalue()


def finish(source: bytes, scan: bytes, fit: bytes, out: Path, drawn: bool, tell: Tell) -> Done:
    """The row of a fit; its files are written if it is ok, and its pictures drawn if they are asked for.

    Args:
        source: the pickled maker of the recipe.
        scan: as `load` gave it.
        fit: as `fit` gave it.
        out: the run's folder.
        drawn: whether its pictures are wanted.
        tell: takes what the worker is at.
    """
    ref, k, key, loaded = pickle.loads(scan)
    recipe, cup = _recipe(source, ref.overrides), pickle.loads(fit)
    if isinstance(cup, Winners):
        cup = measured(recipe, loaded, cup)
    row = fitted_row(cup, loaded.side, len(loaded.points), recipe.model, loaded.neckline is not None)
    if row["status"] != "ok":
        return _failure(recipe, ref, k, row["reason"], cup.code.value, out, row=row)
    for stale in (out / loaded.name).glob(f"{TEMPORARY}*"):  # of a run that was killed
        stale.unlink(missing_ok=True)
    result = result_of(recipe, loaded, cup)
    extra = _provenance(recipe, ref.path)
    if recipe.pattern.nest:  # before fit.json, which says that all is there
        write_bytes(nest_file(out, loaded.name), pickle.dumps(result.patterns()))
    (out / loaded.name).mkdir(parents=True, exist_ok=True)  # its errors are told with the run's folder
    result.save(out / loaded.name, extra | {"position": ref.positions[k], "key": key})
    return Done(
        ref.positions[k],
        loaded.name,
        result.row(),
        tuple(map(str, (*cup.warnings, *result.patterns().warnings))),
        tuple(map(str, (*loaded.notes, *cup.notes))),
        pictures=result.pictures() if drawn else {},
        mesh=result.mesh_view() if drawn else None,
    )


def fail(source: bytes, ref: ScanRef, k: int, cause: str, out: Path, tell: Tell) -> Done:
    """The failure of a breast that could not be told by what failed: its process is gone."""
    return _failure(_recipe(source), ref, k, f"{ref.path}: {cause}", cause, out, file=str(ref.path))


def _failure(
    recipe: Recipe,
    ref: ScanRef,
    k: int,
    reason: str,
    cause: str,
    out: Path,
    *,
    file: str = "",
    row: dict[str, Any] | None = None,
) -> Done:
    """The row of a failure, and its fit.json; results of an earlier run in the folder must not pass for its own."""
    name = ref.names[k]
    row = failed_row(name, reason, recipe.model, ref.sides[k]) if row is None else row
    folder = out / name
    for stale in result_files(folder):
        (folder / stale).unlink(missing_ok=True)
    write_fit_json(folder / "fit.json", row, _provenance(recipe, ref.path) | {"position": ref.positions[k]})
    return Done(ref.positions[k], name, row, cause=common_cause(cause), file=file)


def _provenance(recipe: Recipe, path: Path) -> dict[str, Any]:
    versions = {"brafit": __version__, "torch": torch.__version__, "python": platform.python_version()}
    return {"file": path.absolute(), "settings": recipe.settings, "versions": versions}


def _told(step: Step, names: Sequence[str], watched: Sequence[str]) -> FitStep:
    quantiles = {name: found for name, values in step.terms.items() if (found := _quantiles(values))}
    return FitStep(step.stage, step.index, step.total, quantiles, _of_scans(step, names, watched))


def _quantiles(values: torch.Tensor) -> dict[str, float]:
    """Of the finite values; nothing if there are none."""
    numbers = values.detach().double().cpu().flatten()
    numbers = numbers[numbers.isfinite()].numpy()
    if len(numbers) == 0:
        return {}
    return dict(zip(QUANTILES, np.quantile(numbers, list(QUANTILES.values())).tolist(), strict=True))


def _of_scans(step: Step, names: Sequence[str], watched: Sequence[str]) -> dict[str, dict[str, float]]:
    """Objective and RMS of the watched scans: of each the best of its starts."""
    if not watched or "objective" not in step.terms:
        return {}
    found: dict[str, dict[str, float]] = {}
    shown = {key: step.terms[key].detach().double().cpu() for key in ("objective", "rms_mm") if key in step.terms}
    for row, scan in enumerate(step.scans.tolist()):
        name, values = names[int(scan)], {key: float(value[row]) for key, value in shown.items()}
        if name in watched and (name not in found or values["objective"] < found[name]["objective"]):
            found[name] = values
    return found
