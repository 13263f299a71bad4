"""Measures how repeatable patterns are: the figures of repeatability in docs/figures.md come from one run.

    python scripts/check_repeat.py FOLDER                                      all parts
    python scripts/check_repeat.py FOLDER --only outlines,simulated            some parts
    python scripts/check_repeat.py FOLDER --only outlines --noise 0.5,1.0 --rescans 5 --panels 2,3
    python scripts/check_repeat.py FOLDER --only deviation --breasts all

FOLDER holds `breasts/` (clean breasts with landmark files) and `scans/` (simulated scans of whole torsos, whose
landmark file names the breast they were made of in scan.simulated_from). A rescan of a breast is a random draw of its
points with noise in all directions and the same landmarks. All is fitted with the settings as they are shipped. The
parts:

    outlines    rescans of every breast: how far patterns are apart, dimensions, inflections and radii of their edges
    simulated   patterns of simulated scans, against those of the clean breasts
    deviation   the standard deviations that a fit predicts of its pattern, against those seen over rescans
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from bends import Edges, Needless, edges_of
from check_scans import simulated, wanted_parts
from outlines import patterns_apart
from tqdm import tqdm

from brafit.cup.shape import CupShape
from brafit.fitting import CupFit, Target
from brafit.fitting.objective import Conditions
from brafit.fitting.result import ResultCode
from brafit.geometry.development import FlatPanel
from brafit.geometry.polyline import distances, evenly_spaced
from brafit.report.dimensions import piece_dimensions
from brafit.report.measures import Cups
from brafit.run.fitting import target_of
from brafit.run.recipe import Recipe, recipe_of
from brafit.scan import Scan, find_scans, load_scan
from brafit.surface import point_weights

POINTS = 2500
"""Points of a rescan."""
TOGETHER = 70
"""Targets that are fitted at once."""
DEVIATION_NOISE = 0.5
DEVIATION_RESCANS = 20
HELD = 0.005
"""A dimension that varies less than this (mm, cm2), seen and predicted, is given: the ratio of the two means little."""
CLOSE = 1.5
"""A prediction is close if it is within this factor of what is seen."""
ALONG = 300
"""Places on each edge where outlines are compared with their mean."""


@dataclass(frozen=True)
class Options:
    """What is measured. See the command line's help."""

    folder: Path
    noise: tuple[float, ...]
    rescans: int
    panels: tuple[int, ...]
    breasts: tuple[str, ...]


class Cut(Protocol):
    """A cup and its flat panels: a fit, or one of its alternatives."""

    @property
    def shape(self) -> CupShape: ...

    @property
    def panels(self) -> list[FlatPanel]: ...


def shipped(panels: int) -> Recipe:
    """The settings as they are shipped."""
    return recipe_of([f"cup.panels={panels}"])


def fits_of(recipe: Recipe, targets: Sequence[Target], label: str) -> list[CupFit]:
    """The fits of all targets, with a progress bar."""
    chunks = [targets[k : k + TOGETHER] for k in range(0, len(targets), TOGETHER)]
    fits: list[CupFit] = []
    for chunk in tqdm(chunks, desc=label, unit="batch", leave=False):
        fits += recipe.fit(chunk, threads=torch.get_num_threads())
    return fits


@cache
def whole_breasts(folder: Path) -> list[Scan]:
    """The clean breasts with all their points."""
    paths = find_scans([folder / "breasts"])
    return [load_scan(path, points=None, outliers=None) for path in tqdm(paths, desc="loading", leave=False)]


def rescan(scan: Scan, seed: int, noise: float) -> Target:
    """A breast scanned anew: other points of it, with noise (standard deviation, mm, along each axis)."""
    random = np.random.default_rng([seed, sum(map(ord, scan.name))])
    count = min(POINTS, len(scan.points))
    points = scan.points[np.sort(random.choice(len(scan.points), count, replace=False))]
    points = points + noise * random.standard_normal(points.shape)
    weights = point_weights(points, scan.curve)
    return Target(
        f"{scan.name}, rescan {seed}", points, scan.wire, scan.neckline, scan.strap_point, scan.apex, None, weights
    )


