"""What a run says at its end."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from brafit.naming import shown
from brafit.report.table import format_table
from brafit.run.job import Done
from brafit.run.sinks import Tally
from brafit.run.store import Earlier

ROWS = 60
"""Scans whose rows are shown; of larger runs only those that failed."""
CAUSES = 12
"""Reasons that are listed."""
NAMES = 5
"""Scans of earlier runs that are named."""


def closing(done: Sequence[Done], out: Path, told: bool = False, earlier: Earlier | None = None) -> str:
    """The table of a small run, or of what failed in a large one; how many are ok, warned of and failed. A failure's
    reason is said once; of a large run the reasons are counted as well.

    Args:
        done: the scans of the run, failed and kept ones too.
        out: the run's folder.
        told: each failure was said when it happened.
        earlier: scans of earlier runs in the same folder.
    """
    tally = Tally()
    for one in done:
        tally.add(one)
    large = len(done) > ROWS
    rows = [] if large and told else [one.row for one in done if not (large and one.ok)][:ROWS]
    lines = [format_table(rows, reasons=not told), ""] if rows else []
    counts = f"{tally.ok} of {tally.total} scans ok"
    details = [f"{tally.warned} of them with warnings"] * bool(tally.warned)
    before = f" ({tally.kept_warned} with warnings, which their reports tell)" if tally.kept_warned else ""
    details += [f"{tally.kept} kept from before{before}"] * bool(tally.kept)
    why = ":" if large else ", for the reasons above."
    lines.append(f"{', '.join([counts, *details])}{f'; {tally.failed} failed{why}' if tally.failed else '.'}")
    if large:
        lines += [f"  {count} x {cause}" for cause, count in tally.causes.most_common(CAUSES)]
        lines += [f"  and {len(tally.causes) - CAUSES} other reasons"] * (len(tally.causes) > CAUSES)
    lines += _earlier(earlier or Earlier(), out)
    return "\n".join([*lines, f"Results: {shown(str(out))}"])


def _earlier(earlier: Earlier, out: Path) -> list[str]:
    """A line for the scans of earlier runs that are in the table, and one for those that are not."""
    lines = []
    if taken := [done.name for done in earlier.taken]:
        lines.append(f"{_more(taken)} in this folder, in its table too: {_named(taken)}.")
    if left := earlier.left:
        whole = f"brafit-collect {shlex.quote(str(out))} makes one of all"
        lines.append(f"{_more(left)} in this folder, not in its table: {_named(left)}. {whole}.")
    return list(map(shown, lines))


def _more(names: Sequence[str]) -> str:
    return f"{len(names)} more scan{'s of earlier runs' if len(names) > 1 else ' of an earlier run'}"


def _named(names: Sequence[str]) -> str:
    others = len(names) - NAMES
    return ", ".join(names[:NAMES]) + (f" and {others} others" if others > 0 else "")
