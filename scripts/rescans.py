"""Rescans of the breasts of a folder: each with most of its points, drawn anew, and noise.

    python scripts/rescans.py FOLDER OUT --count 224      # 16 of each of 14 breasts

For datasets of any size that behave as scans do; `check_run.py` and `benchmark.py` make theirs with it.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import numpy as np
from tqdm import trange

from brafit.atomic import write_bytes
from brafit.cloud import read_cloud
from brafit.cloud.ply import cloud_ply
from brafit.landmarks import landmarks_path
from brafit.scan import find_scans

SHARE, NOISE = 0.8, 0.5
"""Share of the points that a rescan has, and the standard deviation (mm) of its noise in each coordinate."""


def write_rescans(folder: Path, out: Path, count: int) -> list[Path]:
    """Write so many rescans of the breasts in turn, PLY and landmark file; those that are there already stay."""
    clouds = [read_cloud(path) for path in find_scans([folder])]
    paths = []
    for k in trange(count, desc="rescans", leave=False, disable=None):
        cloud, number = clouds[k % len(clouds)], k // len(clouds)
        path = out / f"{cloud.path.stem}_{number:04d}.ply"
        paths.append(path)
        if path.exists():
            continue
        out.mkdir(parents=True, exist_ok=True)
        shutil.copy(landmarks_path(cloud.path), landmarks_path(path))
        rng = np.random.default_rng([k, 7])
        chosen = np.sort(rng.choice(len(cloud.points), round(SHARE * len(cloud.points)), replace=False))
        points = cloud.points[chosen] + NOISE * rng.standard_normal((len(chosen), 3))
        inside = None if cloud.inside is None else cloud.inside[chosen]
        write_bytes(path, cloud_ply(points, inside=inside))
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=224)
    given = parser.parse_args()
    write_rescans(given.folder, given.out, given.count)
