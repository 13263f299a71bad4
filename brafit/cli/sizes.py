"""The command `brafit-sizes`: from the fits of many scans the few cups that serve all of them best.

The sizes are cups of scans, so their patterns are at hand. They are nested in one file, with a graded table, a table of
who wears which size and how well it serves her, and how well as many sizes by wire length alone would.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from brafit.cli.ending import end_with
from brafit.cli.nesting import nesting_arguments
from brafit.cli.status import ALL_OK, SOME_FAILED
from brafit.errors import BrafitError, ConfigError
from brafit.naming import shown

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray

    from brafit.cup.shape import CupShape
    from brafit.sizing.nest import Nest
    from brafit.sizing.service import Served, Sizes
    from brafit.sizing.stored import StoredFit

MOST = 12
"""Numbers of sizes that are compared, at least."""
LIMIT = 25_000
"""Fits at most: the distances of so many need 2.5 GB."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script; exit status as `brafit`'s."""
    options = _parser().parse_args(arguments)
    end_with("brafit-sizes", lambda: _run(options), "files")


def _parser() -> argparse.ArgumentParser:
    description = (__doc__ or "").split("\n\n")[1]
    parser = argparse.ArgumentParser(prog="brafit-sizes", description=description, parents=[nesting_arguments()])
    parser.add_argument("--sizes", type=int, default=8, help="how many (8)")
    parser.add_argument("--out", type=Path, default=Path("sizes"), help="folder of the results (sizes)")
    return parser


