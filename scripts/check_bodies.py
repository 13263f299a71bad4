"""How well landmarks are proposed on bodies of every kind: `python scripts/check_bodies.py --write docs/proposals.md`.

Bodies are made by `brafit.simulation.bodies`, which knows where bust point and wire ends are, and scanned by
`brafit.simulation.scanner`. Both sides of each are loaded as `brafit scan.propose=true scan.side=both` does; with
`--fits FOLDER` that command itself fits them, into the folder, and there is a table of its fits as well. Landmarks are
wrong where the apex is off by more than APEX_LIMIT or an end of the wire by more than ENDS_LIMIT, and where there is no
breast; wrong ones should be refused or doubtful. The exit status is 1 where one is neither: of that one the command
warns in general words only, as of all proposed landmarks.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from brafit.anatomy.confidence import doubt
from brafit.atomic import write_text
from brafit.cloud.ply import cloud_ply
from brafit.errors import InputError
from brafit.scan import Scan, load_sides
from brafit.simulation.bodies import KINDS, Bodies, Marks
from brafit.simulation.scanner import Scanner, simulate

APEX_LIMIT, ENDS_LIMIT = 15.0, 30.0
"""Millimetres."""
POINTS, POINTS_WHOLE = 60_000, 120_000
NOISE, STRAYS = 0.3, 0.01
COMMAND = ("scan.propose=true", "scan.side=both", "experiment=lean")
"""Settings with which bodies are fitted."""
PRONE = "prone, cut off behind"
DOUBTFUL, GENERAL = "doubtful_landmarks", "unseen_landmarks"
"""Codes of the warnings of landmarks."""
FRONT = 0.3
"""Cameras in front are those whose direction has so much of the front."""


@dataclass(frozen=True)
class Outcome:
    """What became of one side of a body.

    Attributes:
        body, kind, side: which.
        breast: there is one.
        reason: why it was refused; empty if it was not.
        warning: what was said of doubtful landmarks.
        apex, inner, outer: mm off the truth; None without a breast, or where it was refused.
        said: what the fit was warned of besides.
        rms, largest: distances of its points from the cup, mm; None where none was fitted.
        unlike: it was fitted, and the cup refused.
    """

    body: str
    kind: str
    side: str
    breast: bool
    reason: str = ""
    warning: str = ""
    apex: float | None = None
    inner: float | None = None
    outer: float | None = None
    said: tuple[str, ...] = ()
    rms: float | None = None
    largest: float | None = None
    unlike: bool = False

    @property
    def wrong(self) -> bool:
        """Landmarks were given, and they are off."""
        if self.reason:
            return False
        if self.apex is None or self.inner is None or self.outer is None:
            return True
        return self.apex > APEX_LIMIT or max(self.inner, self.outer) > ENDS_LIMIT


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry of the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--bodies", type=int, default=10, help="of each kind (10); three times as many plain ones")
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=list(KINDS), help="all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2, help="processes (2)")
    parser.add_argument("--fits", type=Path, help="fit them into this folder; what is there of the same bodies is kept")
    parser.add_argument("--write", type=Path, help="a Markdown file for the tables")
    options = parser.parse_args(arguments)
    jobs = list(_jobs(options.kinds, options.bodies, options.seed))
    folder = options.fits and options.fits / f"seed_{options.seed}"
    found: list[Outcome] = []
    with multiprocessing.get_context("spawn").Pool(options.threads) as pool:
        if folder:
            pool.starmap(keep_body, [(job, folder) for job in jobs])
            fit_bodies(folder, options.threads)
        work = partial(fits_of, folder=folder) if folder else outcomes_of
        for outcomes in pool.imap_unordered(work, jobs):
            found += outcomes
            print(*(_line(one) for one in outcomes), sep="\n", flush=True)
    order = {kind: k for k, kind in enumerate(KINDS)}
    found.sort(key=lambda one: (order[one.kind], one.body, one.side))
    command = f"python scripts/check_bodies.py --bodies {options.bodies} --seed {options.seed}"
    told = report(found, command + " --fits FOLDER" * bool(options.fits))
    print(told)
    if options.write:
        write_text(options.write, told)
    sys.exit(any(one.wrong and not one.warning for one in found))


def _jobs(kinds: Sequence[str], count: int, seed: int) -> Iterator[Job]:
    for kind in kinds:
        for k in range(3 * count if kind == "plain" else count):
            yield kind, k, seed


@lru_cache(maxsize=1)
def _bodies() -> Bodies:
    return Bodies()


Job = tuple[str, int, int]
"""A kind, which body of it, and the seed."""


def scanned(job: Job) -> tuple[np.ndarray, dict[str, Marks | None]]:
    """The scan of the k-th body of a kind, and its marks."""
    kind, k, seed = job
    what = KINDS[kind]
    random = np.random.default_rng((seed, crc32(kind.encode()), k))
    body = _bodies().body(what, random)
    cameras = Scanner.directions(0.4, 0.3)
    cameras = cameras[cameras[:, 2] > FRONT] if what.front else cameras
    points = POINTS_WHOLE if what.keep == "whole" else POINTS
    return simulate(body.vertices, body.faces, Scanner(cameras, points, NOISE, STRAYS), random), body.marks


def outcomes_of(job: Job) -> list[Outcome]:
    """What landmarks are proposed on both sides of a body."""
    kind, k, _ = job
    cloud, marks = scanned(job)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.ply")
        path.write_bytes(cloud_ply(cloud))
        scans = load_sides(path, ("left", "right"), propose=True, apart=False)
    sides = zip(("left", "right"), scans, strict=True)
    return [_outcome(f"{kind} {k + 1}", kind, side, scan, marks[side]) for side, scan in sides]


def keep_body(job: Job, folder: Path) -> None:
    """Write a body's scan and marks into a folder, if they are not there."""
    file, truth = (folder / kind / f"{_stem(job)}.{end}" for kind, end in (("bodies", "ply"), ("marks", "json")))
    if file.exists() and truth.exists():
        return
    cloud, marks = scanned(job)
    for path in (file, truth):
        path.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(cloud_ply(cloud))
    named = {side: there and {name: place.tolist() for name, place in there.items()} for side, there in marks.items()}
    write_text(truth, json.dumps(named))


