"""Three bundled breasts: small and young, medium and middle-aged, large and old (CC0-1.0, see README.md here)."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def sample_paths() -> list[Path]:
    """The bundled clouds, sorted by name; each has its landmark file beside it."""
    folder = Path(str(resources.files(__name__)))
    return sorted(folder.glob("*.ply"))
