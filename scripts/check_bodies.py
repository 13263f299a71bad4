"""How well landmarks are proposed on bodies of every kind: `python scripts/check_bodies.py --write docs/proposals.md`.

Bodies are made by `brafit.simulation.bodies`, which knows where bust point and wire ends are, and scanned by
`brafit.simulation.scanner`. Both sides of each are loaded as `brafit scan.propose=true scan.side=both` does. Landmarks
are wrong where the apex is off by more than APEX_LIMIT or an end of the wire by more than ENDS_LIMIT, and where there
is no breast; wrong ones should be refused or doubtful. The exit status is 1 where one is neither: of that one the
command warns in general words only, as of all proposed landmarks.
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
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
    parser.add_argument("--write", type=Path, help="a Markdown file for the tables")
    options = parser.parse_args(arguments)
    jobs = list(_jobs(options.kinds, options.bodies, options.seed))
    found: list[Outcome] = []
    with multiprocessing.get_context("spawn").Pool(options.threads) as pool:
        for outcomes in pool.imap_unordered(outcomes_of, jobs):
            found += outcomes
            print(*(_line(one) for one in outcomes), sep="\n", flush=True)
    order = {kind: k for k, kind in enumerate(KINDS)}
    found.sort(key=lambda one: (order[one.kind], one.body, one.side))
    told = report(found, f"python scripts/check_bodies.py --bodies {options.bodies} --seed {options.seed}")
    print(told)
    if options.write:
        write_text(options.write, told)
    sys.exit(any(one.wrong and not one.warning for one in found))


def _jobs(kinds: Sequence[str], count: int, seed: int) -> Iterator[tuple[str, int, int]]:
    for kind in kinds:
        for k in range(3 * count if kind == "plain" else count):
            yield kind, k, seed


@lru_cache(maxsize=1)
def _bodies() -> Bodies:
    return Bodies()


def outcomes_of(job: tuple[str, int, int]) -> list[Outcome]:
    """Both sides of the k-th body of a kind."""
    kind, k, seed = job
    name, what = f"{kind} {k + 1}", KINDS[kind]
    random = np.random.default_rng((seed, crc32(kind.encode()), k))
    body = _bodies().body(what, random)
    cameras = Scanner.directions(0.4, 0.3)
    cameras = cameras[cameras[:, 2] > FRONT] if what.front else cameras
    points = POINTS_WHOLE if what.keep == "whole" else POINTS
    cloud = simulate(body.vertices, body.faces, Scanner(cameras, points, NOISE, STRAYS), random)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "body.ply")
        path.write_bytes(cloud_ply(cloud))
        scans = load_sides(path, ("left", "right"), propose=True, apart=False)
    sides = zip(("left", "right"), scans, strict=True)
    return [_outcome(name, kind, side, scan, body.marks[side]) for side, scan in sides]


def _outcome(name: str, kind: str, side: str, scan: Scan | InputError, truth: Marks | None) -> Outcome:
    if isinstance(scan, InputError):
        return Outcome(name, kind, side, truth is not None, reason=scan.cause)
    warning = "" if scan.confidence is None else doubt(scan.confidence)
    if truth is None or scan.apex is None:
        return Outcome(name, kind, side, truth is not None, warning=warning)
    places = {"apex": scan.apex, "inner_end": scan.wire[0], "outer_end": scan.wire[-1]}
    off = (float(np.linalg.norm(scan.frame.to_scan(place) - truth[mark])) for mark, place in places.items())
    return Outcome(name, kind, side, True, "", warning, *off)


def _line(one: Outcome) -> str:
    off = "" if one.apex is None else f"apex {one.apex:.0f}, ends {one.inner:.0f} and {one.outer:.0f} mm off"
    fault = "WRONG" * (one.wrong and not one.warning)
    told = f"refused: {one.reason}" if one.reason else one.warning
    return (
        f"{one.body}, {one.side}{'' if one.breast else ', no breast'}: {'; '.join(w for w in (fault, off, told) if w)}"
    )


def report(found: Sequence[Outcome], command: str) -> str:
    """The tables, in Markdown."""
    kinds = [kind for kind in KINDS if any(one.kind == kind for one in found)]
    rows = [
        "Of proposed landmarks `brafit` always warns: of doubtful ones with what is unusual, of the others in general",
        "words, with how far landmarks lay off in this table.",
        "",
        "| kind | breasts | nothing unusual | doubtful | refused | apex off: median, 95 %, largest "
        "| ends off: median, largest "
        "| no breast: refused, doubtful, not | wrong, though nothing is unusual |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_row(kind, [one for one in found if one.kind == kind]) for kind in kinds),
        _row("all", found),
    ]
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
        f"Wrong is an apex off by more than {APEX_LIMIT:g}, an end of the wire off by more than {ENDS_LIMIT:g}, or "
        "landmarks where there is no breast.",
        "",
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
    ])  # fmt: skip


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


def _quantiles(values: Sequence[float], shares: Sequence[float]) -> str:
    return ", ".join(f"{value:.0f}" for value in np.quantile(values, shares)) if values else ""


def _plain(reason: str) -> str:
    """A reason with N for each of its numbers."""
    return ": ".join(re.sub(r"-?\d+(\.\d+)?", "N", part) for part in reason.split(": ")[:2])


if __name__ == "__main__":
    main()
