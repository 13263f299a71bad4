"""Measures what becomes of scans before and in the fit: the scan figures in docs/figures.md come from one run.

    python scripts/check_scans.py FOLDER                     all parts
    python scripts/check_scans.py FOLDER --only given,wire   some parts

FOLDER holds `breasts/` (clean breasts with landmark files), `scans/` (simulated scans of whole torsos, whose landmark
file names the breast they were made of in scan.simulated_from) and `torsos/` (meshes named as the breasts). The parts:

    given       scans with their landmarks and wire, against the fit of the clean breast
    missing     the same from clean points where the scan has some, bridged like a scan
    wire        the wire detected, against the given one
    proposed    torsos without landmarks, against the given ones
    sides       left and right of symmetric bodies, and exact mirror images
    invariance  rigid motion, unit, order of the points, duplication
    noise       outliers and noise
    coverage    weights by the surface that a point stands for
    lines       necklines that are built, wires of a size
    damaged     a thousand damaged files
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from outlines import patterns_apart
from scipy.spatial import KDTree

from brafit.anatomy import proposed_landmarks
from brafit.cloud import read_cloud
from brafit.cup.shape import CupShape
from brafit.fitting import CupFit, Target
from brafit.geometry.order import along_curve
from brafit.geometry.polyline import evenly_spaced, polyline_length
from brafit.geometry.rigid import laid_on
from brafit.landmarks import Landmarks, landmarks_path, landmarks_text, read_landmarks
from brafit.report.uncovered import uncovered_share
from brafit.run.fitting import target_of
from brafit.run.recipe import recipe_of
from brafit.scan import Scan, load_scan
from brafit.simulation.synthetic import on_panels
from brafit.surface.gaps import gaps
from brafit.underwires.sizes import WireSize

PANELS = (2, 3)
RESTARTS = 3
COVERED = 5.0
"""A place of the cup has data if a point is nearer than this, mm."""


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def fitted(targets: Sequence[Target], panels: int) -> list[CupFit]:
    """Fits with the settings as they are shipped."""
    return replace(recipe_of([f"cup.panels={panels}"]), restarts=RESTARTS).fit(targets)


def drawn(points: np.ndarray, count: int = 2000) -> np.ndarray:
    """A random draw of points, in the order of a scan's."""
    chosen = points[np.random.default_rng(0).permutation(len(points))[:count]]
    return chosen[along_curve(chosen)]


def samples(shape: CupShape, count: int = 6000) -> np.ndarray:
    """Points uniform by area on a cup."""
    return on_panels(shape, count, np.random.default_rng(0)).numpy()


def apart(one: CupFit, other: CupFit, data: np.ndarray | None = None) -> tuple[float, float]:
    """RMS and largest distance (mm) of two fitted surfaces, the larger of both ways; where there are data, if given."""
    ways = []
    for a, b in ((one, other), (other, one)):
        places = samples(a.shape)
        if data is not None:
            places = places[KDTree(data).query(places)[0] < COVERED]
        distance = b.shape.distances(torch.from_numpy(places)).numpy()
        ways.append((rms(distance), float(np.abs(distance).max())))
    return max(way[0] for way in ways), max(way[1] for way in ways)


def line_apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances (mm) of a line's points, evenly spaced, from another line."""
    return KDTree(evenly_spaced(other, 2000)).query(evenly_spaced(one, 200))[0]


def simulated(folder: Path) -> list[tuple[Path, Path]]:
    """The scans and the clean breasts that they were made of."""
    pairs = []
    for path in sorted((folder / "scans").glob("*.ply")):
        made_of = json.loads(landmarks_path(path).read_text(encoding="utf-8"))["scan"]["simulated_from"]
        known = {"vhf": "vhf_skin", "lirbsm": "lirbsm_mean"}
        pairs.append((path, folder / "breasts" / f"{known.get(made_of, made_of)}.ply"))
    return pairs


