"""Compares brafit's cups with what one would do otherwise: flatten the scan's surface, make it developable by MeshLab's
filter, or fit by the paper's solver. One table, from one run:

    python scripts/compare_peers.py                          the quarter sphere alone
    python scripts/compare_peers.py FOLDER                   and breast scans with their landmark files
    python scripts/compare_peers.py FOLDER --breasts 3       the first three of them
    python scripts/compare_peers.py FOLDER --write PAGE.md   and write the page, as docs/peers.md was

Flattening needs libigl, the filter pymeshlab; of what is not installed the row says so. Times are CPU seconds.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from benchmark import sphere_objective
from check_repeat import POINTS, rescan, shipped
from flattenings import FILTER, LONG_FILTER, FoldedError, Part, Surface, distances, peers, seam_gaps, strains
from outlines import Laid, patterns_apart
from peers_page import LONGER, OURS, PAPER, Figures, Missing, Setting, Table, page
from readers import MissingReaderError, module
from tqdm import tqdm

from brafit.atomic import write_text
from brafit.cup import FramesCup, Wire
from brafit.cup.shape import CupShape
from brafit.errors import ConfigError, InputError
from brafit.fitting import CupFit, NelderMead, Target
from brafit.fitting.measure import in_millimetres
from brafit.geometry.development import FlatPanel
from brafit.geometry.polyline import polyline_length
from brafit.pattern import pieces_from_panels
from brafit.report.mesh import panel_meshes
from brafit.scan import Scan, find_scans, load_scan
from brafit.scan.load import closed
from brafit.simulation.synthetic import quarter_sphere
from brafit.surface import point_weights
from brafit.surface.directions import Chart

RADIUS = 65.0
"""Of the sphere, mm: its wire is 204 mm long, as the breasts' are."""
PAPER_TERMS = 4
"""Ritz terms of the paper's cup, as in `benchmark.py`: with more its solver takes longer still."""


@dataclass(frozen=True)
class Cut:
    """A cut pattern: its parts in space and flat."""

    parts: Sequence[Part]

    @property
    def panels(self) -> list[FlatPanel]:
        """The flat edges of every part."""
        return [
            FlatPanel(*(torch.from_numpy(part.laid[edge]) for edge in (part.lower, part.upper))) for part in self.parts
        ]

    @staticmethod
    def of(shape: CupShape, panels: Sequence[FlatPanel]) -> Cut:
        """Of a cup and its panels laid flat."""
        meshes = panel_meshes(shape, pieces_from_panels(panels))
        return Cut([Part(mesh.vertices, mesh.faces, mesh.lower, mesh.upper, mesh.flat) for mesh in meshes])

    def figures(self, seconds: float, away: np.ndarray, wire: float, spread: float) -> Figures:
        """What is told of it.

        Args:
            seconds: that it took.
            away: distances of the scan's points from its surface, mm.
            wire: length of the wire, mm.
            spread: of the outlines over rescans, mm; nan if that is not known.
        """
        largest, most, mean = strains(self.parts)
        seams, apart = seam_gaps(self.parts)
        return Figures(
            seconds=seconds,
            strain_max=100 * largest,
            strain_most=100 * most,
            strain_mean=100 * mean,
            wire=100 * abs(self.parts[0].lengths(False)[1] / wire - 1),
            seams=100 * seams,
            apart=apart,
            rms=float(np.sqrt(np.mean(np.square(away)))),
            farthest=float(np.abs(away).max()),
            spread=spread,
        )


@dataclass(frozen=True)
class Case:
    """What is fitted: a scan without noise, and scans of the same anew."""

    name: str
    target: Target
    again: list[Target]


def case_of(name: str, draw: Callable[[int, float], Target], setting: Setting) -> Case:
    """A case of scans that are drawn by a seed and the noise."""
    again = [draw(seed, setting.noise) for seed in range(1, setting.rescans + 1)]
    return Case(name, draw(0, 0.0), again)


def sphere_scan(seed: int, noise: float) -> Target:
    """Points on the paper's quarter sphere, with noise; wire and neckline are its two half circles."""
    random = np.random.default_rng(seed)
    points = quarter_sphere(POINTS, RADIUS, random).numpy()
    points += noise * random.standard_normal(points.shape)
    turn = np.linspace(0, math.pi, 101)
    away, along = RADIUS * np.sin(turn), RADIUS * (1 - np.cos(turn))
    wire, neckline = (np.stack(columns, axis=1) for columns in ((away, along, 0 * turn), (0 * turn, along, away)))
    weights = point_weights(points, closed(wire, neckline))
    return Target("sphere", points, wire, neckline, weights=weights)


