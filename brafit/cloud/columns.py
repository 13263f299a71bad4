"""What the columns of a table hold, from their names: positions, normals, the flag `inside`, and a unit of length."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from brafit.cloud.refusal import RefusedError

AXES = "xyz"
UNITS = {"mm": "mm", "cm": "cm", "m": "m", "in": "in", "inch": "in", "inches": "in"}
UNITS |= {f"{long}{end}": short for short, long in (("mm", "millimet"), ("cm", "centimet"), ("m", "met"))
          for end in ("re", "res", "er", "ers")}  # fmt: skip
"""Names of units that a column's name may hold, and what they are called here."""

OTHER_UNITS = {
    "um",
    "µm",
    "μm",
    "micron",
    "microns",
    "micrometer",
    "micrometers",
    "micrometre",
    "micrometres",
    "nm",
    "dm",
    "km",
    "ft",
    "foot",
    "feet",
    "yd",
    "yard",
    "yards",
    "mil",
    "mils",
    "thou",
    "px",
    "pixel",
    "pixels",
}
"""Units that a column's name may hold and that are not read."""
_WORD = "|".join(sorted(UNITS, key=len, reverse=True))
_BRACKETS = re.compile(r"(?P<name>.*?)\s*[\[({<]\s*(?P<unit>[^\])}>]*?)\s*[\])}>]")
_BARE = re.compile(rf"(?P<name>.+?)(?:[\s,]+in)?[\s/_,]+(?P<unit>{_WORD})")
_PLACE = r"points?|pos|positions?|[ck]oord(?:inate[ns]?)?s?|vert(?:ex|ices)|loc|locations?|p"
_JOIN = r"[\s_.:\-]*"
_POSITION = re.compile(
    rf"(?P<before>(?:(?:{_PLACE}){_JOIN})?)(?P<axis>[xyz])(?P<after>(?:{_JOIN}(?:{_PLACE}|axis|achse|value|wert))?)"
)
_NORMAL = re.compile(rf"(?P<before>n|normals?)(?:{_JOIN})(?P<axis>[xyz])(?P<after>)")
# ParaView writes "Points:0", "Points:1", "Points:2".
_COUNTED = re.compile(
    r"(?P<kind>points?|positions?|coord(?:inate)?s?|vertices|normals?)[\s_.:\-\[]*(?P<number>[012])\]?"
)


@dataclass(frozen=True)
class Columns:
    """Where a table's columns are: `positions`, maybe `normals` and `inside`; the unit of positions, if stated."""

    places: dict[str, tuple[int, ...]]
    unit: str | None = None


def columns_of(names: Sequence[str]) -> Columns | None:
    """What columns of these names hold; None if none of them are called x, y, z, or the like.

    Names may hold the unit (`X [mm]`, `y_cm`, `z in m`) and words for positions (`pos_x`, `Points:0`); case counts not.

    Raises:
        RefusedError: several could be meant, or x, y and z are in different units.
    """
    positions: dict[str, dict[str, int]] = {}
    normals: dict[str, dict[str, int]] = {}
    units: list[str | None] = []
    for k, name in enumerate(names):
        plain, unit = _parted(name)
        units.append(unit)
        if unit in OTHER_UNITS and _axis(plain, _POSITION, ""):
            cause = f"its column {_shown(name)} is in a unit that is not read"
            raise RefusedError(cause, f"Export it in one of {', '.join(dict.fromkeys(UNITS.values()))}")
        for group, found in ((positions, _axis(plain, _POSITION, "")), (normals, _axis(plain, _NORMAL, "normal"))):
            if found is None:
                continue
            style, axis = found
            if axis in group.setdefault(style, {}):
                raise RefusedError(f"two of its columns are named {_shown(name)}", "Give every column its own name")
            group[style][axis] = k
    at = _complete(positions)
    if at is None:
        return None
    unit = _common([units[k] for k in at], [names[k] for k in at])
    places = {"positions": at}
    if (of_normals := _complete(normals)) is not None:
        places["normals"] = of_normals
    flags = [k for k, name in enumerate(names) if _parted(name)[0] == "inside"]
    if len(flags) == 1:
        places["inside"] = (flags[0],)
    return Columns(places, unit)


def units_row(cells: Sequence[str]) -> list[str] | None:
    """The units in brackets, if cells below the names hold nothing else: `mm`, `[mm]`, `-`, or nothing."""
    plain = [cell.strip(" \t\"'[](){}<>").lower() for cell in cells]
    if not any(cell in UNITS for cell in plain) or any(any(c.isdigit() for c in cell) for cell in plain):
        return None
    return [f"[{cell}]" if cell in UNITS else "" for cell in plain]


def _parted(name: str) -> tuple[str, str | None]:
    """A column's name in lower case without its unit, and that unit, if it is one of UNITS or OTHER_UNITS."""
    plain = " ".join(name.strip(" \t\"'#/%").lower().split())
    match = _BRACKETS.fullmatch(plain) or _BARE.fullmatch(plain)
    if match is None or match["unit"].isdigit():
        return plain, None
    unit = match["unit"]
    return match["name"], UNITS.get(unit, unit if unit in OTHER_UNITS else None)


def _axis(plain: str, pattern: re.Pattern[str], kind: str) -> tuple[str, str] | None:
    """The manner of naming, which x, y and z must share, and the axis."""
    match = _COUNTED.fullmatch(plain)
    if match is not None:
        named = match["kind"]
        fitting = named.startswith("normal") == (kind == "normal")
        return (named, AXES[int(match["number"])]) if fitting else None
    match = pattern.fullmatch(plain)
    return None if match is None else (f"{match['before']}*{match['after']}", match["axis"])


def _complete(groups: dict[str, dict[str, int]]) -> tuple[int, ...] | None:
    """The places of x, y, z that are named in one manner: plainly, if there are several."""
    whole = {style: group for style, group in groups.items() if set(group) == set(AXES)}
    chosen = whole.get("*") or (next(iter(whole.values())) if len(whole) == 1 else None)
    if chosen is None and whole:
        raise RefusedError(
            f"{len(whole)} groups of its columns are x, y, z", "Name the columns of the position x, y, z"
        )
    return None if chosen is None else tuple(chosen[axis] for axis in AXES)


def _common(units: Sequence[str | None], names: Sequence[str]) -> str | None:
    stated = {unit for unit in units if unit is not None}
    if len(stated) > 1:
        listed = ", ".join(map(_shown, names))
        raise RefusedError(f"its columns are in different units: {listed}", "Export x, y and z in one unit")
    return stated.pop() if stated else None


def _shown(name: str) -> str:
    return repr(name.strip()[:40])