def report_given(folder: Path, _: Path) -> None:
    pairs = simulated(folder)
    scans = [load_scan(path) for path, _ in pairs]
    clean = [load_scan(path) for _, path in pairs]
    whole = [load_scan(path, points=None, outliers=None) for _, path in pairs]
    for panels in PANELS:
        fits = fitted([target_of(scan) for scan in (*scans, *clean)], panels)
        print(
            f"\nscans as given, {panels} panels: mm RMS (largest) from the clean breast's fit where data are, anywhere;"
        )
        print("  RMS of the clean cloud: of the scan's fit, of the clean fit; share of the cup without data; outliers")
        for scan, dense, own, best in zip(scans, whole, fits[: len(scans)], fits[len(scans) :], strict=True):
            near, far = apart(own, best, scan.dense), apart(own, best)
            to_cloud = [rms(f.shape.distances(torch.from_numpy(dense.points)).numpy()) for f in (own, best)]
            steps = scan.cleaning
            print(
                f"  {scan.name:10} {near[0]:.2f} ({near[1]:.1f})  {far[0]:.2f} ({far[1]:.1f})   {to_cloud[0]:.2f}"
                f" {to_cloud[1]:.2f}   {100 * uncovered_share(own.shape, scan.dense):.1f} %"
                f"   {steps.outliers + steps.off_surface + steps.islands} of {steps.read - steps.elsewhere}"
            )


def report_missing(folder: Path, _: Path) -> None:
    print(
        "\nclean points where the scan has some too, bridged: mm RMS from the clean fit where data are, 2 and 3 panels"
    )
    pairs = simulated(folder)
    clean = [load_scan(path) for _, path in pairs]
    cut = []
    for (path, breast), scan in zip(pairs, clean, strict=True):
        whole, own = load_scan(breast, points=None, outliers=None), load_scan(path)
        near = KDTree(own.dense).query(whole.points)[0] < 3.0
        kept = drawn(whole.points[near])
        assumed = gaps(kept, own.dense, _there(scan.curve)).places
        cut.append((replace(scan, points=kept, dense=own.dense, assumed=assumed, spacing=None), 1 - float(near.mean())))
    for panels in PANELS:
        fits = fitted([target_of(scan) for scan in (*clean, *(scan for scan, _ in cut))], panels)
        for (scan, share), best, own in zip(cut, fits[: len(cut)], fits[len(cut) :], strict=True):
            near = apart(own, best, scan.dense)
            print(f"  {panels} panels {scan.name:10} {near[0]:.2f} ({near[1]:.1f}); {100 * share:.1f} % missing")


def report_wire(folder: Path, _: Path) -> None:
    print("\nwire detected from the other landmarks: mm RMS (largest) off the given one; share guessed; without ends:")
    paths = [path for path, _ in simulated(folder)]
    for path in [*paths, *sorted((folder / "torsos").glob("*.ply"))]:
        marks = read_landmarks(_marks_of(folder, path))
        found = []
        for names in ({*marks.points}, {"apex", "strap_point"}):
            some = replace(
                marks, wire=None, upper_line=None, points={k: v for k, v in marks.points.items() if k in names}
            )
            found.append(_wire_of(path, some))
        parts = []
        for wire, guessed in found:
            away = line_apart(wire, _there(marks.wire))
            parts.append(f"{rms(away):.2f} ({away.max():.1f}), {100 * (guessed or 0):.0f} %")
        print(f"  {path.stem:12} {parts[0]};  with apex and strap point only {parts[1]}")


def _there(line: np.ndarray | None) -> np.ndarray:
    assert line is not None
    return line


def _wire_of(path: Path, marks: Landmarks) -> tuple[np.ndarray, float | None]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "marks.json")
        file.write_text(landmarks_text([marks]), encoding="utf-8")
        scan = load_scan(path, wire="detect", landmarks=file)
    return scan.frame.to_scan(scan.wire), scan.origin.wire_guessed


def _marks_of(folder: Path, path: Path) -> Path:
    beside = landmarks_path(path)
    return beside if beside.is_file() else folder / "breasts" / f"{path.stem}.json"


def report_proposed(folder: Path, _: Path) -> None:
    print("\nlandmarks proposed, mm off the given: apex, inner end, outer end, strap point; wire RMS (largest)")
    for path in [*sorted((folder / "torsos").glob("*.ply")), *(path for path, _ in simulated(folder))]:
        given = read_landmarks(_marks_of(folder, path))
        found = next(m for m in proposed_landmarks(path, read_cloud(path).points) if m.side == given.side)
        away = [
            float(np.linalg.norm(found.points[name] - given.points[name]))
            for name in ("apex", "inner_end", "outer_end", "strap_point")
        ]
        wire = line_apart(_there(found.wire), _there(given.wire))
        print(f"  {path.stem:12} " + " ".join(f"{a:5.1f}" for a in away) + f"   {rms(wire):.1f} ({wire.max():.1f})")


