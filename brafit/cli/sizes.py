"""The command `brafit-sizes`: from the fits of many scans the few cups that serve all of them best.

The sizes are cups of scans, so their patterns are at hand: nested in one file, with a graded table, who wears which size
and how well it serves her, and how well the same number of sizes by wire length alone would.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from brafit.cli.status import ALL_OK, INTERRUPTED, NOTHING_RAN, SOME_FAILED
from brafit.errors import BrafitError, ConfigError
from brafit.naming import print_anything, shown

MOST = 12
"""Numbers of sizes that are compared, at least."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script; exit status as `brafit`'s."""
    options = _parser().parse_args(arguments)
    print_anything()
    try:
        sys.exit(_run(options))
    except KeyboardInterrupt:
        print("brafit-sizes: interrupted; nothing was written", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except (BrafitError, OSError) as error:
        print(f"brafit-sizes: {error}", file=sys.stderr)
        sys.exit(NOTHING_RAN)


def _parser() -> argparse.ArgumentParser:
    from brafit.sizing.nest import ALIGNS

    parser = argparse.ArgumentParser(prog="brafit-sizes", description=(__doc__ or "").split("\n\n")[1])
    parser.add_argument("results", nargs="+", metavar="RESULTS", help="folders of runs, or of scans in them")
    parser.add_argument("--sizes", type=int, default=8, help="how many (8)")
    parser.add_argument("--out", type=Path, default=Path("sizes"), help="folder of the results (sizes)")
    parser.add_argument("--align", choices=ALIGNS, default="apex", help="what lies on one point in the nest (apex)")
    parser.add_argument("--pair", action="store_true", help="draw the mirrored pieces, for the right breast, as well")
    return parser


def _run(options: argparse.Namespace) -> int:
    from brafit.run.folder import make_writable
    from brafit.sizing.stored import fit_folders, read_fits

    if options.sizes < 1:
        raise ConfigError(f"--sizes {options.sizes}: must be 1 or more")
    from tqdm import tqdm

    folders = fit_folders(options.results)
    make_writable(options.out)
    refused: list[BrafitError] = []

    def refuse(error: BrafitError) -> None:
        refused.append(error)
        tqdm.write(f"failed: {error}", file=sys.stderr)

    with tqdm(total=len(folders), desc="reading", unit="scan", disable=None, leave=False) as bar:
        fits, failed = read_fits(folders, refuse, bar.update)
    if len(fits) < options.sizes:
        raise ConfigError(f"--sizes {options.sizes}: there are {len(fits)} good fits; ask for as many sizes or fewer")
    notes = [f"{failed} scans whose fit failed are left out"] * bool(failed)
    notes += [f"{len(refused)} folders cannot be used and are left out"] * bool(refused)
    print(_written(options, fits, notes))
    return SOME_FAILED if refused else ALL_OK


def _written(options: argparse.Namespace, fits: Sequence, notes: Sequence[str]) -> str:
    """Find the sizes and write all of it; gives the words for the terminal."""
    import numpy as np
    from tqdm import tqdm

    from brafit.report.figures import save_figure
    from brafit.sizing.distance import distance_matrix, population
    from brafit.sizing.drawing import write_nest
    from brafit.sizing.nest import nested
    from brafit.sizing.page import write_page, write_tables
    from brafit.sizing.picture import cups_figure, served_figure
    from brafit.sizing.rows import gaps, graded_rows, member_rows, size_names, size_rows
    from brafit.sizing.service import sizes_for
    from brafit.sizing.stored import pattern_of, shape_of, surfaces_of
    from brafit.sizing.surface import point_areas

    count, total = options.sizes, len(fits)
    with tqdm(total=total, desc="cups", unit="cup", disable=None, leave=False) as bar:
        surfaces = surfaces_of(fits, bar.update)
    weights = point_areas(surfaces)
    points = surfaces.reshape(total, -1, 3)
    with tqdm(total=total * total, desc="comparing", unit="pair", unit_scale=True, disable=None, leave=False) as bar:
        distances = distance_matrix(population(points, weights), bar.update)
    most = min(total, max(MOST, count))
    with tqdm(total=most, desc="sizes", unit="size", disable=None, leave=False) as bar:
        lengths, wires = np.array([fit.wire_length for fit in fits]), [fit.wire_name for fit in fits]
        found = sizes_for(distances, lengths, wires, count, most, lambda _: bar.update())
    del distances
    names, chosen = size_names(count), [fits[k] for k in found.medoids]
    shapes = [shape_of(fit) for fit in chosen]
    gap = gaps(found, shapes, points, weights)
    sizes, graded = size_rows(found, fits, shapes, gap), graded_rows(found, fits)
    out, title = options.out, f"{count} size{'s' * (count > 1)} of {total} cups"
    patterns = [pattern_of(fit, name, options.pair) for fit, name in zip(chosen, names, strict=True)]
    nest = nested(patterns, options.align)
    write_nest(out, nest, title, f"drawn for the left breast{' and the right one' * options.pair}; sizes by wire length")
    captions = [f"wire {row['wire_mm']:.0f} mm, {row['members']} members" for row in sizes]
    cups = cups_figure([shape.edges.numpy() for shape in shapes], nest.layers, captions)
    for suffix in ("svg", "png"):
        save_figure(cups, out / f"cups.{suffix}")
        save_figure(served_figure(found.steps, count), out / f"served.{suffix}")
    write_tables(out, sizes, member_rows(found, fits, gap), graded, found)
    write_page(out, title, sizes, graded, found, notes)
    return "\n".join([*notes, *_summary(found, sizes), f"Results: {shown(str(out / 'index.html'))}"])


def _summary(found, sizes: Sequence) -> list[str]:  # noqa: ANN001
    step = found.steps[len(sizes) - 1]
    best, wires = step.sizes.served, step.wire_groups.served
    lines = [
        f"size {row['size']}: {row['scan']}, {row['members']} members, mean {row['mean_mm']:.1f} mm, wire {row['wire_mm']:.0f} mm"
        for row in sizes
    ]
    return [
        *lines,
        f"{best.count} sizes: mean {best.mean:.1f} mm, 95 % below {best.p95:.1f} mm, {best.near:.0%} within 3 mm",
        f"as many groups by wire length: mean {wires.mean:.1f} mm, 95 % below {wires.p95:.1f} mm, {wires.near:.0%} within 3 mm",
    ]


if __name__ == "__main__":
    main()
