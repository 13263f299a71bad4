"""Codes of notes and warnings: each that the source gives is a row of docs/files.md, and no other is."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

from brafit.remarks import Remark, on_paper
from brafit.run.likeness import BOUNDS, code_of

ROOT = Path(__file__).parents[1]


def codes_of(file: Path) -> set[str]:
    """The codes of the remarks that a module makes: written out, named by a constant, or those of `BOUNDS`."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Remark"):
            continue
        code = node.args[0]
        if isinstance(code, ast.Constant):
            found.add(code.value)
        elif isinstance(code, ast.Name):
            found.add(getattr(import_module(".".join(file.relative_to(ROOT).with_suffix("").parts)), code.id))
        else:
            assert ast.unparse(code) == "code_of(key)", f"{file}: {ast.unparse(code)}"
            found |= set(map(code_of, BOUNDS))
    return found


def test_every_code_is_documented_and_every_documented_code_is_given():
    given = set().union(*(codes_of(file) for file in (ROOT / "brafit").rglob("*.py")))
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    section = page.partition("## Codes of warnings and notes")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    documented = [code for row in rows for code in re.findall(r"`(\w+)`", row)]
    assert len(documented) == len(set(documented))
    assert set(documented) == given
    assert len(given) > 30


def test_a_remark_reads_as_a_line():
    assert str(Remark("code", "it is so")) == "it is so"
    assert str(Remark("code", "it is so", "a.ply", "mend it")) == "a.ply: it is so; mend it"


def test_whoever_cuts_is_told_of_marks_that_were_guessed():
    notes = {"noisy": "its points scatter", "guessed_marks": "wire detected", "bust_point_guessed": "none is marked"}
    facts = {"note_codes": list(notes), "notes": list(notes.values())}
    own, unseen = Remark("far_points", "points are far"), Remark("unseen_landmarks", "nobody has looked")
    assert list(map(str, on_paper([own], facts))) == ["points are far", "wire detected", "none is marked"]
    assert list(map(str, on_paper([unseen], facts))) == ["nobody has looked", "none is marked"]
    assert on_paper([], {}) == ()
