"""From a scan to its pattern in Python: what `brafit SCAN` does, and some of what it finds.

    python examples/scan_to_pattern.py [SCAN] [OUT] [key=value ...]

SCAN is a cloud with its landmark file beside it (default: a bundled one); settings are those of the command, such as
cup.panels=3. Prints how close the cup is to the points, what is uncertain, and the lengths of all sewing lines; OUT
(runs/scan_to_pattern) gets the patterns, the cup in 3D and a report.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import brafit
from brafit.samples import sample_paths


def main(scan: Path, out: Path, settings: Sequence[str]) -> None:
    result = brafit.fit(scan, settings=settings)
    figures, pattern = result.figures, result.patterns()
    print(f"{scan.stem}: RMS {figures['rms_mm']:.2f} mm, 95 % of the points within {figures['p95_mm']:.2f} mm")
    for words in (*result.fit.warnings, *pattern.warnings):
        print(f"  warning: {words}")
    for piece in pattern.pieces:
        print(f"  {piece.name}: " + ", ".join(f"{line.name} {line.length:.1f} mm" for line in piece.sew))
    vertices = np.concatenate([panel.vertices for panel in result.surface()])  # in the scan's own frame
    print(f"  the cup spans {np.ptp(vertices, axis=0).round(1).tolist()} mm along the scan's axes")
    files = result.save(out)
    print(f"  {len(files)} files in {out}, such as {min(file.name for file in files)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("scan", nargs="?", type=Path, default=sample_paths()[1])
    parser.add_argument("out", nargs="?", type=Path, default=Path("runs/scan_to_pattern"))
    parser.add_argument("settings", nargs="*", metavar="key=value")
    main(**vars(parser.parse_args()))