def rescans_fitted(
    scans: Sequence[Scan], count: int, noise: float, recipe: Recipe, label: str
) -> list[tuple[list[Target], list[CupFit]]]:
    """The rescans of each breast and their fits."""
    targets = [[rescan(scan, seed, noise) for seed in range(count)] for scan in scans]
    fits = fits_of(recipe, [target for own in targets for target in own], label)
    return [(own, fits[k * count : (k + 1) * count]) for k, own in enumerate(targets)]


def dimensions(cuts: Sequence[Cut]) -> dict[str, np.ndarray]:
    """The dimensions of every cup's pieces as reports have them (mm; areas cm2), and its depth."""
    found = {", ".join(key): values for key, (values,) in piece_dimensions(Cups.of([cuts])).items()}
    return found | {"depth": np.array([float(cut.shape.edges[..., 2].max()) for cut in cuts])}


def edge_lengths(cuts: Sequence[Cut]) -> dict[str, np.ndarray]:
    """Of these the lengths of edges, and the depth."""
    sizes = ("width", "height", "area")
    return {name: values for name, values in dimensions(cuts).items() if not name.endswith(sizes)}


def deviations(measured: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Standard deviation of each dimension."""
    return {name: float(np.std(values, ddof=1)) for name, values in measured.items()}


@dataclass(frozen=True)
class Repeat:
    """What the rescans of a breast gave, mm.

    Attributes:
        rms: of the distances of the points, mean over the rescans.
        outlines: how far the outlines of each other rescan are from the first one's.
        spread: standard deviation of each dimension.
        edges: how the edges of the first rescan bend.
        needless: of all rescans, edges that bend to and fro more often than is asked.
        counted: how many edges there are, of all rescans.
        radius: the tightest of all rescans.
        upper_edge: largest distance of an upper edge from its neckline; nan without one.
        margin: the worst regularity margin.
        unsettled: fits that did not converge.
    """

    rms: float
    outlines: list[float]
    spread: dict[str, float]
    edges: Edges
    needless: list[Needless]
    counted: int
    radius: float
    upper_edge: float
    margin: float
    unsettled: int

    @staticmethod
    def of(targets: Sequence[Target], fits: Sequence[CupFit], condition: Conditions) -> Repeat:
        bends = [edges_of(target, fit, condition) for target, fit in zip(targets, fits, strict=True)]
        return Repeat(
            rms=float(np.mean([fit.figures["rms_mm"] for fit in fits])),
            outlines=[patterns_apart(fits[0], fit) for fit in fits[1:]],
            spread=deviations(edge_lengths(fits)),
            edges=bends[0],
            needless=[one for bend in bends for one in bend.needless],
            counted=sum(len(bend.counts) for bend in bends),
            radius=min(bend.radius for bend in bends),
            upper_edge=max(fit.figures["upper_edge_mm"] for fit in fits),
            margin=min(fit.figures["regularity_min"] for fit in fits),
            unsettled=sum(fit.code is not ResultCode.CONVERGED for fit in fits),
        )

    def __str__(self) -> str:
        spread = [*self.spread.values()]
        mark = f"  NOT CONVERGED: {self.unsettled} fits" if self.unsettled else ""
        return (
            f"{self.rms:5.2f}  {np.median(self.outlines):6.2f} {max(self.outlines):6.2f}   {np.median(spread):5.2f}"
            f" {max(spread):5.2f}   {self.radius:5.1f}  {self.upper_edge:5.2f}  {self.margin:6.3f}   {self.edges}{mark}"
        )


def report_outlines(options: Options) -> None:
    scans = whole_breasts(options.folder)
    wide = max(len(scan.name) for scan in scans)
    for noise in options.noise:
        for panels in options.panels:
            recipe = shipped(panels)
            label = f"{panels} panels, noise {noise:g} mm"
            print(
                f"\n{options.rescans} rescans of each breast, {label}. mm: RMS of the points; outlines off those of"
                " the first rescan (median, worst);\n  standard deviation of the dimensions (median, largest);"
                " tightest radius; upper edge off its neckline; regularity margin;\n  inflections of the first rescan:"
                " lower,upper edge of each piece from the wire up, the last on either side of the strap point"
            )
            rows = []
            for scan, own in zip(scans, rescans_fitted(scans, options.rescans, noise, recipe, label), strict=True):
                rows.append(Repeat.of(*own, recipe.condition))
                print(f"  {scan.name:{wide}} {rows[-1]}")
                for words in sorted({str(one) for one in rows[-1].edges.needless}):
                    print(f"      {words}")
            print(f"  {label}: {_summary(rows)}", flush=True)


def _summary(rows: Sequence[Repeat]) -> str:
    outlines, spreads = [row.outlines for row in rows], [[*row.spread.values()] for row in rows]
    edges, unsettled = [row.edges for row in rows], sum(row.unsettled for row in rows)
    needless, counted = [one for row in rows for one in row.needless], sum(row.counted for row in rows)
    facts = [
        f"outlines {_median_of_medians(outlines):.2f} mm (median of the medians), worst {max(map(max, outlines)):.2f}",
        f"most inflections: wire edge {max(e.wire for e in edges)}, ridge edges {max(e.ridges for e in edges)},"
        f" upper edge {max(e.upper_excess for e in edges):+d} to the neckline's",
        f"{len(needless)} of {counted} edges bend to and fro more often than asked, at most"
        f" {max((one.depth for one in needless), default=0.0):.2f} mm deep",
        f"tightest radius {min(row.radius for row in rows):.1f} mm",
        f"RMS {np.median([row.rms for row in rows]):.3f} mm (median)",
        f"standard deviation of the dimensions {_median_of_medians(spreads):.2f} mm (median of the medians), largest"
        f" {max(map(max, spreads)):.2f}",
        f"upper edge at most {max(row.upper_edge for row in rows):.2f} mm off",
        f"least margin {min(row.margin for row in rows):.3f}",
        f"NOT CONVERGED: {unsettled} fits" if unsettled else "all fits converged",
    ]
    return "; ".join(facts)


def _median_of_medians(groups: Sequence[Sequence[float]]) -> float:
    return float(np.median([np.median(group) for group in groups]))


def report_simulated(options: Options) -> None:
    print("\nsimulated scans of whole torsos: mm between the outlines of their patterns and the clean breast's")
    pairs = simulated(options.folder)
    targets = [target_of(load_scan(path)) for which in (0, 1) for path in (pair[which] for pair in pairs)]
    away = {}
    for panels in options.panels:
        fits = fits_of(shipped(panels), targets, f"{panels} panels")
        away[panels] = [patterns_apart(a, b) for a, b in zip(fits[: len(pairs)], fits[len(pairs) :], strict=True)]
    for k, (path, breast) in enumerate(pairs):
        values = ", ".join(f"{panels} panels {away[panels][k]:.2f}" for panels in options.panels)
        print(f"  {path.stem} (of {breast.stem}): {values}")
    for panels, values in away.items():
        print(f"  {panels} panels: median {np.median(values):.2f}, worst {max(values):.2f}", flush=True)


def report_deviation(options: Options) -> None:
    print(
        f"\nstandard deviations over {DEVIATION_RESCANS} rescans (noise {DEVIATION_NOISE:g} mm) and as the fits predict"
        " them (median over the rescans), mm and cm2"
    )
    scans = [scan for scan in whole_breasts(options.folder) if {scan.name, "all"} & {*options.breasts}]
    everything: list[float] = []
    for panels in options.panels:
        label = f"{panels} panels"
        ratios: list[float] = []
        outlines = []
        repeats = rescans_fitted(scans, DEVIATION_RESCANS, DEVIATION_NOISE, shipped(panels), label)
        for scan, (_, fits) in zip(scans, repeats, strict=True):
            print(f"  {scan.name}, {label}: seen, predicted, predicted / seen")
            ratios += _print_deviations(fits)
            outlines.append((outline_deviation(fits), _predicted_outline(fits)))
            print(
                "    {:34} {:7.3f} {:9.3f} {}".format(
                    "outline, at its worst place", *outlines[-1], _over(*outlines[-1])
                )
            )
        seen, predicted = np.max(outlines, axis=0)
        print(
            f"  {label}: {_share(ratios)}; outline at its worst place: seen up to {seen:.2f} mm, predicted up to"
            f" {predicted:.2f} mm",
            flush=True,
        )
        everything += ratios
    print(f"  all: {_share(everything)}")


def _print_deviations(fits: Sequence[CupFit]) -> list[float]:
    """A line for each dimension; the ratios of those that are not given."""
    seen = deviations(dimensions(fits))
    foretold = [row for fit in fits if (row := predicted_deviations(fit))]
    ratios = []
    for name, value in seen.items():
        guess = float(np.median([row[name] for row in foretold])) if foretold else np.nan
        print(f"    {name:34} {value:7.3f} {guess:9.3f} {_over(value, guess)}")
        if foretold and max(value, guess) > HELD:
            ratios.append(guess / max(value, 1e-12))
    return ratios


def predicted_deviations(fit: CupFit) -> dict[str, float]:
    """The standard deviation that a fit predicts of each dimension; empty if it predicts none."""
    if not fit.alternatives:
        return {}
    measured = dimensions([fit, *fit.alternatives])
    return {name: float(np.linalg.norm(values[1:] - values[0])) for name, values in measured.items()}


def _predicted_outline(fits: Sequence[CupFit]) -> float:
    values = np.array([fit.figures["outline_sd_mm"] for fit in fits])
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _over(seen: float, predicted: float) -> str:
    if not np.isfinite(predicted) or max(seen, predicted) <= HELD:
        return "     -"
    return f"{predicted / max(seen, 1e-12):6.2f}"


def _share(ratios: Sequence[float]) -> str:
    if not ratios:
        return "nothing predicted"
    close = np.mean([1 / CLOSE <= ratio <= CLOSE for ratio in ratios])
    return (
        f"{100 * close:.0f} % of {len(ratios)} dimensions predicted within a factor of {CLOSE:g} (ratio"
        f" {min(ratios):.2f} to {max(ratios):.2f}, median {np.median(ratios):.2f})"
    )


def outline_deviation(fits: Sequence[CupFit]) -> float:
    """RMS distance (mm) of the fits' outlines from their mean, at the place where it is largest.

    Each piece is laid on the mean outline as a rigid motion fits best.
    """
    worst = 0.0
    for edges in zip(*(fit.panels for fit in fits), strict=True):
        outlines = [
            np.concatenate([evenly_spaced(edge.numpy(), ALONG) for edge in (panel.lower, panel.upper)])
            for panel in edges
        ]
        mean = outlines[0]
        for _ in range(2):  # the mean of outlines laid on the first, then of those laid on the mean
            outlines = [_laid_on(outline, mean) for outline in outlines]
            mean = np.mean(outlines, axis=0)
        for part in (slice(None, ALONG), slice(ALONG, None)):
            away = np.array([distances(mean[part], outline[part]) for outline in outlines])
            worst = max(worst, float(np.sqrt((away**2).mean(axis=0)).max()))
    return worst


def _laid_on(outline: np.ndarray, other: np.ndarray) -> np.ndarray:
    """A flat outline, moved so that its points are nearest to the other's."""
    middle, aim = outline.mean(axis=0), other.mean(axis=0)
    p, q = ((points @ (1, 1j)) for points in (outline - middle, other - aim))
    turned = p * np.exp(1j * np.angle(np.vdot(p, q)))
    return np.stack([turned.real, turned.imag], axis=1) + aim


PARTS: dict[str, Callable[[Options], None]] = {
    "outlines": report_outlines,
    "simulated": report_simulated,
    "deviation": report_deviation,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with breasts/ and scans/")
    parser.add_argument("--only", default=",".join(PARTS), help="parts, with commas")
    parser.add_argument("--noise", default="0.5,1.0", help="outlines: noise of the rescans, mm, with commas")
    parser.add_argument("--rescans", type=int, default=5, help="outlines: rescans of each breast")
    parser.add_argument("--panels", default="2,3", help="numbers of panels, with commas")
    parser.add_argument(
        "--breasts", default="anny_01,anny_04,anny_09,vhf_skin", help="deviation: breasts, with commas, or all"
    )
    given = parser.parse_args()
    wanted = wanted_parts(parser, given.only, PARTS)
    if given.rescans < 2:
        parser.error("--rescans: at least 2, the first is what the others are compared with")
    try:
        noise = tuple(float(value) for value in given.noise.split(","))
        panels = tuple(int(value) for value in given.panels.split(","))
    except ValueError as error:
        parser.error(f"--noise, --panels: {error}")
    options = Options(given.folder, noise, given.rescans, panels, tuple(given.breasts.split(",")))
    there = {path.stem for path in (given.folder / "breasts").glob("*")}
    missing = [name for name in options.breasts if name != "all" and name not in there]
    if missing and "deviation" in wanted:
        parser.error(f"--breasts: no {', '.join(missing)} in {given.folder / 'breasts'}")
    for name in wanted:
        PARTS[name](options)


if __name__ == "__main__":
    main()
