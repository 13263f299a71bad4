"""`brafit.fit`: a cup from a scan, a file or arrays, by the same road as the command's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from brafit.errors import ApartError, ConfigError, InputError, OtherUnitError, WrongWayError

if TYPE_CHECKING:
    from brafit.fitting import DifferentiableFit, Target
    from brafit.fitting.implicit import Kind
    from brafit.fitting.solver import Callback
    from brafit.landmarks import Landmarks
    from brafit.result import Result
    from brafit.scan import Scan


def fit(
    points: Scan | str | Path | ArrayLike,
    *,
    wire: ArrayLike | None = None,
    side: str | None = None,
    neckline: ArrayLike | None = None,
    strap_point: ArrayLike | None = None,
    apex: ArrayLike | None = None,
    inside: ArrayLike | None = None,
    name: str | None = None,
    settings: str | Sequence[str] = (),
    callback: Callback | None = None,
) -> Result:
    """Fit a cup to a scan: checked, cleaned, fitted and judged as the command does it, with the same numbers.

    Args:
        points: what to fit: a `Scan` (its points and marks are taken as they are), a cloud's file with its landmark
            file beside it, or the points themselves, (n, 3), in millimetres, in any frame: of one breast or a torso.
        wire: with points: (k, 3) the wire line, inner end first, in their frame; at least 4 distinct points.
        side: the wearer's `left` or `right` breast. With points: `left` if it is not given. With a file: the side that
            its landmark file marks.
        neckline: with points: (m, 3) the wanted upper edge, from end to end of the wire.
        strap_point: with points: (3,) where the strap is sewn on.
        apex: with points: (3,) the bust point.
        inside: with points: (n,) true for those between wire and neckline. Without it the breast is cut out by wire and
            neckline.
        name: for labels and files; that of the scan or the file if it is not given.
        settings: as on the command line: `["cup.panels=3", "pattern.allowance.wire=8"]`. `scan.points=null` and
            `scan.outliers=null` keep all points; `scan.units=in` says that points and marks are in inches. A `Scan` is
            fitted as it was loaded: what begins with `scan.` is for `load_scan` then.
        callback: called with a `Step` after every step of the fit.

    Raises:
        InputError: an input that cannot be used, or whose cup is none: not developable, or no likeness of the points.
        ConfigError: a setting that does not exist or is out of its range.
    """
    from brafit.run.fitting import fitted, result_of
    from brafit.run.recipe import recipe_of
    from brafit.scan import Scan, load_scan

    settings = _listed(settings)
    recipe = recipe_of(settings)
    arrays = {"wire": wire, "neckline": neckline, "strap_point": strap_point, "apex": apex, "inside": inside}
    _check_named(points, name)
    if isinstance(points, Scan | str | Path):
        own = [text.partition("=")[0] for text in settings if text.startswith("scan.")]
        loaded = {"side": side, **dict.fromkeys(own, True)} if isinstance(points, Scan) else {}
        _refuse_beside(points, arrays | loaded)
        scan = points if isinstance(points, Scan) else load_scan(points, side=side, **recipe.scan)
        scan = scan if name is None else replace(scan, name=name)
    else:
        scan = _scan_of(points, arrays, side or "left", name or "cup", recipe.scan)
    (found,) = fitted(recipe, [scan], callback)
    result = result_of(recipe, scan, found)
    row = result.row()
    if row["status"] != "ok":
        raise InputError(scan.name, row["reason"], "Check points and wire: brafit-inspect draws those of a file")
    return result


def layer(
    scans: Scan | str | Path | Sequence[Scan | str | Path], *, settings: str | Sequence[str] = (), matrix: Kind = "full"
) -> tuple[DifferentiableFit, list[Target]]:
    """The fit as a differentiable function, and what it is told of scans.

    ```
    layer, (target,) = brafit.layer(["anny_04.ply"])
    points = torch.from_numpy(target.points).requires_grad_()
    cups = layer([TensorTarget.of(target, points=points)])
    cups.lengths()[0, 1].backward()  # the ridge's length by every point
    ```

    Args:
        scans: `Scan`s, or clouds' files with their landmark files beside them; one or several.
        settings: as on the command line.
        matrix: of the derivatives, see `brafit.fitting.DifferentiableFit`.

    Raises:
        InputError: a file that cannot be used.
        ConfigError: a setting that does not exist or is out of its range.
        ValueError: an unknown matrix.
    """
    from brafit.fitting import DifferentiableFit
    from brafit.run.fitting import target_of
    from brafit.run.recipe import recipe_of
    from brafit.scan import Scan, load_scan
    from brafit.scan.middle import middle_of

    recipe = recipe_of(_listed(settings))
    if recipe.tolerance is not None:
        raise ConfigError("cup.panels=auto: derivatives need a number of panels: cup.panels=3")
    made = DifferentiableFit(recipe.cup, recipe.solver, recipe.condition, recipe.restarts, matrix)
    several = [scans] if isinstance(scans, Scan | str | Path) else scans
    loaded = [scan if isinstance(scan, Scan) else load_scan(scan, **recipe.scan) for scan in several]
    thickness = recipe.pattern.cloth["thickness"]
    return made, [target_of(middle_of(scan, thickness)) for scan in loaded]


def _listed(settings: str | Sequence[str]) -> Sequence[str]:
    listed = [settings] if isinstance(settings, str) else settings
    if not isinstance(listed, Sequence) or not all(isinstance(text, str) for text in listed):
        form = 'must be a list of key=value, such as ["cup.panels=3", "restarts=6"]'
        raise ConfigError(f"settings: {form}, not {str(listed)[:80]}")
    return listed


def _check_named(points: Any, name: Any) -> None:
    """Refuse a folder, and a name that is none."""
    if isinstance(points, str | Path) and Path(points).is_dir():
        remedy = "Name one of its files, or call it for each of them"
        raise InputError(points, "is a folder, and brafit.fit takes one cloud", remedy)
    if name is not None and not isinstance(name, str):
        raise InputError("name", f"{_shown(name)} is no text", f'Give a text: name="{_shown(name)}"')


def _scan_of(points: ArrayLike, arrays: Mapping[str, Any], side: str, name: str, settings: Mapping[str, Any]) -> Scan:
    """The scan of arrays, loaded as a file is."""
    from brafit.cloud.read import MIN_POINTS, Cloud
    from brafit.landmarks.file import SIDES
    from brafit.run.recipe import READING
    from brafit.scan import load_scan

    if arrays["wire"] is None:
        raise InputError("wire", "is not given", "Give the wire line, an array of shape (k, 3), inner end first")
    if side not in SIDES:
        raise InputError("side", f"{side!r} is neither 'left' nor 'right'", "Name the wearer's side")
    cloud = _points("points", points, MIN_POINTS)
    marks = _marks(arrays, side, name)
    flag = None if arrays["inside"] is None else _flag(arrays["inside"], len(cloud))
    given = {key: value for key, value in settings.items() if key not in (*READING, "propose")}
    given["units"] = given.get("units") or "mm"
    try:
        return load_scan(Cloud(Path("points"), cloud, None, flag), name=name, landmarks=marks, **given)
    except WrongWayError as error:
        other = "right" if side == "left" else "left"
        own = "points of a Scan are in its cup frame, right ones mirrored: give brafit.fit the scan itself"
        remedy = f'Give side="{other}", or the wire from its inner to its outer end; {own}'
        raise WrongWayError(error.file, error.cause, remedy) from None
    except ApartError as error:
        raise ApartError(error.file, error.cause, "Give points and marks in one frame and one unit") from None
    except OtherUnitError as error:
        setting = f'settings=["scan.units={error.unit}"]'
        remedy = f"Give points and marks in millimetres, or {setting} if all are in that unit"
        raise OtherUnitError(error.file, error.cause, remedy, error.unit) from None


def _marks(arrays: Mapping[str, Any], side: str, name: str) -> Landmarks:
    from brafit.landmarks import Landmarks

    line = _points("wire", arrays["wire"], 4)
    upper = None if arrays["neckline"] is None else _points("neckline", arrays["neckline"], 2)
    marks = {key: _mark(key, arrays[key]) for key in ("strap_point", "apex") if arrays[key] is not None}
    return Landmarks(Path("landmarks"), name, side, line, upper, marks)


def _refuse_beside(points: Scan | str | Path, given: Mapping[str, Any]) -> None:
    """A scan has marks of its own."""
    if beside := [key for key, value in given.items() if value is not None]:
        what = "a file" if isinstance(points, str | Path) else "a scan"
        remedy = f"{what.capitalize()} has its own: leave {beside[0]} out, or give points as an array"
        raise InputError(beside[0], f"given beside {what}", remedy)


def _points(name: str, values: ArrayLike, least: int) -> np.ndarray:
    array = _numbers(name, values, "(n, 3)")
    if array.ndim == 2 and array.shape[1] != 3 == array.shape[0]:
        remedy = "Give it transposed, a point a row: (n, 3)"
        raise InputError(name, f"has the shape {array.shape}: a point a column", remedy)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(name, f"has the shape {array.shape}", "Give an array of shape (n, 3)")
    if not np.isfinite(array).all():
        raise InputError(name, "has numbers that are not finite", "Leave those points out")
    if len(np.unique(array, axis=0)) < least:
        raise InputError(name, f"has fewer than {least} distinct points", "Give more")
    return array


def _mark(name: str, values: ArrayLike) -> np.ndarray:
    array = _numbers(name, values, "(3,)").reshape(-1)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(name, f"is {_shown(values)}, not three finite numbers", "Give an array of shape (3,)")
    return array


def _flag(values: ArrayLike, count: int) -> np.ndarray:
    """The flag of each point."""
    array = _numbers("inside", values, "(n,)").reshape(-1)
    if len(array) != count:
        raise InputError("inside", f"has {len(array)} entries for {count} points", "Give one a point")
    if not np.isfinite(array).all():
        raise InputError("inside", "has entries that are neither true nor false", "Give true or false for each point")
    return array.astype(bool)


def _numbers(name: str, values: Any, shape: str) -> np.ndarray:
    """An array or the like in float64; what it masks is nan."""
    remedy = f"Give an array of shape {shape}"
    if getattr(values, "requires_grad", False):
        remedy = f"Give {name}.detach(); derivatives by points and marks are those of brafit.layer"
        raise InputError(name, "is a tensor with derivatives, which brafit.fit does not give", remedy)
    try:
        plain = np.ma.asarray(values.detach().cpu() if hasattr(values, "detach") else values)
        if plain.dtype.kind == "c":
            raise InputError(name, "has complex numbers", remedy)
        return np.ma.filled(plain.astype(np.float64), np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(name, f"is no array of numbers ({error})", remedy) from None


def _shown(values: Any) -> str:
    return " ".join(str(values).split())[:60]
