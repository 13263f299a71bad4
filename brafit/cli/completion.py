"""Tab completion in a shell (`brafit -sc install=bash`): Hydra's own, of the command lines that brafit takes.

Hydra reads settings alone. Scans that are named without `scans=`, and options with a value, are taken out of its way.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
from collections.abc import Callable, Sequence

from brafit.cli.arguments import is_setting, parted
from brafit.settings.compose import readable_settings

_LINE = "COMP_LINE"
_OWN = re.compile(r"_schema$|\._(target|partial)_=$")
"""Endings of what Hydra offers and nobody types: the types of the settings, and the classes that are built of them."""


def is_query(arguments: Sequence[str]) -> bool:
    """Whether a shell asks what a command line may go on with."""
    asked = bool({"-sc", "--shell-completion"} & set(arguments))
    return asked and _LINE in os.environ and any(word.startswith("query=") for word in arguments)


def answer(query: Callable[[], object]) -> None:
    """Print what may follow on the command line of the environment.

    Where nothing is known, nothing is said, so that the shell offers files.

    Args:
        query: prints Hydra's answer to the line of the environment.
    """
    line = readable_line(os.environ[_LINE])
    if line is None:
        return
    os.environ[_LINE] = line
    with contextlib.suppress(Exception), contextlib.redirect_stdout(io.StringIO()) as said:
        query()
    print(" ".join(word for word in said.getvalue().split() if not _OWN.search(word)))


def readable_line(line: str) -> str | None:
    """A command line as Hydra can complete it; None where its last word is none of Hydra's: an option, or in quotes."""
    last = re.split(r"\s", line)[-1]
    try:
        command, *words = shlex.split(line.removesuffix(last))
    except ValueError:  # a quote is open, or the command itself is being typed
        return None
    if last.startswith("-"):
        return None
    options, others = parted(words)
    settings = [word for word in others if is_setting(word) and not re.search(r"\s", word)]
    sweep = ["-m"] if {"-m", "--multirun"} & set(options) else []
    return " ".join([command, *sweep, *readable_settings(settings), last])
