"""Fits as their folders keep them, and the cups and patterns that these make again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from brafit.cup import Cup, Wire
from brafit.cup.shape import CupShape
from brafit.errors import BrafitError, InputError
from brafit.geometry.development import FlatPanel
from brafit.naming import on_disk
from brafit.pattern import Pattern, PatternOptions, finish, marks_on, pieces_from_panels
from brafit.remarks import Remark, on_paper
from brafit.run.recipe import AUTO, maker_of
from brafit.run.store import read_fit, without_scans
from brafit.settings.entries import made
from brafit.sizing.surface import ACROSS, ALONG, corresponding

STATIONS = 65
"""Stations along the wire at which cups are compared."""
BATCH = 128
"""Cups that are made again at once."""
_AGAIN = "Fit the scan anew: the same command with resume=redo"


@dataclass(frozen=True, eq=False)
class StoredFit:
    """A good fit, as its fit.json has it.

    Attributes:
        folder: of the scan.
        name: of the scan.
        side: the wearer's breast; right cups are mirrored in their cup frame, so that all cups look like left ones.
        flat: the cup's parameters, solver units.
        series, scale: the wire's Chebyshev series in solver units, and mm to one of these.
        settings: of the cup and of the patterns, as JSON.
        figures: the numbers of the scan's row.
        wire_name: the nearest wire sold; empty where none is known.
        marks: `bust_point` and `strap_point` in the cup frame, mm, as far as they are known.
        dimensions: part, name, value, unit, standard deviation.
        warnings: of the scan and of the fit, and what was guessed of its marks.
    """

    folder: Path
    name: str
    side: str
    flat: Float[ndarray, " size"]
    series: Float[ndarray, "terms 3"]
    scale: float
    settings: str
    figures: Mapping[str, float]
    wire_name: str = ""
    marks: Mapping[str, Float[ndarray, "3"]] = field(default_factory=dict)
    dimensions: Sequence[Sequence[Any]] = ()
    warnings: Sequence[Remark] = ()

    @property
    def wire_length(self) -> float:
        """mm."""
        return float(np.pi * self.scale)


def fit_folders(results: Iterable[str | Path]) -> list[Path]:
    """The folders of scans that paths name: folders of runs, or of scans themselves, each once.

    Raises:
        InputError: a path is no folder, or there is no fit.json in it.
    """
    found: dict[Path, None] = {}
    for path in map(on_disk, results):
        if not path.is_dir():
            raise InputError(path, "there is no such folder", "Name the folder of a run, or of a scan in it")
        own = [path] if (path / "fit.json").exists() else sorted(file.parent for file in path.glob("*/fit.json"))
        if not own:
            raise without_scans(path)
        found |= dict.fromkeys(folder.resolve() for folder in own)
    return list(found)


def stored_fit(folder: Path) -> StoredFit | None:
    """The fit of a scan's folder; None if the scan failed.

    Raises:
        InputError: its fit.json cannot be read, or lacks what the cup is made of.
    """
    file = folder / "fit.json"
    content = read_fit(folder)
    if content is None:
        raise InputError(file, "it cannot be read as the result of a scan", _AGAIN)
    if content.get("status") != "ok":
        return None
    if "wire" not in content:
        raise InputError(file, "it holds no wire: an earlier brafit wrote it", _AGAIN)
    if not {"cup", "pattern"} <= set(content.get("settings") or ()):
        raise InputError(file, "it does not say with which settings the cup was made", _AGAIN)
    try:
        return _read(folder, content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(file, f"its cup cannot be made again ({type(error).__name__}: {error})", _AGAIN) from error


def _read(folder: Path, content: Mapping[str, Any]) -> StoredFit:
    parameters = [np.asarray(value, float).ravel() for value in content["parameters"].values()]
    wire, settings, given = content["wire"], content["settings"], content.get("landmarks", {})
    places = {"bust_point": given.get("bust_point", given.get("apex")), "strap_point": given.get("strap_point")}
    marks = {key: np.asarray(place, float) for key, place in places.items() if place is not None}
    own = {"cup": _own_panels(settings["cup"], content), "pattern": settings["pattern"]}
    stored = StoredFit(
        folder=folder,
        name=str(content["scan"]),
        side=str(content["side"]),
        flat=np.concatenate(parameters),
        series=np.asarray(wire["series"], float).reshape(-1, 3),
        scale=float(wire["mm_per_unit"]),
        settings=json.dumps(own, sort_keys=True),
        figures={key: float(v) for key, v in content.items() if isinstance(v, int | float) and not isinstance(v, bool)},
        wire_name=str(content.get("nearest_wire") or ""),
        marks=marks,
        dimensions=content.get("pattern", {}).get("dimensions", ()),
        warnings=_warnings(content),
    )
    if not (np.isfinite(stored.flat).all() and np.isfinite(stored.series).all() and stored.scale > 0):
        raise ValueError("numbers are missing")
    return stored


def _warnings(content: Mapping[str, Any]) -> tuple[Remark, ...]:
    """Those of a fit, each with its remedy and what it is about in its text."""
    codes, words = (map(str, content.get(key, ())) for key in ("warning_codes", "warnings"))
    return on_paper(map(Remark, codes, words), content)


def _own_panels(cup: dict[str, Any], content: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of `cup` with the number of panels that the scan got, where `cup.panels=auto` left it open."""
    return cup | {"panels": len(content["parameters"]["angle"])} if cup.get("panels") == AUTO else cup


