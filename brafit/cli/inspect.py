"""The command `brafit-inspect`: looks at scans before they are fitted, proposes what is missing, draws what it found.

For each scan a PNG with landmarks, wire, neckline, what is cut out and what was removed, and a landmark file to be
corrected by hand.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from brafit.anatomy import proposed_landmarks
from brafit.anatomy.confidence import warning
from brafit.atomic import write_text
from brafit.cli.ending import end_with, in_options
from brafit.cli.status import ALL_OK, NOTHING_RAN, SOME_FAILED
from brafit.cloud import Cloud, read_cloud
from brafit.errors import BrafitError, InputError
from brafit.geometry.polyline import polyline_length
from brafit.landmarks import Landmarks, landmarks_path, landmarks_text, read_breasts
from brafit.landmarks.units import MILLIMETRES, torso_unit
from brafit.scan import Scan, find_scans, load_sides, scan_names
from brafit.surface.cleaning import Cleaning
from brafit.underwires.nearest import nearest_wire

_TAKEN = {
    "other_side": "added of the other breast",
    "not_finite": "without a place",
    "elsewhere": "far from the breast",
    "duplicates": "repeated",
    "outliers": "outliers",
    "off_surface": "floating",
    "islands": "in small parts",
    "outside": "outside of wire and neckline",
    "thinned": "merged with others",
}
"""What each step of the cleaning says of the points that it took."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the console script; exit status as `brafit`'s."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if mistaken := [text for text in options.scans if "=" in text and not Path(text).exists()]:
        parser.error(f"{mistaken[0]}: takes no settings; what is not marked is proposed. --side, --units, --wire")
    end_with("brafit-inspect", lambda: _inspected(options), "files")


def _inspected(options: argparse.Namespace) -> int:
    """Inspect all scans; gives the exit status."""
    paths = find_scans(options.scans, propose=True)
    done = 0
    for name, path in zip(scan_names(paths), paths, strict=True):
        try:
            print(inspect_scan(path, name, options.out, options.side, options.units, options.wire, options.beside))
            done += 1
        except BrafitError as error:
            print(f"failed: {in_options(error)}", file=sys.stderr)
    return ALL_OK if done == len(paths) else SOME_FAILED if done else NOTHING_RAN


def inspect_scan(
    path: Path,
    name: str,
    out: Path,
    side: str | None = None,
    units: str | None = None,
    wire: str | None = None,
    beside: bool = False,
) -> str:
    """Inspect one scan, write its picture and its landmark file; gives a line that says what was found.

    Args:
        path: the cloud's file.
        name: what picture and landmark file are called.
        out: folder for NAME_SIDE.png and NAME.json.
        side: `left`, `right` or `both`; None: what its landmark file marks, both where there is none.
        units: of the files, as `load_scan` takes it.
        wire: as marked (None), `detect`, or a size, as `load_scan` takes it.
        beside: write a landmark file beside a scan that has none.

    Raises:
        InputError: one line naming file, cause and remedy.
    """
    from brafit.report.figures import save_figure

    given = landmarks_path(path).is_file()
    marks_file = landmarks_path(path) if given else out / f"{name}.json"
    cloud = read_cloud(path)
    if not given:
        write_text(marks_file, landmarks_text(_proposed(cloud, units)))
    marked = [marks.side for marks in read_breasts(marks_file)]
    sides = {"both": ["left", "right"], None: marked}.get(side, [str(side)])
    scans = _loaded(load_sides(cloud, sides, name=name, units=units, wire=wire, landmarks=marks_file))
    if given:
        write_text(out / f"{name}.json", landmarks_text([_landmarks(scan, units) for scan in scans]))
    elif beside:
        write_text(landmarks_path(path), marks_file.read_text(encoding="utf-8"))
    for scan in scans:
        save_figure(_figure(scan, cloud), out / f"{name}_{scan.side}.png", dpi=110)
    found = "; ".join(f"{scan.side}: {', '.join(_facts(scan, cloud)[:2])}" for scan in scans)
    return f"{name}: {found} -> {out / name}_*.png"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="brafit-inspect", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("scans", nargs="+", help="files, folders or patterns; in folders also scans without landmarks")
    parser.add_argument("--out", type=Path, default=Path("inspection"), help="folder of the results (inspection)")
    parser.add_argument("--side", choices=("left", "right", "both"), help="default: as the landmark file marks it")
    parser.add_argument("--units", choices=tuple(MILLIMETRES), help="default: found")
    parser.add_argument("--wire", help="detect, or a size; default: as given, detected where missing")
    parser.add_argument("--beside", action="store_true", help="write landmark files beside scans that have none")
    return parser


