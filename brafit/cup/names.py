"""What the panels and edges of a cup are called, on its pieces and in everything that is said of it."""

from __future__ import annotations

WIRE, UPPER = "wire", "upper edge"


def panel_names(count: int) -> list[str]:
    """Of the panels of a cup of that many, from the wire up."""
    named = {1: ["panel"], 2: ["lower panel", "upper panel"], 3: ["lower panel", "middle panel", "upper panel"]}
    return named.get(count, [f"panel {i + 1}" for i in range(count)])


def edge_names(count: int) -> list[str]:
    """Of the edges of a cup of that many panels, from the wire up."""
    seams = ["seam"] if count == 2 else [f"seam {i + 1}" for i in range(count - 1)]
    return [WIRE, *seams, UPPER]