@dataclass(frozen=True)
class Row:
    """A row of the table for one case."""

    method: str
    panels: int
    figures: Figures | Missing


@dataclass(frozen=True)
class Compared:
    """The rows of one case, and the CPU seconds of its smooth surface."""

    rows: list[Row]
    surface: float


def compared(case: Case, setting: Setting) -> Compared:
    """All rows of a case but the paper's, and the time that its surface takes.

    Raises:
        InputError: it has no neckline.
        FoldedError: no mesh can be laid on its surface.
    """
    begun = time.process_time()
    surfaces = surfaces_of(case)
    seconds = (time.process_time() - begun) / len(surfaces)
    rows = []
    for panels in setting.panels:
        fit, own = fitted(case, panels)
        edges = fit.shape.edges.numpy()
        cuts = [surface.parts(edges) for surface in surfaces]
        for method, lay in peers(setting.evaluations).items():
            rows.append(Row(method, panels, flattened(case, cuts, lay)))
        rows.append(Row(OURS, panels, own))
    return Compared(rows, seconds)


def surfaces_of(case: Case) -> list[Surface]:
    """The surface of every scan of a case, all on the chart of the first.

    Raises:
        InputError: they have no neckline.
    """
    target = case.target
    if target.neckline is None:
        raise InputError(target.name, "has no upper line: a surface that is flattened must end somewhere", "Mark it")
    chart = Chart.about(target.points, closed(target.wire, target.neckline))
    return [Surface.of(one.points, target.wire, target.neckline, chart) for one in (target, *case.again)]


def patient_figures(case: Case, setting: Setting) -> Figures | Missing:
    """MeshLab's filter on two parts of the case's surface, with LONGER times the evaluations; no rescans."""
    edges = shipped(2).fit([case.target])[0].shape.edges.numpy()
    first = replace(case, again=[])
    (surface,) = surfaces_of(first)
    return flattened(first, [surface.parts(edges)], peers(LONGER * setting.evaluations)[FILTER])


def fitted(case: Case, panels: int) -> tuple[CupFit, Figures]:
    """Our cup of a case and its figures."""
    recipe = shipped(panels)
    begun = time.process_time()
    (fit,) = recipe.fit([case.target])
    seconds = time.process_time() - begun
    spread = spread_of(recipe.fit(case.again))
    wire = polyline_length(fit.shape.edges[0].numpy())
    return fit, Cut.of(fit.shape, fit.panels).figures(seconds, fit.distances, wire, spread)


def flattened(
    case: Case, cuts: Sequence[Sequence[Part]], lay: Callable[[Sequence[Part]], list[Part]]
) -> Figures | Missing:
    """The figures of the scan's own surface laid flat.

    Args:
        case: the scans.
        cuts: the parts of each of them.
        lay: lays parts flat.
    """
    first, *others = cuts
    begun = time.process_time()
    try:
        flat = lay(first)
        seconds = time.process_time() - begun
        spread = spread_of([Cut(lay(parts)) for parts in others])
        away = distances(case.target.points, flat)
    except MissingReaderError as error:
        return Missing(error.package)
    wire = polyline_length(first[0].vertices[first[0].lower])
    return Cut(flat).figures(seconds, away, wire, spread)


def spread_of(patterns: Sequence[Laid]) -> float:
    """How far the outlines of rescans are from those of the first one: the median, mm; nan if there are none."""
    if not patterns:
        return math.nan
    return float(np.median([patterns_apart(patterns[0], other) for other in patterns[1:]]))


def paper_figures(target: Target, seconds: float) -> Figures:
    """The paper's cup of two panels by its own solver, on the sphere, stopped after so many CPU seconds."""
    cup = FramesCup(Wire.from_arc(1.0, math.pi), panels=2, terms=PAPER_TERMS, basis="fourier")
    cup.start(torch.tensor([[math.pi / 4, math.pi / 2]]).double(), torch.ones(1, 2).double())
    objective = sphere_objective(cup, barrier=0.0)
    begun = time.process_time()
    solution = NelderMead(seconds=seconds).solve(objective, cup.flatten().detach(), None)
    spent = time.process_time() - begun
    shape = in_millimetres(cup.shape_of(solution.flat).map(lambda value: value[0].detach()), RADIUS)
    flat = shape.flat()
    panels = [FlatPanel(lower, upper) for lower, upper in zip(flat.lower, flat.upper, strict=True)]
    away = shape.distances(torch.from_numpy(target.points)).numpy()
    return Cut.of(shape, panels).figures(spent, away, polyline_length(shape.edges[0].numpy()), math.nan)


