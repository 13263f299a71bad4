"""Make the bundled scans from a folder of dense ones: `python scripts/make_samples.py FOLDER [--out DIR]`.

FOLDER holds NAME.ply and NAME.json of parametric bodies whose shape data are CC0-1.0; others are refused. Each cloud is
thinned evenly to 4,000 of its own points (inside and margin alike); landmark files are copied, without what only
concerns their making.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from brafit.atomic import write_bytes, write_text
from brafit.cloud import Cloud, read_cloud
from brafit.errors import InputError
from brafit.landmarks import landmarks_path, read_landmarks
from brafit.surface.thinning import uncrowd

NAMES = ("anny_01", "anny_04", "anny_09")
POINTS = 4000
KEPT = (
    "name",
    "units",
    "frame",
    "side",
    "landmarks",
    "wire",
    "upper_line",
    "measures",
    "source",
    "licence",
    "parameters",
)
VERTEX = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")] + [("inside", "u1")]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with the dense clouds and their landmark files")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "brafit" / "samples")
    arguments = parser.parse_args()
    for name in NAMES:
        make_sample(arguments.folder / f"{name}.ply", arguments.out)


def make_sample(source: Path, out: Path) -> None:
    """Write the thinned cloud and its landmark file into `out`."""
    marks = landmarks_path(source)
    read_landmarks(marks)
    landmarks = json.loads(marks.read_text(encoding="utf-8"))
    if "CC0" not in landmarks.get("licence", ""):
        raise InputError(marks, "licence: does not say CC0", "Bundle only scans that may be copied")
    data = ply(read_cloud(source), landmarks["licence"])
    text = json.dumps({key: landmarks[key] for key in KEPT if key in landmarks}, separators=(",", ":"))
    write_bytes(out / source.name, data)
    write_text(out / marks.name, text + "\n")
    print(f"{out / source.name}: {len(data) / 1000:.0f} kB")


def ply(cloud: Cloud, licence: str) -> bytes:
    """The thinned cloud as a binary PLY, in the order of its source."""
    if cloud.normals is None or cloud.inside is None:
        raise InputError(cloud.path, "has no normals or no flag 'inside'", "Use the dense clouds of single breasts")
    chosen = uncrowd(cloud.points, POINTS)
    vertices = np.empty(int(chosen.sum()), dtype=VERTEX)
    for i, name in enumerate(("x", "y", "z")):
        vertices[name] = cloud.points[chosen, i]
        vertices[f"n{name}"] = cloud.normals[chosen, i]
    vertices["inside"] = cloud.inside[chosen]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment units mm; x = wearer left, y = up, z = front",
        f"comment {licence}",
        "comment inside: 1 = within wire + upper line, 0 = margin",
        f"element vertex {len(vertices)}",
        *(f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in VERTEX),
        "end_header",
    ]
    return ("\n".join(header) + "\n").encode() + vertices.tobytes()


if __name__ == "__main__":
    main()