def fit_bodies(folder: Path, threads: int) -> None:
    """Fit all bodies of a folder with the command; those that are fitted already are kept."""
    command = [sys.executable, "-m", "brafit", str(folder / "bodies"), *COMMAND]
    subprocess.run([*command, f"threads={threads}", f"out={folder / 'results'}"], check=False)


def fits_of(job: Job, folder: Path) -> list[Outcome]:
    """What the command made of both sides of a body."""
    marks = json.loads((folder / "marks" / f"{_stem(job)}.json").read_text(encoding="utf-8"))
    kind, k, _ = job
    found = []
    for side, truth in marks.items():
        path = folder / "results" / f"{_stem(job)}_{side}" / "fit.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        found.append(_fitted(f"{kind} {k + 1}", kind, side, content, truth))
    return found


def _stem(job: Job) -> str:
    kind, k, _ = job
    return f"{re.sub('[^a-z]+', '_', kind)}_{k + 1:02d}"


def _fitted(name: str, kind: str, side: str, content: dict[str, Any], truth: dict[str, list[float]] | None) -> Outcome:
    """What a fit.json says of a side."""
    if content["status"] != "ok":
        reason = re.sub(r"^.*?\.ply: ", "", content["reason"]).partition(". ")[0]
        unlike = content["iterations"] is not None
        return Outcome(name, kind, side, truth is not None, reason, unlike=unlike, rms=content["rms_mm"])
    parts = (content, content["pattern"])
    told = [pair for part in parts for pair in zip(part["warning_codes"], part["warnings"], strict=True)]
    doubts = [words for code, words in told if code == DOUBTFUL]
    said = tuple(words for code, words in told if code not in (DOUBTFUL, GENERAL))
    fitted = Outcome(
        name, kind, side, truth is not None, warning="; ".join(doubts), said=said, rms=content["rms_mm"],
        largest=content["max_mm"],
    )  # fmt: skip
    if truth is None:
        return fitted
    wire, frame = content["wire"], content["frame"]
    ends = wire["mm_per_unit"] * np.polynomial.chebyshev.chebval([-1.0, 1.0], np.asarray(wire["series"])).T
    places = np.stack([content["landmarks"]["apex"], *ends]) @ np.asarray(frame["axes"]) + frame["origin"]
    off = np.linalg.norm(places - [truth[mark] for mark in ("apex", "inner_end", "outer_end")], axis=1)
    return replace(fitted, apex=float(off[0]), inner=float(off[1]), outer=float(off[2]))