def gathered(found: Sequence[Compared]) -> Table:
    """The rows of all cases, those of the same method and number of panels together: medians, but of largest values the
    largest.
    """
    together: dict[tuple[str, int], list[Figures | Missing]] = {}
    for row in (row for one in found for row in one.rows):
        together.setdefault((row.method, row.panels), []).append(row.figures)
    return {key: _together(figures) for key, figures in together.items()}


def _together(found: Sequence[Figures | Missing]) -> Figures | Missing:
    for one in found:
        if isinstance(one, Missing):
            return one
    columns = np.array([astuple(one) for one in found if isinstance(one, Figures)])
    return Figures(*(float(value) for value in np.where(Figures.largest(), columns.max(0), np.median(columns, 0))))


def loaded(parser: argparse.ArgumentParser, folder: Path, most: int | None) -> list[Scan]:
    """The breasts of a folder with all their points; of one that cannot be used, a line says why."""
    try:
        paths = find_scans([folder])[:most]
    except (InputError, ConfigError) as error:
        parser.error(str(error))
    scans = []
    for path in tqdm(paths, desc="loading", leave=False, disable=None):
        try:
            scans.append(load_scan(path, points=None, outliers=None))
        except InputError as error:
            print(error, file=sys.stderr)
    return scans


def breasts_compared(scans: Sequence[Scan], setting: Setting) -> list[Compared]:
    """All breasts; of one that cannot be flattened, a line says why."""
    found = []
    for scan in tqdm(scans, desc="breasts", leave=False, disable=None):
        try:
            found.append(compared(case_of(scan.name, partial(rescan, scan), setting), setting))
        except (InputError, FoldedError) as error:
            print(f"{scan.name}: left out: {error}", file=sys.stderr)
    return found


def settled(parser: argparse.ArgumentParser, given: argparse.Namespace) -> Setting:
    """The options as they are used; a wrong one ends the program in one line."""
    try:
        panels = tuple(int(value) for value in given.panels.split(","))
    except ValueError:
        parser.error(f"--panels: {given.panels}, but it must be numbers with commas, such as 2,3,4")
    if min(panels) < 2:
        parser.error("--panels: at least 2: a cup of one panel has no seam to compare")
    if given.rescans < 2:
        parser.error("--rescans: at least 2, the first is what the others are compared with")
    if given.breasts is not None and given.breasts < 1:
        parser.error("--breasts: at least 1")
    return Setting(panels, given.rescans, given.noise, given.evaluations, given.patience, POINTS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="breast scans with their landmark files")
    parser.add_argument("--breasts", type=int, help="the first so many scans of the folder; all of them if left out")
    parser.add_argument("--panels", default="2,3,4", help="numbers of panels, with commas: %(default)s")
    parser.add_argument("--rescans", type=int, default=3, help="rescans of each: %(default)s")
    parser.add_argument("--noise", type=float, default=0.5, help="their noise along each axis, mm: %(default)s")
    parser.add_argument("--patience", type=float, default=30.0, help="CPU s of the paper's solver: %(default)s")
    parser.add_argument("--evaluations", type=int, default=4000, help="of the filter, at most: %(default)s")
    parser.add_argument("--write", type=Path, help="the page's file")
    given = parser.parse_args()
    setting = settled(parser, given)
    torch.set_num_threads(1)
    for name in ("igl", "pymeshlab"):  # what it takes to import them is in no row
        with contextlib.suppress(MissingReaderError):
            module(name)
    begun = time.process_time()
    scans = [] if given.folder is None else loaded(parser, given.folder, given.breasts)
    sphere = case_of("sphere", sphere_scan, setting)
    found = [compared(sphere, setting)]
    tables = {"The quarter sphere": gathered(found)}
    tables["The quarter sphere"][LONG_FILTER, 2] = patient_figures(sphere, setting)
    tables["The quarter sphere"][PAPER, 2] = paper_figures(sphere.target, setting.patience)
    if given.folder is not None:
        found = breasts_compared(scans, setting)
        if not found:
            parser.exit(2, f"no scan of {given.folder} could be compared\n")
        tables["One breast" if len(found) == 1 else f"{len(found)} breasts"] = gathered(found)
    surface = float(np.median([one.surface for one in found]))
    text = page(tables, setting, time.process_time() - begun, surface)
    print(text)
    if given.write is not None:
        write_text(given.write, text)


if __name__ == "__main__":
    main()
