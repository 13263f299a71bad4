"""`brafit.fit`: a cup from arrays, without files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from brafit.errors import InputError

if TYPE_CHECKING:
    from brafit.fit.solver import Callback
    from brafit.result import Result


def fit(
    points: ArrayLike,
    *,
    wire: ArrayLike,
    side: str = "left",
    neckline: ArrayLike | None = None,
    strap_point: ArrayLike | None = None,
    apex: ArrayLike | None = None,
    name: str = "cup",
    settings: Sequence[str] = (),
    callback: Callback | None = None,
) -> Result:
    """Fit a cup to points.

    Args:
        points: (n, 3) the breast's surface, in millimetres, in any frame. All are used, as they are.
        wire: (k, 3) the wire line, inner end first, in the same frame; at least 4 distinct points.
        side: the wearer's `left` or `right` breast.
        neckline: (m, 3) the wanted upper edge, inner end first.
        strap_point, apex: (3) where the strap is sewn on, and the bust point.
        name: for labels and files.
        settings: as on the command line: `["cup.panels=3", "pattern.allowance.wire=8"]`. Those that say where scans are
            found and how they are cleaned have no effect.
        callback: told of every step of the fit.

    Raises:
        InputError: arrays that are no points, or a wire that is no bow.
        ConfigError: a setting that does not exist or is out of its range.
    """
    from brafit.app import plain_settings
    from brafit.config import choices_of, from_settings
    from brafit.fit import ResultCode, Target
    from brafit.landmarks.cup_frame import frame_from_wire
    from brafit.result import Result
    from brafit.run.recipe import recipe_from_settings

    cloud, line = _points("points", points, 1), _points("wire", wire, 4)
    upper = None if neckline is None else _points("neckline", neckline, 2)
    marks = {key: None if m is None else _mark(key, m) for key, m in (("strap_point", strap_point), ("apex", apex))}
    if side not in ("left", "right"):
        raise InputError("side", f"{side!r} is neither 'left' nor 'right'", "Name the wearer's side")
    recipe = recipe_from_settings(plain_settings(from_settings([*settings, "out=unused"])), choices_of(settings))
    front = np.median(cloud, axis=0) if marks["apex"] is None else marks["apex"]
    frame = frame_from_wire(line, side, front, "wire")
    target = Target(
        name=name,
        points=frame.to_cup(cloud),
        wire=frame.to_cup(line),
        neckline=None if upper is None else frame.to_cup(upper),
        **{key: None if mark is None else frame.to_cup(mark) for key, mark in marks.items()},
    )
    (found,) = recipe.fit([target], callback)
    if found.code is ResultCode.DIVERGED:
        raise InputError(name, found.reason, "Check that points and wire are in millimetres and in the same frame")
    given = {"points": f"given ({len(cloud)})", "wire": f"given ({len(line)} points)", "side": f"given ({side})"}
    given["neckline"] = "none given: only the points say where the cup ends" if upper is None else "given"
    given["strap point"] = "none given" if strap_point is None else "given"
    given["apex"] = "not given: the cup's point farthest from the chest" if apex is None else "given"
    return Result(found, target, "right" if side == "right" else "left", frame, recipe.pattern, given, recipe.model)


def _points(name: str, values: ArrayLike, least: int) -> np.ndarray:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(name, f"is no array of numbers ({error})", "Give an array of shape (n, 3)") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(name, f"has the shape {array.shape}", "Give an array of shape (n, 3)")
    if not np.isfinite(array).all():
        raise InputError(name, "has numbers that are not finite", "Leave those points out")
    if len(np.unique(array, axis=0)) < least:
        raise InputError(name, f"has fewer than {least} distinct points", "Give more")
    return array


def _mark(name: str, values: ArrayLike) -> np.ndarray:
    return _points(name, np.asarray(values, dtype=np.float64).reshape(1, -1), 1)[0]