def report_sides(folder: Path, _: Path) -> None:
    print(
        "\nleft and right of symmetric bodies: mm between patterns (vertices), between surfaces RMS; exact mirror image"
    )
    names = sorted((folder / "torsos").glob("anny*.ply"))
    names += [path for path, breast in simulated(folder) if breast.stem.startswith("anny")]
    for path, proposed in ((path, proposed) for path in names for proposed in (False, True)):
        left, right, exact = _sides_proposed(path) if proposed else _sides_given(path, _marks_of(folder, path))
        how = "proposed" if proposed else "given"
        for panels in PANELS:
            one, other, image = fitted([target_of(scan) for scan in (left, right, exact)], panels)
            print(
                f"  {path.stem:10} {how:8} {panels} panels {patterns_apart(one, other):.3f}"
                f"  {apart(one, other)[0]:.3f}   {patterns_apart(one, image):.1e}"
            )


def _sides_given(path: Path, marks: Path) -> list[Scan]:
    """The left and the right breast, and the mirror image of the left one, by the marks given of one."""
    return [*(load_scan(path, side=side, landmarks=marks) for side in ("left", "right")), _mirrored(path, marks)]


def _sides_proposed(path: Path) -> list[Scan]:
    """The same by marks proposed on each file, and each side loaded by itself."""
    cloud, nowhere = read_cloud(path), Path("no_marks.json")
    flipped = replace(cloud, points=cloud.points * np.array([-1.0, 1.0, 1.0]))
    sides = ((cloud, "left"), (cloud, "right"), (flipped, "right"))
    return [load_scan(own, side=side, landmarks=nowhere, propose=True) for own, side in sides]


def _mirrored(path: Path, marks: Path) -> Scan:
    """The exact mirror image of a scan and its landmarks, loaded as a right breast."""
    cloud, given = read_cloud(path), read_landmarks(marks)
    flip = np.array([-1.0, 1.0, 1.0])
    return _loaded(cloud.points * flip, given.mapped(lambda p: p * flip, side="right"))