def _outcome(name: str, kind: str, side: str, scan: Scan | InputError, truth: Marks | None) -> Outcome:
    if isinstance(scan, InputError):
        return Outcome(name, kind, side, truth is not None, reason=scan.cause)
    warning = "" if scan.confidence is None else doubt(scan.confidence)
    if truth is None or scan.apex is None:
        return Outcome(name, kind, side, truth is not None, warning=warning)
    places = {"apex": scan.apex, "inner_end": scan.wire[0], "outer_end": scan.wire[-1]}
    off = [float(np.linalg.norm(scan.frame.to_scan(place) - truth[mark])) for mark, place in places.items()]
    return Outcome(name, kind, side, True, "", warning, off[0], off[1], off[2])


def _line(one: Outcome) -> str:
    off = "" if one.apex is None else f"bust point {one.apex:.0f}, ends {one.inner:.0f} and {one.outer:.0f} mm off"
    off += "" if one.largest is None else f", RMS {one.rms:.2f} mm"
    fault = "WRONG" * (one.wrong and not one.warning)
    told = f"refused: {one.reason}" if one.reason else "; ".join(words for words in (one.warning, *one.said) if words)
    return (
        f"{one.body}, {one.side}{'' if one.breast else ', no breast'}: {'; '.join(w for w in (fault, off, told) if w)}"
    )


def report(found: Sequence[Outcome], command: str) -> str:
    """The tables, in Markdown."""
    kinds = [kind for kind in KINDS if any(one.kind == kind for one in found)]
    rows = [
        "Of proposed landmarks `brafit` always warns: of doubtful ones with what is unusual, of the others in general",
        f"words, with how far such landmarks lay off here, but for prone bodies: {_off(found)}.",
        "",
        "| kind | breasts | nothing unusual | doubtful | refused | bust point off: median, 95 %, largest "
        "| ends off: median, largest "
        "| no breast: refused, doubtful, not | wrong, though nothing is unusual |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_row(kind, [one for one in found if one.kind == kind]) for kind in kinds),
        _row("all", found),
    ]
    fits = any(one.rms is not None for one in found)
    reasons = Counter(_plain(one.reason) for one in found if one.reason)
    wrong = [f"- {_line(one)}" for one in found if one.wrong and not one.warning]
    refused = [f"- {_line(one)}" for one in found if one.reason and one.breast]
    return "\n".join([
        "# Proposed landmarks on bodies of every kind",
        "",
        f"`{command}`: {len({one.body for one in found})} parametric bodies, both sides of each, scans with noise of "
        f"{NOISE} mm and {100 * STRAYS:.0f} % strays. Millimetres. `brafit/simulation/bodies.py` says how the truth is "
        "known, and how well: its outer ends are uncertain by 10 mm themselves.",
        "",
        f"Wrong is a bust point off by more than {APEX_LIMIT:g}, an end of the wire off by more than {ENDS_LIMIT:g}, "
        "or landmarks where there is no breast.",
        "",
        *["Refused includes fits that failed, which the second table parts.", ""] * fits,
        *rows,
        "",
        "Reasons of what was refused (N stands for a number):",
        "",
        *(f"- {count} x {reason}" for reason, count in reasons.most_common()),
        "",
        f"Wrong, though nothing is unusual: {len(wrong)}",
        "",
        *wrong,
        "",
        f"Refused though there is a breast: {len(refused)}",
        "",
        *refused,
        "",
        *(_fits(kinds, found) if fits else []),
    ])  # fmt: skip


