"""Files that are either whole or absent: written under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from brafit.naming import shown

TEMPORARY = ".writing-"
"""How the names of files begin that are not whole yet."""


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Temporary path to write to in the `with` block; it becomes `path` when the block ends without an error.

    The temporary name is hidden, keeps the suffix (libraries choose a format by it) and lies in the same folder, so
    that the rename cannot be torn apart by a crash. Missing folders are made. An error leaves `path` as it was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f"{TEMPORARY}{uuid.uuid4().hex[:12]}{path.suffix}"
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a binary file in one piece."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file in one piece, line ends as they are in `text`.

    What UTF-8 cannot hold, as in names of files whose bytes were no text, becomes a replacement sign.
    """
    write_bytes(path, shown(text).encode("utf-8"))
