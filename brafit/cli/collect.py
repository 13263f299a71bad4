"""The command `brafit-collect`: one table over the folders of runs, such as the shards of a dataset."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from brafit.cli.ending import end_with
from brafit.cli.status import ALL_OK
from brafit.run.closing import closing
from brafit.run.collect import collect


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script: exit status 0, or 2 if there is nothing to collect."""
    parser = argparse.ArgumentParser(
        prog="brafit-collect",
        description="Write summary.csv, summary.parquet and index.html over all scans in folders of results.",
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", help="folder of a run, such as of one shard of a dataset")
    parser.add_argument("--out", metavar="DIR", help="where the table goes; the first folder if not given")
    given = parser.parse_args(arguments)

    def collected() -> int:
        print(closing(collect(given.folders, given.out), given.out or given.folders[0]))
        return ALL_OK

    end_with("brafit-collect", collected, "files")


if __name__ == "__main__":
    main()
