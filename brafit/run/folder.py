"""The folder of a run's results: whether they can be written there, and what to say where they cannot."""

from __future__ import annotations

import contextlib
import errno
import tempfile
from pathlib import Path
from typing import TypeGuard

from brafit.errors import ConfigError

ROOM = 2**20
"""Bytes that must be free on a disk that a run begins on; a scan's results are about as large."""
_SHOWN = 80
_CAUSES = {
    errno.EACCES: ("there is no permission to write in {place}", "take another out, or have it allowed"),
    errno.EPERM: ("there is no permission to write in {place}", "take another out, or have it allowed"),
    errno.EROFS: ("{place} can only be read", "take another out"),
    errno.ENOSPC: ("the disk of {place} is full", "make room, or take another out"),
    errno.EDQUOT: ("no more may be stored in {place}", "make room, or take another out"),
    errno.EFBIG: ("no file may be that large in {place}", "take another out"),
    errno.ENAMETOOLONG: ("the path is too long", "take a shorter out"),
}


def make_writable(out: Path) -> None:
    """Make a run's folder, and be sure that results can be written into it.

    Raises:
        ConfigError: they cannot; says why, and what to do.
    """
    made = not _there(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out) as trial:
            trial.write(bytes(ROOM))
            trial.flush()
    except (OSError, ValueError) as error:
        if made:
            with contextlib.suppress(OSError, ValueError):
                out.rmdir()
        raise ConfigError(why_not(out, error)) from error


def why_not(out: Path, error: OSError | ValueError) -> str:
    """One line for a folder that cannot be written to."""
    shown = str(out) if len(str(out)) <= _SHOWN else f"{str(out)[:_SHOWN]}..."
    place = next(part for part in (out, *out.parents) if _there(part))
    if not place.is_dir():
        what = "is in the way: it is no folder" if place == out else "is no folder, so nothing can be in it"
        return f"out={shown}: {place} {what}; take another out"
    code = error.errno if isinstance(error, OSError) else None
    cause, remedy = _CAUSES.get(code or 0, (_plain(error), "take another out"))
    return f"out={shown}: {cause.format(place=place)}; {remedy}"


def is_about_writing(error: BaseException) -> TypeGuard[OSError]:
    """Whether an error says that a disk or folder takes no more."""
    return isinstance(error, OSError) and error.errno in _CAUSES


def _there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def _plain(error: OSError | ValueError) -> str:
    words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"no folder can be made or written to there ({words[:1].lower()}{words[1:]})"
