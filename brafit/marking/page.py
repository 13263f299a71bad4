"""The page of one scan: everything in one file, which needs no server and no network."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from brafit.anatomy.confidence import OF_APEX, Confidence
from brafit.cloud.read import MIN_POINTS, Cloud
from brafit.errors import InputError
from brafit.landmarks.fields import FIELDS
from brafit.landmarks.file import DECIMALS, Landmarks, landmarks_path
from brafit.landmarks.units import MILLIMETRES, NAMES
from brafit.marking.bounds import bounds, catalogue
from brafit.marking.opening import Opening, opening_of
from brafit.marking.skin import SIZES, Skin, skin_of
from brafit.naming import shown
from brafit.report.html import page
from brafit.surface.thinning import distinct

SCRIPTS = (
    "vectors", "skin", "curve", "camera", "shaders", "picture", "marks", "strokes", "judgement", "memory", "panel",
    "desk", "hands", "main",
)  # fmt: skip
"""Scripts of the page, in the order in which they need each other."""


@dataclass(frozen=True)
class MarkingPage:
    """A page on which a scan is marked.

    Attributes:
        html: the page.
        key: under which the browser keeps its work.
        start: with what it begins, in words.
        done: somebody has marked the scan already.
    """

    html: str
    key: str
    start: str
    done: bool


def marking_page(raw: Cloud, name: str, side: str | None = None, units: str | None = None) -> MarkingPage:
    """The page of a scan.

    Args:
        raw: the scan as its file has it.
        name: of the scan.
        side: the only breast to be marked; None: all that it may hold.
        units: of the scan, where they are said.

    Raises:
        InputError: the landmark file beside it cannot be read; the scan's unit is in doubt; it has hardly any points.
    """
    single = len(distinct(raw.points))
    if single < MIN_POINTS:
        cause = f"only {single} of its {len(raw.points)} points are distinct"
        raise InputError(raw.path, cause, "Export the cloud again, or scan again")
    opening = opening_of(raw, side, units)
    skin = skin_of(opening.whole.cloud.points)
    key = f"brafit-mark:{hashlib.sha256(skin.records() + shown(raw.path.name).encode()).hexdigest()[:20]}"
    told = _told(raw, name, opening, skin) | {"key": key}
    script = "\n".join(_asset(f"{part}.js") for part in SCRIPTS)
    body = (
        f"<style>\n{_asset('mark.css')}</style>\n{_asset('page.html')}"
        f'<script type="application/json" id="scan-data">{_embedded(told)}</script>\n'
        f'<script>\n"use strict";\n(function () {{\n{script}}})();\n</script>'
    )
    given = bool(opening.breasts) and not any(breast.proposed for breast in opening.breasts)
    return MarkingPage(page(f"{name}: marks", body, wide=True), key, _begins(opening), given)


@cache
def _asset(name: str) -> str:
    return resources.files("brafit.marking").joinpath("browser", name).read_text(encoding="utf-8")


def _embedded(data: Any) -> str:
    """Data as they can stand in a script element."""
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _told(raw: Cloud, name: str, opening: Opening, skin: Skin) -> dict[str, Any]:
    """What the page is told; lengths and places in mm, from the skin's corner on."""
    file, cloud = landmarks_path(raw.path), opening.whole.cloud
    flagged = cloud.inside is not None and bool(cloud.inside.any())
    judged = cloud.points[cloud.inside] if flagged else cloud.points
    breasts = [_breast(breast, opening, skin) for breast in opening.breasts]
    return {
        "title": shown(name),
        "name": opening.breasts[0].name if opening.breasts else shown(raw.path.stem),
        "file": shown(file.name),
        "folder": shown(str(raw.path.absolute().parent)),
        "scan": shown(raw.path.name),
        "unit": opening.unit,
        "unitName": NAMES[opening.unit],
        "unitFrom": opening.unit_from,
        "factor": MILLIMETRES[opening.unit],
        "decimals": DECIMALS[opening.unit],
        "origin": skin.origin.tolist(),
        "skin": {
            "records": base64.b64encode(skin.records()).decode(),
            "step": skin.step,
            "count": len(skin.places),
            "spacing": skin.spacing,
            "sizes": SIZES,
            "of": skin.of,
        },
        "axes": opening.axes.tolist(),
        "extent": _extent(opening, skin),
        "size": float(np.linalg.norm(np.ptp(judged, axis=0))),
        "mirror": _mirror(opening, skin),
        "sides": list(opening.sides),
        "side": next((breast.side for breast in opening.breasts if breast.side in opening.sides), opening.sides[0]),
        "breasts": breasts,
        "start": hashlib.sha256(json.dumps(breasts).encode()).hexdigest()[:16],
        "extra": _extra(file),
        "faults": {side: [shown(fault) for fault in faults] for side, faults in opening.faults.items()},
        "notes": [shown(note) for note in opening.notes],
        "bounds": bounds(flagged),
        "catalogue": catalogue(),
    }


def _breast(breast: Landmarks, opening: Opening, skin: Skin) -> dict[str, Any]:
    confidence = opening.confidence.get(breast.side)

    def told(places: np.ndarray | None) -> Any:
        return None if places is None else np.round(places - skin.origin, 5).tolist()

    return {
        "side": breast.side,
        "origin": "proposed" if breast.proposed else "given",
        "detected": breast.side in opening.detected,
        "backwards": breast.side in opening.turned,
        "confidence": None if confidence is None else round(confidence.value, 2),
        "doubts": [] if confidence is None else [_doubt(key, confidence) for key in confidence.unusual],
        "wire": told(breast.wire),
        "upper": told(breast.upper_line),
        "points": {name: told(place) for name, place in breast.points.items()},
        "named": {name: told(place) for name, place in opening.named[breast.side].items()},
    }


def _doubt(key: str, confidence: Confidence) -> dict[str, str]:
    """What is unusual, and the mark that it speaks of."""
    return {"mark": "apex" if key in OF_APEX else "wire", "says": confidence.sentence(key)}


def _extent(opening: Opening, skin: Skin) -> float:
    """What is seen of the whole scan from in front, mm."""
    return float(np.ptp(skin.points @ opening.axes[:2].T, axis=0).max())


def _mirror(opening: Opening, skin: Skin) -> dict[str, Any] | None:
    if opening.mirror is None:
        return None
    normal = opening.mirror.normal
    return {"normal": normal.tolist(), "offset": float(opening.mirror.offset - normal @ skin.origin)}


def _extra(file: Path) -> dict[str, Any]:
    """What else stands in a landmark file that could be read: it stays there."""
    if not file.is_file():
        return {}
    # NaN and the like, which JSON has no words for, become null.
    data = json.loads(file.read_text(encoding="utf-8-sig"), parse_constant=lambda _: None)
    return {key: value for key, value in data.items() if key not in FIELDS}


def _begins(opening: Opening) -> str:
    if not opening.breasts:
        return "nothing is marked"
    words: Sequence[str] = [_begins_with(breast, opening) for breast in opening.breasts]
    return "; ".join(words)


def _begins_with(breast: Landmarks, opening: Opening) -> str:
    confidence = opening.confidence.get(breast.side)
    if confidence is not None:
        return f"{breast.side} proposed, confidence {confidence.value:.1f}"
    return f"{breast.side} {'proposed' if breast.proposed else 'marked'}"