def _run(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from brafit.run.folder import make_writable
    from brafit.run.store import SIZES, refuse_taken
    from brafit.sizing.cloth import check_thickness, cloth_notes
    from brafit.sizing.stored import fit_folders, read_fits, surfaces_of
    from brafit.sizing.units import unit_of

    if options.sizes < 1:
        raise ConfigError(f"--sizes {options.sizes}: must be 1 or more")
    folders = fit_folders(options.results)
    refuse_taken(options.out, SIZES)
    make_writable(options.out)
    refused: list[BrafitError] = []

    def refuse(error: BrafitError) -> None:
        refused.append(error)
        tqdm.write(f"failed: {error}", file=sys.stderr)

    with tqdm(total=len(folders), desc="reading", unit="scan", disable=None, leave=False) as bar:
        fits, failed = read_fits(folders, refuse, bar.update)
    if len(fits) > LIMIT:
        raise ConfigError(f"{len(fits)} fits: more than {LIMIT} cannot be compared in memory; name fewer folders")
    with tqdm(total=len(fits), desc="cups", unit="cup", disable=None, leave=False) as bar:
        fits, surfaces = surfaces_of(fits, refuse, bar.update)
    if len(fits) < options.sizes:
        raise ConfigError(f"--sizes {options.sizes}: there are {len(fits)} good fits; ask for as many sizes or fewer")
    check_thickness(fits)
    notes = [f"{failed} scan{'s' * (failed > 1)} whose fit failed left out"] * bool(failed)
    notes += [f"{len(refused)} folder{'s' * (len(refused) > 1)} that cannot be used left out"] * bool(refused)
    unit, told = unit_of(fits, options.units)
    notes += [*told, *cloth_notes(fits)]
    print("\n".join([*notes, *_written(options, fits, surfaces, unit, notes)]))
    return SOME_FAILED if refused or failed else ALL_OK


def _written(
    options: argparse.Namespace,
    fits: Sequence[StoredFit],
    surfaces: Float[ndarray, "fits along across 3"],
    unit: str,
    notes: Sequence[str],
) -> list[str]:
    """Find the sizes and write all of it; gives the lines for the terminal."""
    from brafit.pattern.finish import warnings_of
    from brafit.sizing.nest import nested
    from brafit.sizing.page import write_page, write_tables
    from brafit.sizing.rows import far_wires, gaps, graded_rows, member_rows, size_names, size_rows
    from brafit.sizing.stored import pattern_of, shape_of
    from brafit.sizing.surface import point_areas
    from brafit.sizing.units import cup_words

    weights, points = point_areas(surfaces), surfaces.reshape(len(fits), -1, 3)
    found = _found(options.sizes, fits, points, weights)
    chosen = [fits[k] for k in found.medoids]
    shapes = [shape_of(fit) for fit in chosen]
    gap = gaps(found, shapes, points, weights)
    names = size_names(len(chosen))
    patterns = [pattern_of(fit, name, options.pair, name, unit) for fit, name in zip(chosen, names, strict=True)]
    sizes, graded = size_rows(found, fits, shapes, gap), graded_rows(found, fits, unit)
    title = f"{len(chosen)} size{'s' * (len(chosen) > 1)} of {len(fits)} cups"
    about = [cup_words(shape, pattern.options) for shape, pattern in zip(shapes, patterns, strict=True)]
    nest = nested(patterns, options.align, about)
    _draw(options, title, nest, shapes, sizes, found)
    write_tables(options.out, sizes, member_rows(found, fits, gap), graded, found)
    several = "size " * (len(patterns) > 1)  # else warnings do not begin with the size's name
    warnings = [*nest.unlike, *far_wires(found, fits), *(f"{several}{words}" for words in warnings_of(patterns))]
    write_page(options.out, title, sizes, graded, found, notes, warnings)
    return [
        *(f"warning: {words}" for words in warnings),
        *_summary(found, sizes, about),
        f"Results: {shown(str(options.out / 'index.html'))}",
    ]


def _found(
    count: int,
    fits: Sequence[StoredFit],
    points: Float[ndarray, "fits places 3"],
    weights: Float[ndarray, " places"],
) -> Sizes:
    """The sizes."""
    import numpy as np
    from tqdm import tqdm

    from brafit.sizing.distance import distance_matrix, population
    from brafit.sizing.service import sizes_for

    total, most = len(fits), min(len(fits), max(MOST, count))
    with tqdm(total=total * total, desc="comparing", unit="pair", unit_scale=True, disable=None, leave=False) as bar:
        distances = distance_matrix(population(points, weights), bar.update)
    lengths, wires = np.array([fit.wire_length for fit in fits]), [fit.wire_name for fit in fits]
    with tqdm(total=most, desc="sizes", unit="size", disable=None, leave=False) as bar:
        return sizes_for(distances, lengths, wires, count, most, lambda _: bar.update())


def _draw(
    options: argparse.Namespace,
    title: str,
    nest: Nest,
    shapes: Sequence[CupShape],
    sizes: Sequence[Mapping[str, Any]],
    found: Sizes,
) -> None:
    """Write the nest and the pictures."""
    from brafit.report.figures import save_figure
    from brafit.sizing.drawing import write_nest
    from brafit.sizing.picture import cups_figure, served_figure

    sides = f"drawn for the left breast{' and the right one' * options.pair}; sizes by length of the wire"
    write_nest(options.out, nest, title, sides)
    captions = [
        f"{layer.about}, {_members(row)}".replace(", ", "\n") for layer, row in zip(nest.layers, sizes, strict=True)
    ]
    cups = cups_figure([shape.edges.numpy() for shape in shapes], nest.layers, captions)
    served = served_figure(found.steps, len(sizes))
    for suffix in ("svg", "png"):
        save_figure(cups, options.out / f"cups.{suffix}")
        save_figure(served, options.out / f"served.{suffix}")


def _members(row: Mapping[str, Any]) -> str:
    return f"{row['members']} member{'s' * (row['members'] != 1)}"


def _summary(found: Sizes, sizes: Sequence[Mapping[str, Any]], about: Sequence[str]) -> list[str]:
    from brafit.sizing.service import NEAR

    step = found.steps[len(sizes) - 1]
    best, wires = step.sizes.served, step.wire_groups.served
    lines = [
        f"size {row['size']}: {row['scan']}, {_members(row)}, mean {row['mean_mm']:.1f} mm, {words}"
        for row, words in zip(sizes, about, strict=True)
    ]

    def told(one: Served) -> str:
        return f"mean {one.mean:.1f} mm, 95 % below {one.p95:.1f} mm, {100 * one.near:.0f} % within {NEAR:g} mm"

    return [
        *lines,
        f"{best.count} size{'s' * (best.count > 1)}: {told(best)}",
        f"as many groups by wire length: {told(wires)}",
    ]


if __name__ == "__main__":
    main()