def read_fits(
    folders: Iterable[Path], refused: Callable[[BrafitError], None], tell: Callable[[], object] | None = None
) -> tuple[list[StoredFit], int]:
    """The good fits of folders, and how many scans had failed.

    Args:
        folders: of scans.
        refused: told of each that cannot be used; the others go on.
        tell: called after each.
    """
    fits, failed, known = [], 0, {}
    for folder in folders:
        try:
            fit = stored_fit(folder)
        except BrafitError as error:
            refused(error)
        else:
            failed += fit is None
            if fit is not None:  # one copy of settings that thousands share
                fits.append(replace(fit, settings=known.setdefault(fit.settings, fit.settings)))
        if tell is not None:
            tell()
    return fits, failed


@cache
def _made(settings: str) -> tuple[Callable[..., Cup], PatternOptions]:
    """The maker of cups and the options of patterns that settings describe.

    Raises:
        ConfigError: they need what is not here, such as a module from outside of brafit.
    """
    groups = json.loads(settings)
    return maker_of(groups["cup"]), made(groups["pattern"], "pattern")


def options_of(fit: StoredFit) -> PatternOptions:
    """How the patterns of a fit were finished."""
    return _made(fit.settings)[1]


def _cup(fits: Sequence[StoredFit], **more: Any) -> Cup:
    """The cups of fits that share their settings."""
    terms = max(len(fit.series) for fit in fits)
    series = np.stack([np.pad(fit.series, ((0, terms - len(fit.series)), (0, 0))) for fit in fits])
    scale = torch.tensor([fit.scale for fit in fits], dtype=torch.float64)
    return _made(fits[0].settings)[0](Wire(torch.from_numpy(series), scale, torch.zeros_like(scale)), **more)


def _shapes(fits: Sequence[StoredFit], **more: Any) -> CupShape:
    cup = _cup(fits, **more)
    if any(len(fit.flat) != cup.size for fit in fits):
        raise ValueError(f"its parameters are not the {cup.size} of the cup model of its settings")
    with torch.no_grad():
        flat = torch.from_numpy(np.stack([fit.flat for fit in fits]))
        return cup.shape_of(flat).scaled(cup.wire.scale)


def shape_of(fit: StoredFit) -> CupShape:
    """The cup of a fit as its patterns were made of, cup frame, mm, no batch dimension.

    Raises:
        InputError: the settings that the fit was made with do not make its cup.
    """
    try:
        return _shapes([fit]).map(lambda tensor: tensor[0])
    except (BrafitError, ValueError, RuntimeError) as error:
        raise _not_again(fit, str(error)) from error


def surfaces_of(
    fits: Sequence[StoredFit], refused: Callable[[BrafitError], None], tell: Callable[[int], object] | None = None
) -> tuple[list[StoredFit], Float[ndarray, "kept along across 3"]]:
    """The fits whose cups can be made again, and these as `brafit.sizing.surface.corresponding` has them, mm.

    Args:
        fits: of any models; neighbours of the same settings are made together.
        refused: told of each that cannot be made again; the others go on.
        tell: called with the number of fits that have just been done.
    """
    kept: list[StoredFit] = []
    found = [np.zeros((0, ALONG, ACROSS, 3))]
    for _, same in groupby(fits, key=lambda fit: (fit.settings, len(fit.flat))):
        own = list(same)
        for k in range(0, len(own), BATCH):
            batch = own[k : k + BATCH]
            try:
                points = corresponding(_shapes(batch, stations=STATIONS).edges.numpy())
                causes = ["" if np.isfinite(one).all() else "its numbers make no cup" for one in points]
            except (BrafitError, ValueError, RuntimeError, TypeError) as error:
                points, causes = found[0], [str(error)] * len(batch)
            for fit, cause in zip(batch, causes, strict=True):
                if cause:
                    refused(_not_again(fit, cause))
            good = [not cause for cause in causes]
            kept += [fit for fit, fine in zip(batch, good, strict=True) if fine]
            found.append(points[good] if len(points) else points)
            if tell is not None:
                tell(len(batch))
    return kept, np.concatenate(found)


def _not_again(fit: StoredFit, cause: str) -> InputError:
    return InputError(fit.folder / "fit.json", f"its cup cannot be made again ({cause})", _AGAIN)


def pattern_of(fit: StoredFit, name: str, pair: bool = False, size: str = "", units: str | None = None) -> Pattern:
    """The finished pattern of a fit, drawn for the left breast, by the settings that it was made with.

    Args:
        fit: the fit.
        name: of the pattern, on labels and in files.
        pair: whether the mirrored pieces, for the other breast, are drawn as well.
        size: that it is called on labels, if it is one.
        units: that it is labelled in, of `brafit.pattern.options.UNITS`; None: those of the fit's settings.

    Raises:
        InputError: the settings that the fit was made with do not make its cup.
    """
    shape = shape_of(fit)
    flat = shape.flat()
    panels = [FlatPanel(*edges) for edges in zip(flat.lower, flat.upper, strict=True)]
    marks = marks_on(shape, fit.marks.get("bust_point"), fit.marks.get("strap_point"))
    pieces = pieces_from_panels(panels, "left", marks)
    own = options_of(fit)
    options = replace(own, size=size, pair=pair, units=units or own.units)
    told = fit.warnings
    return finish(pieces, options, name=name, side="left", figures=dict(fit.figures), fit_warnings=told)
