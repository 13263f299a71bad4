"""Populations of made cups for the tests of sizes: their kinds are known, and so is who is of which."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from cups import varied

from brafit.cup import StripsCup, Wire
from brafit.report.table import write_fit_json
from brafit.result import wire_entry

SETTINGS = {
    "cup": {"_target_": "brafit.cup.StripsCup", "panels": 2, "terms": 5, "nodes": 24, "output_nodes": 48},
    "pattern": {"_target_": "brafit.pattern.PatternOptions"},
}


def made_cup(radius: float, reach: float, amount: float = 0.0, panels: int = 2) -> tuple[StripsCup, np.ndarray]:
    """A cup on a half circle (mm), deeper with larger reach, its parameters changed a little; and its wire line."""
    angle = np.linspace(0, math.pi, 41)
    line = radius * np.stack((np.sin(angle), 1 - np.cos(angle), 0.05 * np.sin(2 * angle)), axis=1)
    cup = StripsCup(Wire.from_polyline(line), panels=panels, terms=5, nodes=24, output_nodes=48)
    angles = 1.4 * torch.arange(1, panels + 1, dtype=torch.float64)[None] / panels
    cup.start(angles, torch.full_like(angles, reach))
    cup.load_flat(varied(cup, amount))
    return cup, line


def write_fit(folder: Path, cup: StripsCup, line: np.ndarray, side: str = "left", **more: object) -> None:
    """A scan's folder as a run leaves it, as far as sizes ask for it."""
    named = {name: value[0] for name, value in cup.split(cup.flatten().detach()).items()}
    row = {"scan": folder.name, "status": "ok", "side": side, "nearest_wire": "orange:32"}
    extra = {"wire": wire_entry(Wire.from_polyline(line)), "parameters": named, "settings": SETTINGS}
    dimensions = [["cup", "wire", float(cup.wire.length), "mm", None]]
    write_fit_json(folder / "fit.json", row, extra | {"pattern": {"dimensions": dimensions}} | more)


def write_population(out: Path, kinds: list[tuple[float, float]], each: int) -> dict[str, int]:
    """So many cups, a little varied, of each kind (radius and reach); gives the kind of each name."""
    kind_of = {}
    for kind, (radius, reach) in enumerate(kinds):
        for k in range(each):
            name = f"cup_{k}_{kind}"
            write_fit(out / name, *made_cup(radius * (1 + 0.003 * k), reach, 0.004 * k), "left" if k % 2 else "right")
            kind_of[name] = kind
    return kind_of