def _loaded(scans: Sequence[Scan | InputError]) -> list[Scan]:
    """The scans; the first error is raised."""
    if error := next((scan for scan in scans if isinstance(scan, InputError)), None):
        raise error
    return [scan for scan in scans if isinstance(scan, Scan)]


def _proposed(cloud: Cloud, units: str | None) -> list[Landmarks]:
    unit = units or cloud.unit or torso_unit(cloud.path, cloud.points)
    factor = MILLIMETRES[unit]
    found = proposed_landmarks(cloud.path, cloud.points * factor)
    return [marks.mapped(lambda points: points / factor, units=unit) for marks in found]


def _landmarks(scan: Scan, units: str | None) -> Landmarks:
    """What a scan was loaded with, in the landmark file's own unit."""
    factor = MILLIMETRES[units or scan.units.marks]
    points = {"inner_end": scan.wire[0], "outer_end": scan.wire[-1], **_marks(scan)}
    marks = Landmarks(
        path=scan.path,
        name=scan.name,
        side=scan.side,
        wire=scan.wire,
        upper_line=scan.neckline,
        points=points,
        proposed=scan.origin.marks != "given",
    )
    return replace(marks.mapped(lambda line: scan.frame.to_scan(line) / factor), units=units or scan.units.marks)


def _marks(scan: Scan) -> dict[str, np.ndarray]:
    named = {"apex": scan.apex, "strap_point": scan.strap_point}
    return {name: point for name, point in named.items() if point is not None}


def _origins(scan: Scan) -> dict[str, str]:
    """Of every line and landmark: given, mirrored, proposed, detected, built."""
    wire = scan.origin.wire
    if scan.origin.wire_guessed is not None:
        wire += f", {100 * scan.origin.wire_guessed:.0f} % guessed"
    ends = scan.origin.marks if scan.origin.wire in ("given", "mirrored", "proposed") else scan.origin.wire
    return {
        "wire": wire,
        "neckline": scan.origin.neckline if scan.origin.marks == "given" else scan.origin.marks,
        "inner_end": ends,
        "outer_end": ends,
        **dict.fromkeys(_marks(scan), scan.origin.marks),
    }


def _facts(scan: Scan, cloud: Cloud) -> list[str]:
    origin = scan.origin
    guessed = "" if origin.wire_guessed is None else f", {100 * origin.wire_guessed:.0f} % of it guessed"
    length = polyline_length(scan.wire)
    return [
        f"landmarks {origin.marks}, wire {origin.wire}{guessed} ({length:.0f} mm), neckline {origin.neckline}",
        f"nearest wire sold {nearest_wire(scan.wire)}",
        f"unit {scan.units.cloud}{f' (found from {scan.units.found})' if scan.units.found else ''}",
        f"points: {_counts(scan.cleaning, cloud)}",
        *(["without points: " + f"{100 * scan.gap_share:.0f} % of the cup"] if scan.gap_share else []),
        *_doubts(scan),
        *(str(note) for note in scan.notes if note.code != "guessed_marks"),  # told above, and to be seen
    ]


def _counts(steps: Cleaning, cloud: Cloud) -> str:
    """What was read and what became of the points, in words: what took none is left out."""
    mesh = f"{steps.read:,} sampled on a mesh of {cloud.vertices:,} vertices and {cloud.faces:,} triangles"
    read = mesh if cloud.faces else f"{steps.read:,} read"
    taken = [f"{count:,} {_TAKEN[key]}" for key, count in asdict(steps).items() if key in _TAKEN and count]
    voxels = f", averaged in voxels of {steps.voxel_mm:.1f} mm" if steps.voxel_mm else ""
    noise = "" if steps.scatter_mm is None else f"; they scatter by {steps.scatter_mm:.2f} mm about their surface"
    return ", ".join([read, *taken, f"{steps.used:,} used{voxels}"]) + noise


def _doubts(scan: Scan) -> list[str]:
    """How far landmarks that nobody looked at can be trusted."""
    if scan.confidence is None:
        return []
    told = warning(scan.confidence, scan.origin.marks, shown=True)
    return ["nothing about the mirrored landmarks is unusual" if told is None else str(told)]


def _figure(scan: Scan, cloud: Cloud):
    from brafit.report.inspection import inspection_figure

    body = scan.frame.to_cup(cloud.points * MILLIMETRES[scan.units.cloud])
    lines = {"wire": scan.wire} | ({} if scan.neckline is None else {"neckline": scan.neckline})
    marks = {"inner_end": scan.wire[0], "outer_end": scan.wire[-1], **_marks(scan)}
    title = f"{scan.name}, {scan.side} breast"
    clouds = {"rest": body, "cup": scan.dense, "assumed": scan.assumed, "removed": scan.removed}
    return inspection_figure(clouds, lines, marks, title, "\n".join(_facts(scan, cloud)), _origins(scan))


if __name__ == "__main__":
    main()
