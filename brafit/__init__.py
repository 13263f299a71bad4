"""brafit: brassiere cups of developable panels, from a scan to flat patterns.

result = brafit.fit(points, wire=wire)
result.save("folder")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brafit.face import fit

__version__ = "0.1.0"
__all__ = ["__version__", "fit"]


def __getattr__(name: str) -> Any:
    """Import `brafit.fit` when it is asked for: it takes seconds, which the command's help need not wait for."""
    if name == "fit":
        return import_module("brafit.fit")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
