"""Open3D, imported on first use."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

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


_PLOTS = "open3d.visualization.draw_plotly"
"""Drawing in a browser, with Dash and Plotly: as long to import as all the rest, and nothing here draws that way."""


class Open3DError(BrafitError):
    """Open3D cannot be imported; the message names what to install."""


def open3d() -> ModuleType:
    """The `open3d` module. It costs a second, once; its drawing in browsers is loaded when it is called.

    Raises:
        Open3DError: the module, or a system library that it needs, is missing.
    """
    if "open3d" not in sys.modules:
        sys.modules[_PLOTS] = _Plots()
    try:
        import open3d as module
    except ModuleNotFoundError as error:
        raise Open3DError(f"Open3D cannot be loaded: {error}. Run: pip install open3d-cpu") from error
    except (ImportError, OSError) as error:
        raise Open3DError(_missing_library(str(error))) from error
    return module


class _Plots(ModuleType):
    """Stands for the module until one of its functions is called.

    Attributes:
        names: of the functions that were asked for.
    """

    def __init__(self) -> None:
        super().__init__(_PLOTS)
        self.names: set[str] = set()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("__"):
            raise AttributeError(name)
        self.names.add(name)

        def called(*arguments: Any, **more: Any) -> Any:
            if sys.modules.get(_PLOTS) is self:
                del sys.modules[_PLOTS]
            module, package = importlib.import_module(_PLOTS), sys.modules[_PLOTS.rpartition(".")[0]]
            for each in self.names:  # importing a module puts it into its package, in place of a function of its name
                setattr(package, each, getattr(module, each))
            return getattr(module, name)(*arguments, **more)

        return called


def _missing_library(reason: str) -> str:
    named = next((package for library, package in LIBRARIES.items() if library in reason), None)
    what = f"Open3D cannot be loaded: {' '.join(reason.split())}"
    hint = f" (Debian package {named})" if named else ""
    return f"{what}{hint}. Run: apt-get install -y {' '.join(LIBRARIES.values())}"
