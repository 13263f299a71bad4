"""The landmark file beside a cloud: wire line, upper line and marked points.

The format is described by `landmarks.schema.json` in this folder; the checks here are written by hand, because
their messages name the field and, for a misspelt one, the field that was probably meant.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from brafit.cloud.mesh import ABSURD
from brafit.errors import InputError
from brafit.landmarks.fields import BREAST_FIELDS, POINT_NAMES, check_names
from brafit.landmarks.units import MILLIMETRES
from brafit.naming import on_disk

SIDES = ("left", "right")
WIRE_POINTS = 4
DECIMALS = {"mm": 3, "cm": 4, "in": 5, "m": 6}
"""Decimals of positions that are written, by unit: a thousandth of a millimetre."""

SCHEMA = "See brafit/landmarks/landmarks.schema.json for the format"


@dataclass(frozen=True, eq=False)
class Landmarks:
    """One breast of a landmark file; positions in the cloud's frame.

    Attributes:
        path: the file.
        name: its `name`, or the file's stem.
        side: the wearer's `left` or `right` breast.
        wire: the wire line, as given (inner end first, where the file keeps to the convention), or None.
        upper_line: the neckline of the cup, from end to end of the wire by the strap point, or None.
        points: the marked points, by name; any of `POINT_NAMES` may be absent.
        units: the file's unit, or None where it does not say.
        proposed: the file says that its marks were proposed and nobody has looked at them.
    """

    path: Path
    name: str
    side: str
    wire: Float[np.ndarray, "k 3"] | None
    upper_line: Float[np.ndarray, "m 3"] | None
    points: dict[str, Float[np.ndarray, "3"]]
    units: str | None = None
    proposed: bool = False

    def mapped(self, function: Callable[[np.ndarray], np.ndarray], **changes: Any) -> Landmarks:
        """With a function applied to all positions (its argument and result are (..., 3)), and other changes."""
        return replace(
            self,
            wire=None if self.wire is None else function(self.wire),
            upper_line=None if self.upper_line is None else function(self.upper_line),
            points={name: function(point) for name, point in self.points.items()},
            **changes,
        )

    def positions(self) -> Float[np.ndarray, "n 3"]:
        """All positions, one after another."""
        lines = [line for line in (self.wire, self.upper_line) if line is not None]
        return np.concatenate([np.empty((0, 3)), *lines, *(point[None] for point in self.points.values())])


def landmarks_path(cloud: str | Path) -> Path:
    """Where the landmark file of a cloud is, or is expected: beside it, with the same stem (see `on_disk`)."""
    path = Path(cloud).with_suffix(".json")
    found = on_disk(path)
    others = [path.with_suffix(ending) for ending in (".JSON", ".Json")]
    return found if found.exists() else next((other for other in others if other.exists()), found)


def read_landmarks(path: str | Path, side: str | None = None) -> Landmarks:
    """Read and check a landmark file: the breast of this side, or the first.

    A file marks one breast, or two in the list `breasts`. `side` is required; marked points, `wire` and `upper_line`
    are optional, but one that is malformed, misspelt, called by another name or in the wrong place is an error. Other
    fields are allowed and ignored.

    Args:
        path: the file, JSON in UTF-8, UTF-16 or UTF-32.
        side: `left` or `right`; None: the first one, as where the file marks another side only.

    Raises:
        InputError: names the file, the field at fault and what to do.
    """
    breasts = read_breasts(path)
    found = [breast for breast in breasts if side in (None, breast.side)]
    return (found or breasts)[0]


def read_breasts(path: str | Path) -> list[Landmarks]:
    """All breasts of a landmark file, see `read_landmarks`.

    Raises:
        InputError: as `read_landmarks`.
    """
    path = Path(path)
    data = _json(path)
    check_names(path, data)
    units = _units(path, data.get("units"))
    name = data.get("name", path.stem)
    if not isinstance(name, str) or not name.strip():
        raise InputError(path, f"name: {_shown(name)} is not a text", "Give the scan's name in quotes, or leave it out")
    several = data.get("breasts")
    if several is None:
        return [_breast(path, data, name, units, "")]
    if not isinstance(several, list) or not several or not all(isinstance(item, dict) for item in several):
        raise InputError(path, "breasts: not a list of objects", f'Write [{{"side": "left", ...}}, ...]. {SCHEMA}')
    if doubled := [key for key in BREAST_FIELDS if key in data]:
        remedy = "Write it in each of breasts"
        raise InputError(path, f"{doubled[0]}: stands beside breasts, but belongs into it", remedy)
    breasts = [_breast(path, item, name, units, f"breasts[{i}].") for i, item in enumerate(several)]
    sides = [breast.side for breast in breasts]
    if len(set(sides)) < len(sides):
        raise InputError(path, f"breasts: the {sides[0]} one twice", "Give each side once")
    return breasts


def landmarks_text(breasts: Sequence[Landmarks]) -> str:
    """A landmark file of these breasts (of one scan), a point a line, to be looked at and corrected by hand."""
    first = breasts[0]
    head = {"name": first.name, "units": first.units or "mm"}
    blocks = [_block(breast, DECIMALS[head["units"]]) for breast in breasts]
    data: dict[str, Any] = {**head, **blocks[0]} if len(blocks) == 1 else {**head, "breasts": blocks}
    text = json.dumps(data, indent=1)
    # Points on one line each.
    return re.sub(r"\[\s+(-?[\d.e+-]+),\s+(-?[\d.e+-]+),\s+(-?[\d.e+-]+)\s+\]", r"[\1, \2, \3]", text) + "\n"


def _block(breast: Landmarks, decimals: int) -> dict[str, Any]:
    block: dict[str, Any] = {"side": breast.side}
    if breast.proposed:
        block["proposed"] = True
    if breast.points:
        block["landmarks"] = {name: np.round(point, decimals).tolist() for name, point in breast.points.items()}
    for name, line in (("wire", breast.wire), ("upper_line", breast.upper_line)):
        if line is not None:
            block[name] = np.round(line, decimals).tolist()
    return block


def _breast(path: Path, data: dict[str, Any], name: str, units: str | None, prefix: str) -> Landmarks:
    wire, upper = data.get("wire"), data.get("upper_line")
    proposed = data.get("proposed", False)
    if not isinstance(proposed, bool):
        raise InputError(path, f"{prefix}proposed: {_shown(proposed)} is neither true nor false", "Write true or false")
    return Landmarks(
        path=path,
        name=name,
        side=_side(path, data.get("side"), prefix),
        wire=None if wire is None else _polyline(path, f"{prefix}wire", wire, WIRE_POINTS),
        upper_line=None if upper is None else _polyline(path, f"{prefix}upper_line", upper, 3),
        points=_points(path, data.get("landmarks"), prefix),
        units=units,
        proposed=proposed,
    )


def _json(path: Path) -> dict[str, Any]:
    try:
        content = path.read_bytes()
        encoding = json.detect_encoding(content)
        data = json.loads(content.decode(encoding), object_pairs_hook=_once_each)
    except _TwiceError as error:
        cause = f"{error.args[0]}: written twice in one place, and it could be read in two ways"
        raise InputError(path, cause, "Leave one of them out") from None
    except FileNotFoundError:
        raise InputError(path, "there is no such landmark file", f"Write it beside the cloud. {SCHEMA}") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "Check the file and its permissions") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}: {error.msg}"
        raise InputError(path, f"is not valid JSON ({where})", "Correct the file at that place") from None
    except UnicodeDecodeError as error:
        kind = error.encoding.upper().removesuffix("-LE")
        raise InputError(path, f"is no text in {kind}", "Save it as JSON in UTF-8") from None
    except RecursionError:
        raise InputError(path, "is not a JSON text file", f"Write the landmarks as JSON. {SCHEMA}") from None
    if not isinstance(data, dict):
        raise InputError(path, f"holds {_kind(data)}, not an object with named fields", SCHEMA)
    return data


class _TwiceError(Exception):
    """A field that stands twice in one object; JSON lets the last one count without a word."""


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    if doubled := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise _TwiceError(doubled[0])
    return dict(pairs)


def _units(path: Path, units: Any) -> str | None:
    if units is None:
        return None
    known = {"inch": "in", "inches": "in"}
    word = known.get(units.strip().lower(), units.strip().lower()) if isinstance(units, str) else ""
    if word not in MILLIMETRES:
        choice = ", ".join(f'"{unit}"' for unit in MILLIMETRES)
        raise InputError(path, f"units: {_shown(units)} is none of {choice}", "Write one of these, or leave it out")
    return word


def _side(path: Path, side: Any, prefix: str) -> str:
    if side is None:
        raise InputError(path, f"{prefix}side: missing", 'Add "side": "left" or "side": "right", the wearer\'s')
    if side not in SIDES:
        cause = f'{prefix}side: {_shown(side)} is neither "left" nor "right"'
        raise InputError(path, cause, "Name the wearer's side")
    return side


def _points(path: Path, block: Any, prefix: str) -> dict[str, np.ndarray]:
    if block is None:
        return {}
    if not isinstance(block, dict):
        remedy = f'Write {{"apex": [x, y, z], ...}}. {SCHEMA}'
        raise InputError(path, f"{prefix}landmarks: {_kind(block)}, not an object with named points", remedy)
    named = [name for name in POINT_NAMES if block.get(name) is not None]
    return {name: np.array(_triple(path, f"{prefix}landmarks.{name}", block[name])) for name in named}


def _polyline(path: Path, field: str, value: Any, least: int) -> np.ndarray:
    if not isinstance(value, list):
        raise InputError(path, f"{field}: {_kind(value)}, not a list of points", f"Write [[x, y, z], ...]. {SCHEMA}")
    points = [_triple(path, f"{field}[{i}]", point) for i, point in enumerate(value)]
    distinct = len(set(points))
    if distinct < least:
        raise InputError(
            path,
            f"{field}: {distinct} distinct point{'' if distinct == 1 else 's'}, at least {least} are needed",
            f"Trace the line with {least} points or more, from end to end (20 to 50 are good)",
        )
    line = np.array(points)
    moved = np.any(np.diff(line, axis=0) != 0, axis=1)
    return line[np.concatenate([[True], moved])]


def _triple(path: Path, field: str, value: Any) -> tuple[float, ...]:
    remedy = "Give three finite numbers [x, y, z]"
    if not isinstance(value, list):
        raise InputError(path, f"{field}: {_kind(value)}, not a point", remedy)
    if len(value) != 3:
        raise InputError(path, f"{field}: {len(value)} number{'' if len(value) == 1 else 's'}, not 3", remedy)
    for number in value:
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise InputError(path, f"{field}: {_shown(number)} is not a number", remedy)
        if not abs(number) < math.inf:
            raise InputError(path, f"{field}: {_shown(number)} is not finite", remedy)
        if abs(number) > ABSURD:
            raise InputError(path, f"{field}: {_shown(number)} is no place on a body in any unit", remedy)
    return tuple(float(number) for number in value)


def _kind(value: Any) -> str:
    kinds = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "nothing"}
    return kinds.get(type(value), "a number")


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
