"""How well sizes serve a population, and what time and memory ten thousand fits take.

    python scripts/make_scans.py --count 300 --points 15000 --accepted --out BODIES
    brafit BODIES out=RESULTS experiment=lean
    python scripts/check_sizes.py RESULTS --many 10000 --out DIR

For k = 1 to 12 sizes it compares the best sizes with as many groups by wire length: the error that `brafit-sizes` makes
least, and the gap, from the wearer's own cup to the nearest points of her size. With `--many` it writes so many fits,
each between two of RESULTS in parameters and wire with something of its own, and runs the command on them.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tqdm import trange

from brafit.atomic import write_text
from brafit.sizing.distance import distance_matrix, population
from brafit.sizing.page import curve_row
from brafit.sizing.service import Choice, sizes_for, worn
from brafit.sizing.stored import StoredFit, fit_folders, read_fits, shape_of, surfaces_of
from brafit.sizing.surface import point_areas

MOST = 12
OWN = 0.02
"""What the parameters of a made fit have of their own, as a share of their spread."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("results", type=Path, nargs="+", help="folders of runs")
    parser.add_argument("--many", type=int, default=0, help="fits to make and to find sizes of")
    parser.add_argument("--out", type=Path, default=Path("runs/check_sizes"), help="folder of these")
    options = parser.parse_args(arguments)
    folders = fit_folders(options.results)
    fits, failed = read_fits(folders, print)
    print(f"{len(folders)} scans, {len(fits)} good fits, {failed} failed")
    served(fits)
    if options.many:
        write_many(fits, options.many, options.out / "fits")
        command(options.out)


def served(fits: Sequence[StoredFit]) -> None:
    """Print a row for each number of sizes."""
    fits, surfaces = surfaces_of(fits, print)
    weights, points = point_areas(surfaces), surfaces.reshape(len(fits), -1, 3)
    begun = time.process_time()
    distances = distance_matrix(population(points, weights))
    lengths, wires = np.array([fit.wire_length for fit in fits]), [fit.wire_name for fit in fits]
    found = sizes_for(distances, lengths, wires, 1, min(MOST, len(fits)))
    print(f"wires {lengths.min():.0f} to {lengths.max():.0f} mm; {time.process_time() - begun:.1f} CPU s")
    heads = ("sizes", "mean", "95 %", "within 3 mm", "by wire: mean", "95 %", "within 3 mm", "chosen by wire: mean")
    print("|", " | ".join((*heads, "gap", "by wire: gap", "error of the groups over the best")), "|")
    for step in found.steps:
        values = list(curve_row(step).values())
        best, groups = (gap_of(choice, fits, points, weights) for choice in (step.sizes, step.wire_groups))
        least = step.sizes.served.mean  # 0 where everyone has a size of her own
        margin = step.wire_groups.served.mean / least if least else float("inf")
        shown = [f"{values[0]:.0f}", *(f"{v:.2f}" for v in (*values[1:8], best, groups, margin))]
        print("|", " | ".join(shown), "|", flush=True)
    print(f"by the nearest wire sold: {found.catalogue.served}")


def gap_of(
    choice: Choice,
    fits: Sequence[StoredFit],
    points: Float[ndarray, "n places 3"],
    weights: Float[ndarray, " places"],
) -> float:
    """Mean over all members of the gap's root mean square, mm."""
    total = 0.0
    for cup in np.unique(choice.cup):
        own = np.flatnonzero(choice.cup == cup)
        total += sum(one.rms for one in worn(shape_of(fits[cup]), points[cup], points[own], weights))
    return total / len(choice.cup)


def write_many(fits: Sequence[StoredFit], count: int, out: Path) -> None:
    """Folders with a fit.json each, of cups between those of the fits."""
    random = np.random.default_rng(0)
    same = [fit for fit in fits if fit.settings == fits[0].settings and fit.flat.shape == fits[0].flat.shape]
    spread = np.std([fit.flat for fit in same], axis=0)
    for k in trange(count, desc="making fits", disable=None, leave=False):
        one, other = (same[i] for i in random.integers(len(same), size=2))
        share = random.uniform()
        content = json.loads((one.folder / "fit.json").read_text(encoding="utf-8"))
        flat = (1 - share) * one.flat + share * other.flat + OWN * spread * random.standard_normal(len(spread))
        sizes = [np.size(value) for value in content["parameters"].values()]
        parts = np.split(flat, np.cumsum(sizes)[:-1])
        named = zip(content["parameters"].items(), parts, strict=True)
        content["parameters"] = {name: part.reshape(np.shape(old)).tolist() for (name, old), part in named}
        content["wire"] = {
            "mm_per_unit": (1 - share) * one.scale + share * other.scale,
            "series": ((1 - share) * one.series + share * other.series).tolist(),
        }
        content["scan"] = f"made_{k:05d}"
        write_text(out / content["scan"] / "fit.json", json.dumps(content))


def command(out: Path) -> None:
    """Run brafit-sizes on the made fits, and say what it took."""
    begun = time.monotonic()
    words = [
        sys.executable,
        "-m",
        "brafit.cli.sizes",
        str(out / "fits"),
        "--sizes",
        str(MOST),
        "--out",
        str(out / "sizes"),
    ]
    done = subprocess.run(words, check=False)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"exit status {done.returncode}, {time.monotonic() - begun:.0f} s, {used.ru_utime + used.ru_stime:.0f} CPU s, "
        f"at most {used.ru_maxrss / 2**20:.2f} GiB"
    )


if __name__ == "__main__":
    main()