def _off(found: Sequence[Outcome]) -> str:
    """How far landmarks lay off of which nothing unusual is told: what `brafit.anatomy.confidence.OFF` says."""
    told = [one for one in found if one.apex is not None and not one.warning and one.kind != PRONE]
    ends = [max(one.inner or 0.0, one.outer or 0.0) for one in told]
    apexes = [one.apex for one in told if one.apex is not None]
    return f"bust points {_quantiles(apexes, (0.5, 1.0))}, ends {_quantiles(ends, (0.5, 1.0))} (median, largest)"


def _fits(kinds: Sequence[str], found: Sequence[Outcome]) -> list[str]:
    """The table of fits."""
    bad = [f"- {_line(one)}" for one in found if one.wrong and not (one.warning or one.said)]
    unlike = [f"- {_line(one)}" for one in found if one.unlike]
    return [
        "## Fits on these landmarks",
        "",
        f"`brafit FOLDER/seed_.../bodies {' '.join(COMMAND)} out=...`, which the command above runs. Warnings are "
        "those besides the general one of all proposed landmarks. RMS is of the fits that are ok, mm.",
        "",
        "| kind | sides with a breast | ok, no warning | ok, warned | failed after the fit | refused before it "
        "| RMS: median, largest | largest distance: median, largest | sides without: ok, refused "
        "| wrong, ok, no warning |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_fit_row(kind, [one for one in found if one.kind == kind]) for kind in kinds),
        _fit_row("all", found),
        "",
        f"Wrong, ok and without a warning: {len(bad)}",
        "",
        *bad,
        "",
        f"Failed after the fit: {len(unlike)}",
        "",
        *unlike,
        "",
    ]


def _fit_row(kind: str, found: Sequence[Outcome]) -> str:
    there, none = [one for one in found if one.breast], [one for one in found if not one.breast]
    ok = [one for one in there if not one.reason]
    warned = [one for one in ok if one.warning or one.said]
    cells = [
        kind,
        str(len(there)),
        str(len(ok) - len(warned)),
        str(len(warned)),
        str(sum(one.unlike for one in there)),
        str(sum(bool(one.reason) and not one.unlike for one in there)),
        _quantiles([one.rms for one in ok if one.rms is not None], (0.5, 1.0), 2),
        _quantiles([one.largest for one in ok if one.largest is not None], (0.5, 1.0), 1),
        f"{sum(not one.reason for one in none)}, {sum(bool(one.reason) for one in none)}" if none else "",
        str(sum(one.wrong and not (one.warning or one.said) for one in found)),
    ]
    return f"| {' | '.join(cells)} |"


def _row(kind: str, found: Sequence[Outcome]) -> str:
    there, none = [one for one in found if one.breast], [one for one in found if not one.breast]
    apex = [one.apex for one in there if one.apex is not None]
    ends = [max(one.inner or 0.0, one.outer or 0.0) for one in there if one.apex is not None]
    cells = [
        kind,
        str(len(there)),
        str(sum(not one.reason and not one.warning for one in there)),
        str(sum(bool(one.warning) for one in there)),
        str(sum(bool(one.reason) for one in there)),
        _quantiles(apex, (0.5, 0.95, 1.0)),
        _quantiles(ends, (0.5, 1.0)),
        _counts(none),
        str(sum(one.wrong and not one.warning for one in found)),
    ]
    return f"| {' | '.join(cells)} |"


def _counts(none: Sequence[Outcome]) -> str:
    if not none:
        return ""
    refused, warned = sum(bool(one.reason) for one in none), sum(bool(one.warning) for one in none)
    return f"{refused}, {warned}, {len(none) - refused - warned}"


def _quantiles(values: Sequence[float], shares: Sequence[float], digits: int = 0) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in np.quantile(values, shares)) if values else ""


def _plain(reason: str) -> str:
    """A reason with N for each of its numbers."""
    return ": ".join(re.sub(r"-?\d+(\.\d+)?", "N", part) for part in reason.split(": ")[:2])


if __name__ == "__main__":
    main()
