"""Open3D, imported on first use, with its messages caught instead of printed."""

from __future__ import annotations

import io
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from types import ModuleType

from brafit.errors import BrafitError

LIBRARIES = {
    "libGL.so": "libgl1",
    "libEGL.so": "libegl1",
    "libX11.so": "libx11-6",
    "libudev.so": "libudev1",
    "libusb-1.0.so": "libusb-1.0-0",
    "libgomp.so": "libgomp1",
}
"""Shared libraries that Open3D's wheel expects from the system, and the Debian packages that hold them."""

_lock = threading.Lock()


class Open3DError(BrafitError):
    """Open3D cannot be imported; the message names what to install."""


def open3d() -> ModuleType:
    """The `open3d` module. It costs a second, once.

    Raises:
        Open3DError: the module, or a system library that it needs, is missing.
    """
    try:
        import open3d as module
    except ModuleNotFoundError as error:
        raise Open3DError(f"Open3D cannot be loaded: {error}. Run: pip install open3d-cpu") from error
    except (ImportError, OSError) as error:
        raise Open3DError(_missing_library(str(error))) from error
    return module


def _missing_library(reason: str) -> str:
    named = next((package for library, package in LIBRARIES.items() if library in reason), None)
    what = f"Open3D cannot be loaded: {' '.join(reason.split())}"
    hint = f" (Debian package {named})" if named else ""
    return f"{what}{hint}. Run: apt-get install -y {' '.join(LIBRARIES.values())}"


class Messages:
    """What a library said while it was watched; `text` is complete once the block has ended."""

    def __init__(self) -> None:
        self.text = ""

    def lines(self) -> list[str]:
        """The messages, one a line, without colours and the sender's name."""
        plain = re.sub(r"\x1b\[[0-9;]*m", "", self.text)
        plain = re.sub(r"^(\[Open3D \w+\]|RPly:) *", "", plain, flags=re.MULTILINE)
        printable = ("".join(c if c.isprintable() else "?" for c in line).strip() for line in plain.splitlines())
        return [line for line in printable if line]


@contextmanager
def listening() -> Iterator[Messages]:
    """Catch what Open3D logs (through `sys.stdout`) and what its C libraries print (on file descriptor 2).

    One block at a time: both are shared by the whole process.
    """
    messages = Messages()
    log = io.StringIO()
    with _lock, tempfile.TemporaryFile() as printed:
        with redirect_stdout(log), _stderr_into(printed.fileno()):
            yield messages
        printed.seek(0)
        messages.text = printed.read().decode(errors="replace") + log.getvalue()


@contextmanager
def _stderr_into(descriptor: int) -> Iterator[None]:
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:  # a process without a standard error: nothing to keep
        yield
        return
    try:
        os.dup2(descriptor, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
