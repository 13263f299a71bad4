"""How the smaller commands end: one line for what went wrong, and an exit status as `brafit`'s."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable

from brafit.cli.status import INTERRUPTED, NOTHING_RAN
from brafit.errors import BrafitError
from brafit.naming import print_anything


def end_with(name: str, work: Callable[[], int], kept: str) -> None:
    """Do a command's work and leave with the status that it gives.

    Args:
        name: of the command, before what it says on the error stream.
        work: gives the exit status.
        kept: what an interruption does not touch, such as "files".
    """
    print_anything()
    try:
        sys.exit(work())
    except KeyboardInterrupt:
        print(f"{name}: interrupted; the {kept} that are finished are kept", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except (BrafitError, OSError) as error:
        print(f"{name}: {in_options(error)}", file=sys.stderr)
        sys.exit(NOTHING_RAN)


def in_options(error: Exception) -> str:
    """What an error says, with the options that commands without settings have for these: `--units in` for
    `scan.units=in`.
    """
    return re.sub(r"\bscan\.(units|side|wire)\b(?:=(?=\w))?", _option, str(error))


def _option(setting: re.Match[str]) -> str:
    return f"--{setting[1]}{' ' if setting[0].endswith('=') else ''}"
