"""The command `brafit-nest`: the patterns of several scans or sizes in one drawing.

SVG, DXF and PDF at true size. Each scan has its own layer and colour; pieces of the same name lie on one another, as in
a graded nest.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from brafit.cli.ending import end_with
from brafit.cli.nesting import nesting_arguments
from brafit.cli.status import ALL_OK, SOME_FAILED
from brafit.errors import BrafitError, ConfigError
from brafit.naming import shown, told_apart


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script; exit status as `brafit`'s."""
    options = _parser().parse_args(arguments)
    end_with("brafit-nest", lambda: _run(options), "files")


def _parser() -> argparse.ArgumentParser:
    description = (__doc__ or "").split("\n\n")[1]
    parser = argparse.ArgumentParser(prog="brafit-nest", description=description, parents=[nesting_arguments()])
    parser.add_argument("--out", type=Path, default=Path("nest"), help="folder of patterns.svg, .dxf and .pdf (nest)")
    return parser


def _run(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from brafit.run.folder import make_writable
    from brafit.run.store import refuse_taken
    from brafit.sizing.cloth import check_thickness, cloth_notes
    from brafit.sizing.drawing import write_nest
    from brafit.sizing.nest import nested
    from brafit.sizing.stored import fit_folders, pattern_of, read_fits, shape_of
    from brafit.sizing.units import cup_words, unit_of

    folders = fit_folders(options.results)
    refuse_taken(options.out)
    make_writable(options.out)
    refused: list[BrafitError] = []

    def refuse(error: BrafitError) -> None:
        refused.append(error)
        tqdm.write(f"failed: {error}", file=sys.stderr)

    fits, failed = read_fits(folders, refuse)
    if options.align != "none":
        check_thickness(fits)
    names = dict(zip(folders, told_apart(folders), strict=True))
    unit, notes = unit_of(fits, options.units) if fits else ("mm", [])
    patterns, about = [], []
    for fit in tqdm(sorted(fits, key=lambda fit: fit.wire_length), "patterns", unit="scan", disable=None, leave=False):
        try:
            patterns.append(pattern_of(fit, names[fit.folder], options.pair, units=unit))
            about.append(cup_words(shape_of(fit), patterns[-1].options))
        except BrafitError as error:
            refuse(error)
    if not patterns:
        raise ConfigError("there is no good fit in these folders: fit the scans first")
    notes += [f"{failed} scan{'s' * (failed > 1)} whose fit failed left out"] * bool(failed)
    nest = nested(patterns, options.align, about)
    for words in [*notes, *cloth_notes(fits), *(f"warning: {words}" for words in nest.warnings)]:
        print(words, file=sys.stderr)
    sides = f"drawn for the left breast{' and the right one' * options.pair}"
    title = f"{len(patterns)} pattern{'s' * (len(patterns) > 1)}"
    write_nest(options.out, nest, title, sides)
    print(f"{title}, {sides}: {shown(str(options.out))}/patterns.svg, .dxf, .pdf")
    return SOME_FAILED if refused or failed else ALL_OK


if __name__ == "__main__":
    main()
