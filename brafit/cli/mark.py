"""The command `brafit-mark`: pages on which scans are marked by hand.

For each scan one page that works offline: wire, neckline and landmarks are dragged over its surface, and saved as the
landmark file that `brafit` reads. `index.html` shows what is done.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from brafit.cli.ending import end_with, in_options
from brafit.cli.status import ALL_OK, NOTHING_RAN, SOME_FAILED
from brafit.errors import BrafitError
from brafit.landmarks.file import SIDES
from brafit.landmarks.units import MILLIMETRES
from brafit.marking.index import Entry
from brafit.naming import folded, shown
from brafit.scan.discovery import find_scans, numbered, scan_names

INDEX = "index.html"


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script; exit status as `brafit`'s."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if mistaken := [text for text in options.scans if "=" in text and not Path(text).exists()]:
        parser.error(f"{mistaken[0]}: takes no settings; --side, --units")
    end_with("brafit-mark", lambda: _run(options), "pages")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="brafit-mark", description=(__doc__ or "").split("\n\n")[1])
    parser.add_argument("scans", nargs="+", help="files, folders or patterns; in folders also scans without landmarks")
    parser.add_argument("--out", type=Path, default=Path("marking"), help="folder of the pages (marking)")
    parser.add_argument("--side", choices=SIDES, help="the only breast to be marked; default: all that a scan holds")
    parser.add_argument("--units", choices=tuple(MILLIMETRES), help="of the scans; default: found")
    return parser


def _run(options: argparse.Namespace) -> int:
    from tqdm import tqdm

    from brafit.marking.index import write_index

    paths = find_scans(options.scans, propose=True)
    entries: list[Entry] = []
    names = page_names(paths)
    for name, path in tqdm(zip(names, paths, strict=True), total=len(paths), unit="scan", disable=None, leave=False):
        try:
            entries.append(write_page(path, name, options.out, options.side, options.units))
        except BrafitError as error:
            tqdm.write(f"failed: {in_options(error)}", file=sys.stderr)
            entries.append(Entry(name, None, "", in_options(error)))
    write_index(options.out / INDEX, entries)
    done = sum(entry.file is not None for entry in entries)
    index = shown(str(options.out / INDEX))
    todo = f": open {index} in a browser" if done else f"; the reasons are above, and in {index}"
    print(f"{done} of {len(entries)} scans can be marked{todo}")
    return ALL_OK if done == len(entries) else SOME_FAILED if done else NOTHING_RAN


def page_names(paths: Sequence[Path]) -> list[str]:
    """A name for each scan, no two alike, and none like that of the page over all."""
    taken = folded(Path(INDEX).stem)
    return numbered([f"scan_{name}" if folded(name) == taken else name for name in scan_names(paths)])


def write_page(path: Path, name: str, out: Path, side: str | None = None, units: str | None = None) -> Entry:
    """Write the page of one scan into a folder; gives its line of the page over all.

    Args:
        path: the scan.
        name: of the scan and of its page's file.
        out: the folder.
        side: the only breast to be marked; None: all that it may hold.
        units: of the scan, where they are said.

    Raises:
        InputError: one line naming file, cause and remedy.
    """
    from brafit.atomic import write_text
    from brafit.cloud import read_cloud
    from brafit.marking import marking_page

    made = marking_page(read_cloud(path), name, side, units)
    write_text(out / f"{name}.html", made.html)
    return Entry(name, f"{shown(name)}.html", made.key, made.start, made.done)


if __name__ == "__main__":
    main()
