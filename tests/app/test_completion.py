"""The Tab key in a shell: what is offered after a command line as users have it, with scans and options in it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from workplace import programs

from brafit.cli.completion import readable_line

LINES = {
    "brafit cup.pan": {"cup.panels="},
    "brafit solver=": {"solver=anneal", "solver=lm", "solver=paper"},
    "brafit FOLDER cup.t": {"cup.terms=", "cup.tolerance="},
    "brafit 'my folder' a/b.ply -m cup.panels=2,3 pattern.allow": {"pattern.allowance."},
    "brafit --config-dir conf cup=frames cup.b": {"cup.basis="},
    "brafit cup=framez cup.b": set(),
    "brafit scan": {"scan.", "scan=", "scans="},
    "brafit scan_f": {"scan_files"},
    "brafit a/b": set(),
    "brafit --hel": set(),
    "brafit 'scan": set(),
}
"""Command lines, and what bash then offers in a folder that holds a file `scan_files`."""
SCRIPT = """
cd "$1"; shift
eval "$(brafit -sc install=bash)"
for COMP_LINE in "$@"; do
    COMP_POINT=${#COMP_LINE}; COMP_WORDS=($COMP_LINE); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=()
    hydra_bash_completion
    echo "${COMPREPLY[@]}"
done
"""


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_the_shell_completes_settings_beside_scans_and_options(tmp_path: Path) -> None:
    programs(tmp_path / "bin")
    (tmp_path / "scan_files").touch()
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", SCRIPT, "bash", str(tmp_path), *LINES],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    found = [set(line.split()) for line in done.stdout.splitlines()]
    assert dict(zip(LINES, found, strict=True)) == LINES


@pytest.mark.parametrize(
    ("line", "read"),
    [
        ("brafit ", "brafit "),
        ("brafit a.ply cup.panels=3 ", "brafit cup.panels=3 "),
        ("brafit -m a.ply cup.p", "brafit -m cup.p"),
        ("brafit --cfg job solver=lm x", "brafit solver=lm x"),
        ("brafit 'out=my results' cup.p", "brafit cup.p"),
        ("brafit -", None),
        ("brafit 'a b", None),
    ],
)
def test_hydra_is_shown_settings_only(line: str, read: str | None) -> None:
    assert readable_line(line) == read
