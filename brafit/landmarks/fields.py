"""Names of the landmark file's fields, and which of them is meant by a name that is none.

Fields of other names are allowed and ignored: people keep what they like in these files. But a landmark must not be
dropped in silence, so one that is misspelt, called by another of its names, or in the wrong place is refused.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from brafit.errors import InputError
from brafit.landmarks.units import MILLIMETRES

POINT_NAMES = ("inner_end", "outer_end", "wire_bottom", "apex", "strap_point")
LINES = ("wire", "upper_line")
BREAST_FIELDS = ("side", "landmarks", *LINES, "proposed")
FIELDS = ("name", "units", *BREAST_FIELDS, "breasts")
SYNONYMS = {
    "apex": ("bust point", "bust apex", "breast apex", "apex point", "nipple", "bp"),
    "strap_point": ("strap", "strap end", "strap connection", "connection point", "connection"),
    "inner_end": ("inner", "inner point", "wire inner end", "wire inner", "wire start", "medial end"),
    "outer_end": ("outer", "outer point", "wire outer end", "wire outer", "wire end", "lateral end"),
    "wire_bottom": ("bottom", "bottom point", "lowest point", "wire lowest point"),
    "wire": ("wire line", "underwire", "wire curve", "crease", "inframammary fold", "imf"),
    "upper_line": ("neckline", "neck line", "upper edge", "upper curve", "top line", "top edge"),
    "landmarks": ("points", "marks", "marked points"),
    "units": ("length unit",),
}
"""Other names that people have for a field. They count only where the value is of the field's kind: `bust: 92`, a
girth, is no bust point."""
_CLOSE = 0.75


def check_names(path: Path, data: Mapping[str, Any]) -> None:
    """Refuse a field that is meant for another one, which is absent.

    Args:
        path: the file.
        data: its content; what is not of the right kind is left to other checks.

    Raises:
        InputError: names the field that is meant, where it belongs, and the one that stands there.
    """
    breasts = data.get("breasts")
    if not isinstance(breasts, list):
        _check(path, data, FIELDS, "", _absent(POINT_NAMES, data.get("landmarks"), "landmarks."))
        _check_points(path, data, "", _absent(("units",), data, ""))
        return
    items = [item for item in breasts if isinstance(item, dict)]
    marked = {name for item in items if isinstance(points := item.get("landmarks"), dict) for name in points}
    _check(path, data, FIELDS, "", _absent(POINT_NAMES, marked, "breasts[...].landmarks."))
    units = _absent(("units",), data, "")
    for i, item in enumerate(items):
        prefix = f"breasts[{i}]."
        points = _absent(POINT_NAMES, item.get("landmarks"), f"{prefix}landmarks.")
        _check(path, item, BREAST_FIELDS, prefix, points | units)
        _check_points(path, item, prefix, units)


def _absent(names: Iterable[str], block: Any, place: str) -> dict[str, str]:
    """The names that a block lacks, and the place where they belong."""
    held = block if isinstance(block, Mapping | set) else ()
    return {name: place for name in names if name not in held}


def _check_points(path: Path, breast: Mapping[str, Any], prefix: str, units: Mapping[str, str]) -> None:
    points = breast.get("landmarks")
    if isinstance(points, dict):
        _check(path, points, POINT_NAMES, f"{prefix}landmarks.", {**_absent(("side", *LINES), breast, prefix), **units})


def _check(
    path: Path, block: Mapping[str, Any], names: tuple[str, ...], prefix: str, elsewhere: Mapping[str, str]
) -> None:
    """Refuse fields of a block that are meant for absent ones: of it, or of those that belong elsewhere."""
    absent = [name for name in names if name not in block]
    for key, value in block.items():
        if key in names:
            continue
        if meant := _meant(key, value, absent):
            cause = f"{prefix}{meant}: missing; '{key}' looks like it"
            raise InputError(path, cause, f"Rename '{key}' to '{meant}', or remove it")
        meant = _meant(key, value, elsewhere)
        if meant and _is_like(meant, value):
            place = elsewhere[meant]
            cause = f"{place}{meant}: missing; '{prefix}{key}' looks like it, but stands in the wrong place"
            where = f"into {place.rstrip('.')}" if place else "to the top level of the file"
            raise InputError(path, cause, f"Move it {where}, as '{meant}', or remove it")


def _meant(key: str, value: Any, names: Iterable[str]) -> str | None:
    """The one of these names that a key is another word for, if its value is of that kind, or looks like."""
    known = [name for name, words in SYNONYMS.items() if _letters(key) in map(_letters, words)]
    if known:  # `bust_point` also looks like `strap_point`
        return next((name for name in names if name in known and _is_like(name, value)), None)
    plain = key.strip().lower().replace("-", "_").replace(" ", "_")
    close = difflib.get_close_matches(plain, names, n=1, cutoff=_CLOSE)
    return close[0] if close else None


def _letters(words: str) -> str:
    return re.sub(r"[^a-z0-9]", "", words.lower())


def _is_like(name: str, value: Any) -> bool:
    """Whether a value is of the kind that a field holds."""
    if name in POINT_NAMES:
        return _is_point(value)
    if name in LINES:
        return isinstance(value, list) and len(value) > 1 and all(map(_is_point, value))
    if name == "landmarks":
        return isinstance(value, dict) and any(map(_is_point, value.values()))
    return value in {"units": tuple(MILLIMETRES), "side": ("left", "right")}[name]


def _is_point(value: Any) -> bool:
    """Three numbers, in a list or as x, y and z."""
    numbers = [value.get(axis) for axis in "xyz"] if isinstance(value, dict) else value
    return isinstance(numbers, list) and len(numbers) == 3 and all(isinstance(n, int | float) for n in numbers)
