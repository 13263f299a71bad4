"""The table of a run, read and summed up: python examples/read_results.py RESULTS

Prints how many scans are ok, two medians over these, and the reasons of those that failed.
"""

import sys
from statistics import median

from pyarrow.parquet import read_table

rows = read_table(f"{sys.argv[1]}/summary.parquet").to_pylist()
good = [row for row in rows if row["status"] == "ok"]
print(f"{len(good)} of {len(rows)} scans ok")
for key in ("rms_mm", "seam_to_apex_mm"):
    values = [row[key] for row in good if row[key] is not None]  # None: there is no such number
    print(f"{key}: " + (f"median {median(values):.2f}" if values else "none"))
for row in rows:
    if row["status"] != "ok":
        print(f"{row['scan']}: {row['reason']}")
