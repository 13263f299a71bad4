"""Open3D, imported on first use."""

from __future__ import annotations

from types import ModuleType

from brafit.errors import BrafitError

LIBRARIES = {
    "libGL.so": "libgl1",
    "libEGL.so": "libegl1",
    "libX11.so": "libx11-6",
    "libudev.so": "libudev1",
    "libusb-1.0.so": "libusb-1.0-0",
    "libidn2.so": "libidn2-0",
    "libgomp.so": "libgomp1",
}
"""Shared libraries that Open3D's wheel expects from the system, and the Debian packages that hold them."""


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
