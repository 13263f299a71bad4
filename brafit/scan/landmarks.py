"""The landmark file beside a cloud: wire line, upper line and marked points.

The format is described by `landmarks.schema.json` in this folder; the checks here are written by hand, because
their messages name the field and, for a misspelt one, the field that was probably meant.
"""

from __future__ import annotations

import difflib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from brafit.errors import InputError

SIDES = ("left", "right")
POINT_NAMES = ("inner_end", "outer_end", "wire_bottom", "apex", "strap_point")
FIELDS = ("name", "units", "side", "landmarks", "wire", "upper_line")
MILLIMETRES = {"mm": 1.0}
"""Units that are understood, and how many millimetres each is."""
KNOWN_UNITS = {"m": 1000.0, "cm": 10.0, "dm": 100.0, "in": 25.4, "inch": 25.4, "um": 0.001}
WIRE_POINTS = 4

SCHEMA = "See brafit/scan/landmarks.schema.json for the format"


@dataclass(frozen=True, eq=False)
class Landmarks:
    """One landmark file; positions in millimetres, in the cloud's frame.

    Attributes:
        path: the file.
        name: its `name`, or the file's stem.
        side: the wearer's `left` or `right` breast.
        wire: the wire line, as given (inner end first, where the file keeps to the convention).
        upper_line: the neckline of the cup, from end to end of the wire by the strap point.
        points: the marked points, by name; any of `POINT_NAMES` may be absent.
    """

    path: Path
    name: str
    side: str
    wire: Float[np.ndarray, "k 3"]
    upper_line: Float[np.ndarray, "m 3"] | None
    points: dict[str, Float[np.ndarray, "3"]]


def landmarks_path(cloud: str | Path) -> Path:
    """Where the landmark file of a cloud is expected: beside it, with the same stem."""
    return Path(cloud).with_suffix(".json")


def read_landmarks(path: str | Path) -> Landmarks:
    """Read and check a landmark file.

    `wire` and `side` are required; `units` is `mm` where it is absent; marked points and `upper_line` are optional, but
    a misspelt or malformed one is an error. Other fields are allowed and ignored.

    Raises:
        InputError: names the file, the field at fault and what to do.
    """
    path = Path(path)
    data = _json(path)
    _refuse_misspelt(path, data, FIELDS, "")
    _check_units(path, data.get("units", "mm"))
    name = data.get("name", path.stem)
    if not isinstance(name, str) or not name.strip():
        raise InputError(path, f"name: {_shown(name)} is not a text", "Give the scan's name in quotes, or leave it out")
    wire = _polyline(path, "wire", _required(path, data, "wire"), WIRE_POINTS)
    upper = data.get("upper_line")
    return Landmarks(
        path=path,
        name=name,
        side=_side(path, _required(path, data, "side")),
        wire=wire,
        upper_line=None if upper is None else _polyline(path, "upper_line", upper, 3),
        points=_points(path, data.get("landmarks")),
    )


def _json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(path, "there is no such landmark file", f"Write it beside the cloud. {SCHEMA}") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "Check the file and its permissions") from None
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}: {error.msg}"
        raise InputError(path, f"is not valid JSON ({where})", "Correct the file at that place") from None
    except (UnicodeDecodeError, RecursionError):
        raise InputError(path, "is not a JSON text file", f"Write the landmarks as JSON. {SCHEMA}") from None
    if not isinstance(data, dict):
        raise InputError(path, f"holds {_kind(data)}, not an object with named fields", SCHEMA)
    return data


def _required(path: Path, data: dict[str, Any], field: str) -> Any:
    if data.get(field) is None:
        raise InputError(path, f"{field}: missing", f"Add the field {field}. {SCHEMA}")
    return data[field]


def _refuse_misspelt(path: Path, data: dict[str, Any], names: tuple[str, ...], prefix: str) -> None:
    """Unknown fields are allowed, unless one looks like a known field that is absent."""
    absent = [name for name in names if name not in data]
    for key in data:
        if key in names:
            continue
        meant = _meant(key, absent)
        if meant:
            raise InputError(
                path,
                f"{prefix}{meant}: missing; '{key}' looks like it",
                f"Rename '{key}' to '{meant}', or remove it",
            )


def _meant(key: str, names: list[str]) -> str | None:
    plain = key.strip().lower().replace("-", "_").replace(" ", "_")
    close = difflib.get_close_matches(plain, names, n=1, cutoff=0.75)
    return close[0] if close else None


def _check_units(path: Path, units: Any) -> None:
    if isinstance(units, str) and units in MILLIMETRES:
        return
    factor = KNOWN_UNITS.get(units.strip().lower()) if isinstance(units, str) else None
    by = f"by {factor:g}" if factor else "by the length of one unit in millimetres"
    raise InputError(
        path,
        f'units: {_shown(units)}, but only "mm" is read',
        f'Multiply all coordinates, here and in the cloud, {by}, and write "units": "mm"',
    )


def _side(path: Path, side: Any) -> str:
    if side not in SIDES:
        raise InputError(path, f'side: {_shown(side)} is neither "left" nor "right"', "Name the wearer's side")
    return side


def _points(path: Path, block: Any) -> dict[str, np.ndarray]:
    if block is None:
        return {}
    if not isinstance(block, dict):
        remedy = f'Write {{"apex": [x, y, z], ...}}. {SCHEMA}'
        raise InputError(path, f"landmarks: {_kind(block)}, not an object with named points", remedy)
    _refuse_misspelt(path, block, POINT_NAMES, "landmarks.")
    named = [name for name in POINT_NAMES if block.get(name) is not None]
    return {name: np.array(_triple(path, f"landmarks.{name}", block[name])) for name in named}


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
    remedy = "Give three finite numbers [x, y, z] in millimetres"
    if not isinstance(value, list):
        raise InputError(path, f"{field}: {_kind(value)}, not a point", remedy)
    if len(value) != 3:
        raise InputError(path, f"{field}: {len(value)} number{'' if len(value) == 1 else 's'}, not 3", remedy)
    for number in value:
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise InputError(path, f"{field}: {_shown(number)} is not a number", remedy)
        if not abs(number) < math.inf:
            raise InputError(path, f"{field}: {_shown(number)} is not finite", remedy)
    return tuple(float(number) for number in value)


def _kind(value: Any) -> str:
    kinds = {dict: "an object", list: "a list", str: "a text", bool: "true or false", type(None): "nothing"}
    return kinds.get(type(value), "a number")


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
