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
from brafit.naming import shown


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

    from brafit.pattern.finish import warnings_of
    from brafit.run.folder import make_writable
    from brafit.scan.discovery import numbered
    from brafit.sizing.drawing import write_nest
    from brafit.sizing.nest import nested
    from brafit.sizing.stored import fit_folders, pattern_of, stored_fit

    folders = fit_folders(options.results)
    make_writable(options.out)
    names = numbered([folder.name for folder in folders])
    patterns, refused, failed = [], 0, 0
    for name, folder in tqdm(
        list(zip(names, folders, strict=True)), desc="patterns", unit="scan", disable=None, leave=False
    ):
        try:
            fit = stored_fit(folder)
            failed += fit is None
            patterns += [] if fit is None else [(fit.wire_length, pattern_of(fit, name, options.pair))]
        except BrafitError as error:
            refused += 1
            tqdm.write(f"failed: {error}", file=sys.stderr)
    if failed:
        print(f"{failed} scans whose fit failed are left out", file=sys.stderr)
    if not patterns:
        raise ConfigError("there is no good fit in these folders: fit the scans first")
    patterns.sort(key=lambda entry: entry[0])
    for words in warnings_of([pattern for _, pattern in patterns]):
        print(f"warning: {words}", file=sys.stderr)
    sides = f"drawn for the left breast{' and the right one' * options.pair}"
    title = f"{len(patterns)} pattern{'s' * (len(patterns) > 1)}"
    write_nest(options.out, nested([pattern for _, pattern in patterns], options.align), title, sides)
    print(f"{title}, {sides}: {shown(str(options.out))}/patterns.svg, .dxf, .pdf")
    return SOME_FAILED if refused or failed else ALL_OK


if __name__ == "__main__":
    main()
