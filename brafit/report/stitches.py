"""The stitch list: which edge of which piece is sewn to which, by the vertices of the OBJ file.

For CLO, Blender and simulators that sew flat pieces: both sides of a seam have as many vertices, in the same order, so
that vertex k of one side is sewn to vertex k of the other.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from brafit.atomic import write_text
from brafit.pattern.finish import Pattern
from brafit.report.mesh import PanelMesh, object_name


def write_stitches(path: str | Path, meshes: Sequence[PanelMesh], pattern: Pattern, mesh_file: str) -> None:
    """Write the stitch list of one cup as JSON.

    `pieces`: name, `object` in the OBJ file, and `edges`, each with its kind, `length_mm` (before ease) and `vertices`,
    numbered as in the OBJ file, from the centre front to the side seam. `seams`: name and `sides`, piece and edge.
    Every edge's first vertices are one corner of the cup, their last ones the other.

    Args:
        path: the file.
        meshes: from `panel_meshes`, as the OBJ file has them.
        pattern: finished pieces of the same cup.
        mesh_file: name of the OBJ file.
    """
    pieces: list[dict[str, Any]] = []
    sides: dict[str, list[dict[str, str]]] = {}
    first = 1
    for mesh, piece in zip(meshes, pattern.pieces, strict=True):
        edges = []
        for line, own in zip(piece.sew, (mesh.lower, mesh.upper), strict=True):
            length = pattern.seams[line.name][len(sides.get(line.name, []))]
            numbers = [int(k) + first for k in own]
            edges.append({"name": line.name, "kind": line.kind, "length_mm": round(length, 4), "vertices": numbers})
            sides.setdefault(line.name, []).append({"piece": piece.name, "edge": line.name})
        pieces.append({"name": piece.name, "object": object_name(mesh), "edges": edges})
        first += len(mesh.vertices)
    seams = [{"name": name, "sides": both} for name, both in sides.items() if len(both) > 1]
    about = {"format": "brafit stitch list 1", "units": "mm", "mesh": mesh_file, "flat": "texture coordinates, mm"}
    write_text(path, json.dumps({**about, "pieces": pieces, "seams": seams}, separators=(",", ":")) + "\n")
