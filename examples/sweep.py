"""A sweep over settings, and its table read back: what one more panel or fairer edges cost.

    python examples/sweep.py [OUT] [key=value,value ...]

Fits the bundled scans once for every combination of cup.panels=2,3 and condition.fairness=1,4, or of what is given,
into OUT (runs/sweep). Prints two medians over the scans for each combination: of the RMS, and of how far another scan
of the same breast would move the pattern where it moves most.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from pyarrow.parquet import read_table


def main(out: Path, settings: Sequence[str]) -> None:
    settings = settings or ["cup.panels=2,3", "condition.fairness=1,4"]
    status = subprocess.run([sys.executable, "-m", "brafit", "-m", *settings, f"out={out}"], check=False).returncode
    if status > 1:  # 1: some scans failed; the others are in the table
        sys.exit(status)
    table = read_table(out / "sweep.parquet")
    swept = [text.partition("=")[0] for text in settings if text.partition("=")[0] in table.column_names]
    jobs = defaultdict(list)
    for row in table.to_pylist():
        jobs[tuple(row[key] for key in swept)].append(row)
    for values, rows in jobs.items():
        job = ", ".join(f"{key}={value}" for key, value in zip(swept, values, strict=True))
        good = [row for row in rows if row["status"] == "ok"]
        print(f"{job}: {len(good)} of {len(rows)} scans ok")
        for key in ("rms_mm", "outline_sd_mm"):
            found = [row[key] for row in good if row[key] is not None]
            print(f"  {key}: " + (f"median {median(found):.3f}" if found else "none"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("runs/sweep"))
    parser.add_argument("settings", nargs="*", metavar="key=value,value")
    main(**vars(parser.parse_args()))
