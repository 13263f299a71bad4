"""The page over all scans that are to be marked: what is done, and what is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from brafit.atomic import write_text
from brafit.report.html import asset, link, page, text


@dataclass(frozen=True)
class Entry:
    """A line of the page: a scan with its page, or why it has none.

    Attributes:
        name: of the scan.
        file: its page, beside this one; None where there is none.
        key: under which the browser keeps its work.
        start: with what its page begins, or why there is none.
        done: it is marked already.
    """

    name: str
    file: str | None
    key: str
    start: str
    done: bool = False


def write_index(path: str | Path, entries: Sequence[Entry]) -> None:
    """Write the page; it asks the browser what has been saved since."""
    lines = "\n".join(_line(entry) for entry in entries)
    script = resources.files("brafit.marking").joinpath("browser", "index.js").read_text(encoding="utf-8")
    script = f"<script>{script}</script>" * any(entry.file is not None for entry in entries)
    body = (
        f"<style>.done {{ color: #2e6b34; }} .begun {{ color: #9a6a00; }}</style>\n<h1>Scans to mark</h1>\n"
        f"<p>{_state(entries)}</p>\n"
        '<p class="soft">Saved files are downloads: put each beside its scan. What is marked and not saved stays in '
        "this browser.</p>\n"
        '<div class="scroll"><table class="sortable"><thead><tr><th>scan</th><th>state</th><th>begins with</th></tr>'
        f"</thead><tbody>\n{lines}\n</tbody></table></div>\n"
        f"<script>{asset('table.js')}</script>\n{script}"
    )
    write_text(path, page("scans to mark", body))


def _state(entries: Sequence[Entry]) -> str:
    """How many of the scans that have a page are marked, and how many have none."""
    count, done = sum(entry.file is not None for entry in entries), sum(entry.done for entry in entries)
    failed = len(entries) - count
    if not count:
        which = "The scan" if failed == 1 else f"None of the {failed} scans"
        return f"{which} can{'not' * (failed == 1)} be marked: the table says why."
    more = f"; {failed} more cannot be marked: the table says why" * bool(failed)
    return f'<b id="done">{done}</b> of {count} done{more}'


def _line(entry: Entry) -> str:
    if entry.file is None:
        cells = f'<td>{text(entry.name)}</td><td class="failed" data-value="3">failed</td><td>{text(entry.start)}</td>'
        return f"<tr>{cells}</tr>"
    state, words = ("done", "marked") if entry.done else ("todo", "to do")
    return (
        f'<tr data-key="{text(entry.key)}" data-start="{words}" data-state="{state}">'
        f'<td><a href="{link(entry.file)}">{text(entry.name)}</a></td>'
        f'<td class="state {state}" data-value="{words}">{words}</td><td>{text(entry.start)}</td></tr>'
    )