def _loaded(points: np.ndarray, marks: Landmarks, **settings: Any) -> Scan:
    """A cloud and its marks, written to files and loaded."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "cloud.npy")
        np.save(path, points)
        landmarks_path(path).write_text(_exact_text(marks), encoding="utf-8")
        return load_scan(path, **settings)


def _exact_text(marks: Landmarks) -> str:
    """A landmark file without rounding."""
    data = {
        "side": marks.side,
        "wire": None if marks.wire is None else marks.wire.tolist(),
        "upper_line": None if marks.upper_line is None else marks.upper_line.tolist(),
        "landmarks": {name: point.tolist() for name, point in marks.points.items()},
    }
    return json.dumps({key: value for key, value in data.items() if value is not None})


def report_invariance(folder: Path, _: Path) -> None:
    print("\nchanges that must not matter: mm between patterns, 2 and 3 panels")
    random = np.random.default_rng(5)
    q = np.linalg.qr(random.standard_normal((3, 3)))[0]
    q *= np.sign(np.linalg.det(q))
    shift = np.array([210.0, -90.0, 400.0])
    for path in [simulated(folder)[0][0], simulated(folder)[-1][0]]:
        cloud, marks = read_cloud(path).points, read_landmarks(landmarks_path(path))
        order = random.permutation(len(cloud))
        whole = np.concatenate([cloud, cloud])
        cases: dict[str, tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]] = {
            "as it is": (cloud, lambda p: p),
            "moved and turned": (cloud @ q.T + shift, lambda p: p @ q.T + shift),
            "in metres": (cloud / 1000, lambda p: p / 1000),
            "in inches": (cloud / 25.4, lambda p: p / 25.4),
            "shuffled": (cloud[order], lambda p: p),
            "all points twice": (whole[random.permutation(len(whole))], lambda p: p),
        }
        scans = [_loaded(points, marks.mapped(function)) for points, function in cases.values()]
        fits = {panels: fitted([target_of(scan) for scan in scans], panels) for panels in PANELS}
        for k, name in enumerate(cases):
            away = ", ".join(f"{patterns_apart(fits[panels][0], fits[panels][k]):.1e}" for panels in PANELS)
            print(f"  {path.stem:10} {name:18} {away}")


def report_noise(folder: Path, _: Path) -> None:
    print("\noutliers and noise: mm RMS (largest) from the undisturbed fit where data are; patterns; own RMS; notes")
    for path in (simulated(folder)[0][0], simulated(folder)[0][1], simulated(folder)[-1][1]):
        cloud, marks = read_cloud(path), read_landmarks(landmarks_path(path))
        points = cloud.points if cloud.inside is None else cloud.points[cloud.inside]
        cases = {
            "as it is": (0.0, 0.0),
            "30 % outliers": (0.3, 0.0),
            "noise 2 mm": (0.0, 2.0),
            "both": (0.3, 2.0),
        }
        scans = [_loaded(disturbed(points, share, noise), marks) for share, noise in cases.values()]
        for panels in PANELS:
            fits = fitted([target_of(scan) for scan in scans], panels)
            for name, scan, fit in zip(cases, scans, fits, strict=True):
                near = apart(fit, fits[0], scans[0].dense)
                print(
                    f"  {path.stem:10} {panels} panels {name:14} {near[0]:.2f} ({near[1]:.1f})  patterns"
                    f" {patterns_apart(fit, fits[0]):.2f}; RMS {fit.figures['rms_mm']:.2f}; {fit.code.name.lower()};"
                    f" {strays_left(scan, scans[0])} strays of {len(scan.dense)} left;"
                    f" {' / '.join(note.text for note in scan.notes)}"
                )


def disturbed(points: np.ndarray, share: float, noise: float, seed: int = 1) -> np.ndarray:
    """Points with noise (standard deviation, mm), and so large a share of stray ones in a box half as large again."""
    random = np.random.default_rng(seed)
    low, high = points.min(axis=0), points.max(axis=0)
    wide = (high - low) / 4
    count = round(share / (1 - share) * len(points))
    stray = random.uniform(low - wide, high + wide, (count, 3))
    return random.permutation(np.concatenate([points + noise * random.standard_normal(points.shape), stray]))


def strays_left(scan: Scan, clean: Scan) -> int:
    """Points of a cleaned breast that are farther than 8 mm from all points of the undisturbed one."""
    return int((KDTree(clean.dense).query(scan.dense)[0] > 8.0).sum())


def report_coverage(folder: Path, _: Path) -> None:
    print("\nweights by surface: mm RMS between the fits with and without them; RMS of the whole clean cloud by each")
    breasts = sorted((folder / "breasts").glob("*.ply"))
    scans = [load_scan(path) for path in breasts]
    for panels in PANELS:
        fits = fitted([*map(target_of, scans), *(replace(target_of(s), weights=None) for s in scans)], panels)
        pairs = list(zip(fits[: len(scans)], fits[len(scans) :], strict=True))
        away = [apart(*pair)[0] for pair in pairs]
        change = [a.figures["rms_mm"] - b.figures["rms_mm"] for a, b in pairs]
        print(
            f"  {panels} panels, {len(scans)} clean breasts: surfaces {np.median(away):.3f} (largest {max(away):.3f});"
            f" RMS changes by {min(change):+.3f} to {max(change):+.3f}"
        )
    holed = [(name, _holed(path, cut)) for name, cut in HOLES.items() for path in breasts[:6]]
    for panels in PANELS:
        best = fitted([target_of(scan) for scan in scans[:6]], panels)
        for how in ("bridged", "weighted only", "neither"):
            empty = np.empty((0, 3))
            shown = [scan if how == "bridged" else replace(scan, assumed=empty) for _, scan in holed]
            told = [target_of(scan) for scan in shown]
            fits = fitted([replace(t, weights=None) if how == "neither" else t for t in told], panels)
            for name in HOLES:
                rows = [k for k, (hole, _) in enumerate(holed) if hole == name]
                away = [apart(fits[k], best[k % 6]) for k in rows]
                print(
                    f"  {panels} panels, {name}, {how}: mm RMS off the fit to all"
                    f" data {np.median([a[0] for a in away]):.2f} (largest {max(a[0] for a in away):.2f};"
                    f" one point {max(a[1] for a in away):.1f})"
                )


HOLES: dict[str, Callable[[np.ndarray, Scan], np.ndarray]] = {
    "hole of 28 mm radius inwards of the apex": lambda points, scan: (
        np.linalg.norm(points - (scan.wire[0] + 2 * _there(scan.apex)) / 3, axis=1) < 28
    ),
    "shadow: the lower 15 mm above the wire": lambda points, scan: (
        KDTree(evenly_spaced(scan.wire[10:-10], 400)).query(points)[0] < 15
    ),
}


def _holed(path: Path, cut: Callable[[np.ndarray, Scan], np.ndarray]) -> Scan:
    whole = load_scan(path, points=None, outliers=None)
    kept = whole.points[~cut(whole.points, whole)]
    points = drawn(kept)
    return replace(
        whole, points=points, dense=kept, assumed=gaps(points, kept, _there(whole.curve)).places, spacing=None
    )


def report_lines(folder: Path, _: Path) -> None:
    print("\nnecklines built from ends and strap point: mm RMS (largest) off the given; wires by size")
    for path in [*(path for path, _ in simulated(folder)), *sorted((folder / "torsos").glob("*.ply"))]:
        given = read_landmarks(_marks_of(folder, path))
        cloud = read_cloud(path).points
        built = _loaded(cloud, replace(given, upper_line=None))
        neckline = line_apart(built.frame.to_scan(_there(built.neckline)), _there(given.upper_line))
        wire = _there(given.wire)
        size = f"{_size(wire).radius:.0f}x{_size(wire).length:.0f}"
        laid = _loaded(cloud, replace(given, upper_line=None), wire=size)
        away = line_apart(laid.frame.to_scan(laid.wire), wire)
        flat = line_apart(_flat(wire), wire)
        print(
            f"  {path.stem:12} {rms(neckline):.2f} ({neckline.max():.1f});  size {size}: {rms(away):.1f}"
            f" ({away.max():.1f}), the best that one can do about {rms(flat):.1f}"
        )


def _size(wire: np.ndarray) -> WireSize:
    """The wire size with a wire's length and span."""
    span, length = float(np.linalg.norm(wire[-1] - wire[0])), polyline_length(wire)
    half = np.linspace(0.05, np.pi / 2, 20000)
    arc = float(length / 2 / half[np.abs(np.sin(half) / half - span / length).argmin()])
    return WireSize("", arc if length < np.pi * span / 2 else span / 2, length)


