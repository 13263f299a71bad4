"""brafit: brassiere cups of developable panels, from a scan to flat patterns.

result = brafit.fit("scan.ply")  # or a Scan, or points and wire as arrays
result.save("folder")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brafit.api import fit, layer

__version__ = "0.1.0"
__all__ = ["__version__", "fit", "layer"]


def __getattr__(name: str) -> Any:
    """Import `brafit.fit` when it is asked for: it loads NumPy, for which the command's help need not wait."""
    if name in ("fit", "layer"):
        from brafit import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
