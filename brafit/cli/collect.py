"""The command `brafit-collect`: the table of a run anew, or one table over several runs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from brafit.cli.ending import end_with
from brafit.cli.status import ALL_OK
from brafit.naming import shown
from brafit.run.closing import closing
from brafit.run.collect import FILES, collect


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script: exit status 0, or 2 if there is nothing to collect."""
    parser = argparse.ArgumentParser(
        prog="brafit-collect",
        description="Write summary.csv, summary.parquet and index.html over all scans in folders of results. "
        "Of one run, or of shards that share a folder, they are made anew in that folder. Of several runs they need a "
        "folder of their own, and the first column tells which run a row is of.",
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", help="folder of a run, or of its shards")
    parser.add_argument("--out", metavar="DIR", help="where the table goes; needed with several folders")
    given = parser.parse_args(arguments)

    def collected() -> int:
        out = Path(given.out or given.folders[0])
        print(closing(collect(given.folders, given.out), out))
        print(f"Written: {shown(', '.join(str(out / file) for file in FILES))}")
        return ALL_OK

    end_with("brafit-collect", collected, "files")


if __name__ == "__main__":
    main()
