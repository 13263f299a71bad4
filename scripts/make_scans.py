"""Make a data set of parametric bodies: `python scripts/make_scans.py --count 20 --out DIR`.

Bodies come from the package `anny` (the extra `bodies`: pip install 'brafit[bodies]'), whose shape data are CC0. Each
becomes a simulated scan of the torso (`brafit.scan.scanner`), with noise, outliers, holes and shadows as asked, and a
landmark file whose landmarks are proposed from the clean body: look at them with brafit-inspect.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from brafit.atomic import write_bytes, write_text
from brafit.errors import BrafitError
from brafit.scan import landmarks_text, proposed_landmarks
from brafit.scan.mesh import sample_faces
from brafit.scan.ply import cloud_ply
from brafit.scan.scanner import Scanner, simulate

RANGES = {
    "age": (0.6, 0.95),
    "weight": (0.3, 0.75),
    "height": (0.3, 0.7),
    "muscle": (0.4, 0.6),
    "proportions": (0.4, 0.7),
    "cupsize": (0.3, 0.95),
    "firmness": (0.3, 0.9),
}
"""Where the shape parameters of adult women are drawn from."""
TORSO, HALF_WIDTH = (0.58, 0.88), 260.0
"""The part of the body's height, and the distance from the midline (mm), that are kept."""
DENSE = 200_000


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=10, help="bodies (10)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scans")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=60_000, help="points of a scan (60000)")
    parser.add_argument("--noise", type=float, default=0.3, help="standard deviation, mm (0.3)")
    parser.add_argument("--outliers", type=float, default=0.01, help="share of stray points (0.01)")
    parser.add_argument("--holes", type=int, default=0, help="round holes of 8 to 20 mm radius (0)")
    parser.add_argument("--high", action="store_true", help="cameras above only: shadow under the breast")
    options = parser.parse_args()
    model = bodies()
    for k in range(options.count):
        random = np.random.default_rng((options.seed, k))
        vertices, faces, parameters = torso(model, random)
        name = f"body_{k + 1:04d}"
        dense = sample_faces(vertices, faces, DENSE)
        marks = proposed_landmarks(options.out / f"{name}.ply", dense)
        cameras = Scanner.directions(0.8, 0.0) if options.high else Scanner.directions(0.4, 0.3)
        scanner = Scanner(cameras, options.points, options.noise, options.outliers, options.holes)
        cloud = simulate(vertices, faces, scanner, random)
        write_bytes(options.out / f"{name}.ply", cloud_ply(cloud))
        write_text(options.out / f"{name}.json", landmarks_text(marks))
        shown = ", ".join(f"{key} {value:.2f}" for key, value in parameters.items())
        print(f"{options.out / name}.ply: {shown}")


def bodies() -> Any:
    """The model of bodies.

    Raises:
        BrafitError: anny is not installed.
    """
    try:
        import anny  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise BrafitError("anny, which makes the bodies, is missing. Run: pip install 'brafit[bodies]'") from None
    return anny.create_fullbody_model(all_phenotypes=True, triangulate_faces=True)


def torso(model: Any, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Vertices (mm; x to the wearer's left, y up, z to the front) and triangles of a torso, and its parameters."""
    import torch

    parameters = {key: float(random.uniform(*limits)) for key, limits in RANGES.items()}
    with torch.no_grad():
        body = model(phenotype_kwargs={"gender": 1.0, **parameters})["vertices"][0].double().cpu().numpy()
    # anny has metres, z up and y to the back.
    vertices = 1000.0 * np.stack([body[:, 0], body[:, 2], -body[:, 1]], axis=1)
    faces = model.faces.cpu().numpy()
    used = np.unique(faces)
    height = vertices[:, 1]
    low = height[used].min()
    share = (height - low) / (height[used].max() - low)
    kept = (share > TORSO[0]) & (share < TORSO[1]) & (np.abs(vertices[:, 0]) < HALF_WIDTH)
    faces = faces[kept[faces].all(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3), parameters


if __name__ == "__main__":
    main()