def _flat(wire: np.ndarray) -> np.ndarray:
    """The wire of a wire's length and span, laid on it with as small distances as a rigid motion allows."""
    flat, even = np.pad(_size(wire).line(200), ((0, 0), (0, 1))), evenly_spaced(wire, 200)
    return laid_on(flat, even)


def report_damaged(_: Path, root: Path) -> None:
    print("\ndamaged files (tests/cloud/test_damaged.py):", flush=True)
    command = [sys.executable, "-m", "pytest", "tests/cloud/test_damaged.py", "-q", "-m", "slow or not slow", "-rA"]
    subprocess.run([*command, "-k", "damaged_files", "-s"], cwd=root, check=False)


PARTS: dict[str, Callable[[Path, Path], None]] = {
    "given": report_given,
    "missing": report_missing,
    "wire": report_wire,
    "proposed": report_proposed,
    "sides": report_sides,
    "invariance": report_invariance,
    "noise": report_noise,
    "coverage": report_coverage,
    "lines": report_lines,
    "damaged": report_damaged,
}


def wanted_parts(parser: argparse.ArgumentParser, only: str, parts: Collection[str]) -> list[str]:
    """The names in --only; an unknown one ends the program."""
    wanted = only.split(",")
    if unknown := [name for name in wanted if name not in parts]:
        parser.error(f"--only: {', '.join(unknown)} is none of {', '.join(parts)}")
    return wanted


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with breasts/, scans/ and torsos/")
    parser.add_argument("--only", default=",".join(PARTS), help="parts, with commas")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for name in wanted_parts(parser, options.only, PARTS):
        PARTS[name](options.folder, Path(__file__).resolve().parents[1])


if __name__ == "__main__":
    main()
