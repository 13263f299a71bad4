"""Make a data set of parametric bodies: `python scripts/make_scans.py --count 20 --out DIR`.

With `--spheres` it needs no body: each scan is a quarter sphere on a half-circle wire, the paper's Case (1), of random
radius and side, moved at random; its landmarks are exact.

Bodies come from the package `anny` (the extra `bodies`: pip install 'brafit[bodies]'), whose shape data are CC0. Each
becomes a simulated scan of the torso (`brafit.simulation.scanner`), with noise, outliers, holes and shadows as asked,
and a landmark file whose landmarks are proposed from the clean body: look at them with brafit-inspect.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from brafit.anatomy import proposed_landmarks
from brafit.atomic import write_bytes, write_text
from brafit.cloud.mesh import sample_faces
from brafit.cloud.ply import cloud_ply
from brafit.landmarks import Landmarks, landmarks_path, landmarks_text
from brafit.landmarks.file import SIDES
from brafit.simulation.bodies import KINDS, Bodies
from brafit.simulation.scanner import Scanner, holes, simulate
from brafit.simulation.synthetic import quarter_sphere

DENSE = 200_000
RADII = (50.0, 85.0)
"""Of the spheres, mm."""
APEX = np.radians(70)
"""How high above the wire's plane the spheres' bust point is, seen from the chord's middle. A quarter sphere is
farthest from that plane at 90 degrees, where the upper line and the strap point are; at 70 degrees it is 94 % as far,
and a breast at its bust point 92 to 99 %.
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=10, help="bodies (10)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scans")
    parser.add_argument("--first", type=int, default=1, help="number of the first: goes on with a set (1)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=60_000, help="points of a scan (60000)")
    parser.add_argument("--noise", type=float, default=0.3, help="standard deviation, mm (0.3)")
    parser.add_argument("--outliers", type=float, default=0.01, help="share of stray points (0.01)")
    parser.add_argument("--holes", type=int, default=0, help="round holes of 8 to 20 mm radius (0)")
    parser.add_argument("--high", action="store_true", help="cameras above only: shadow under the breast")
    parser.add_argument("--kind", choices=tuple(KINDS), default="plain", help="of body (plain: standing torsos)")
    parser.add_argument(
        "--accepted", action="store_true", help="landmarks pass as looked at: none is refused as doubtful"
    )
    parser.add_argument("--spheres", action="store_true", help="quarter spheres instead of bodies")
    options = parser.parse_args(arguments)
    model = None if options.spheres else Bodies()
    for k in range(options.first - 1, options.first - 1 + options.count):
        random = np.random.default_rng((options.seed, k))
        if options.spheres:
            name = f"sphere_{k + 1:04d}"
            cloud, marks, radius = sphere(options, options.out / f"{name}.ply", random)
            write_bytes(options.out / f"{name}.ply", cloud_ply(cloud))
            write_text(options.out / f"{name}.json", landmarks_text([marks]))
            print(f"{options.out / name}.ply: radius {radius:.1f} mm, {marks.side}")
            continue
        assert model is not None
        body = model.body(KINDS[options.kind], random)
        vertices, faces = body.vertices, body.faces
        name = f"body_{k + 1:04d}"
        dense = sample_faces(vertices, faces, DENSE)
        marks = proposed_landmarks(options.out / f"{name}.ply", dense)
        marks = [replace(own, proposed=False) for own in marks] if options.accepted else marks
        cameras = Scanner.directions(0.8, 0.0) if options.high else Scanner.directions(0.4, 0.3)
        scanner = Scanner(cameras, options.points, options.noise, options.outliers, options.holes)
        cloud = simulate(vertices, faces, scanner, random)
        write_bytes(options.out / f"{name}.ply", cloud_ply(cloud))
        write_text(options.out / f"{name}.json", landmarks_text(marks))
        shown = ", ".join(f"{key} {value:.2f}" for key, value in body.parameters.items())
        print(f"{options.out / name}.ply: {shown}")


def sphere(options: argparse.Namespace, path: Path, random: np.random.Generator) -> tuple[np.ndarray, Landmarks, float]:
    """A quarter sphere with the defects asked for, somewhere in space; its exact landmarks and its radius (mm)."""
    radius = float(random.uniform(*RADII))
    strays = round(options.outliers * options.points)
    exact = quarter_sphere(2 * options.points, radius, random).numpy()
    exact = exact[~holes(exact, options.holes, random)][: options.points - strays]
    measured = exact + options.noise * random.standard_normal(exact.shape)
    stray = random.uniform([-radius, -radius, -radius], [2 * radius, 3 * radius, 2 * radius], (strays, 3))
    angle = np.linspace(0, np.pi, 51)
    across, zero = 1 - np.cos(angle), 0 * angle
    wire = radius * np.stack([np.sin(angle), across, zero], axis=1)
    upper = radius * np.stack([zero, across, np.sin(angle)], axis=1)
    side = SIDES[int(random.integers(2))]
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn)) * (1.0 if side == "left" else -1.0)
    shift = random.uniform(-300, 300, 3)
    named = {"inner_end": wire[0], "outer_end": wire[-1], "wire_bottom": wire[25], "strap_point": upper[25]}
    named["apex"] = radius * np.array([np.cos(APEX), 1.0, np.sin(APEX)])
    marks = Landmarks(landmarks_path(path), path.stem, side, wire, upper, named, "mm")
    cloud = random.permutation(np.concatenate([measured, stray]))
    return cloud @ turn.T + shift, marks.mapped(lambda p: p @ turn.T + shift), radius


if __name__ == "__main__":
    main()
