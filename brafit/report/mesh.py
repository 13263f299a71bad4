"""The cup as a triangle mesh, and cup and points as PLY, OBJ and GLB files.

The writers are our own: a header and a few NumPy arrays is all that the formats need, and the ready-made package for
PLY (plyfile) is under the GPL, which does not go with this package's licence.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int, Int32, Shaped, UInt8
from numpy import ndarray

from brafit.atomic import write_bytes, write_text
from brafit.cup.shape import CupShape
from brafit.pattern.piece import Piece, Side
from brafit.report.colour import PANELS, STEPS, distance_colours

DOTS = 4000
"""Points of a cloud that `mesh_view` shows at most."""
# The viewer looks along -z with y up: the bottom of the wire (+x of the cup frame) downwards, the chest behind.
_UPRIGHT = np.array(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))

Place = Callable[[Float[ndarray, "n 3"]], Float[ndarray, "n 3"]]
"""An isometry from the cup frame to the frame that is written, such as the scan's; it may mirror (right cups)."""


@dataclass(frozen=True)
class Mesh:
    """Triangles whose corners run counter-clockwise seen from outside the cup.

    Attributes:
        vertices: positions in mm.
        normals: unit outward surface normals. Vertices on a ridge are there once for each of its two panels.
        panel: the panel that each vertex belongs to, 0 at the wire.
        faces: indices of vertices.
    """

    vertices: Float[ndarray, "v 3"]
    normals: Float[ndarray, "v 3"]
    panel: Int[ndarray, " v"]
    faces: Int[ndarray, "f 3"]


def cup_mesh(shape: CupShape, strips: int = 8, place: Place | None = None) -> Mesh:
    """Triangulate a cup of one fit (no batch dimension).

    Args:
        shape: the cup; lengths in mm.
        strips: rows of triangles across each panel, from edge to edge.
        place: where the mesh is to lie; None is the cup frame. A map that mirrors keeps the faces' outward side.
    """
    edges, normals = (tensor.detach().cpu().double().numpy() for tensor in (shape.edges, shape.normals))
    vertices, directions, faces, count = [], [], [], 0
    for lower, upper, normal in zip(edges[:-1], edges[1:], normals, strict=True):
        panel_vertices, panel_normals = _panel_vertices(lower, upper, normal, strips)
        vertices.append(panel_vertices)
        directions.append(panel_normals)
        faces.append(panel_faces(len(lower), strips) + count)
        count += len(panel_vertices)
    panel = np.repeat(np.arange(len(vertices)), [len(v) for v in vertices])
    mesh = Mesh(np.concatenate(vertices), np.concatenate(directions), panel, np.concatenate(faces))
    return mesh if place is None else _placed(mesh, place)


def write_cup_ply(path: str | Path, shape: CupShape, place: Place | None = None, strips: int = 8) -> None:
    """Write a cup's panels as one mesh, binary PLY; arguments as for `cup_mesh`.

    Vertex properties: x y z nx ny nz (double), red green blue (uchar), panel (int, 0 at the wire).
    """
    mesh = cup_mesh(shape, strips, place)
    fields = [*_columns("x y z", "<f8", mesh.vertices), *_columns("nx ny nz", "<f8", mesh.normals)]
    fields += _columns("red green blue", "u1", PANELS[mesh.panel % len(PANELS)])
    fields += _columns("panel", "<i4", mesh.panel[:, None])
    write_bytes(path, _ply(_structured(fields), mesh.faces, "bra cup, panels from the wire up, mm"))


def write_points_ply(path: str | Path, points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"]) -> None:
    """Write the scan's points with their signed distances from the cup, binary PLY.

    Vertex properties: x y z (double), distance (float, mm, positive outside the cup), red green blue (uchar).

    Args:
        path: the file; missing folders are made, and it is never there in part.
        points: mm, in the frame that is to be written.
        distances: mm.

    Raises:
        ValueError: not as many distances as points.
    """
    points, distances = np.asarray(points, float), np.asarray(distances, float)
    if len(points) != len(distances):
        raise ValueError(f"{len(points)} points but {len(distances)} distances")
    fields = [*_columns("x y z", "<f8", points), *_columns("distance", "<f4", distances[:, None])]
    fields += _columns("red green blue", "u1", distance_colours(distances))
    steps = ", ".join(f"{step:g}" for step in STEPS)
    comment = f"distance from the cup in mm, colours in steps at {steps}: blue inside, red outside"
    write_bytes(path, _ply(_structured(fields), None, comment))


@dataclass(frozen=True)
class PanelMesh:
    """One panel in space and flat.

    Attributes:
        name: its piece's name.
        vertices, normals, faces: as in `Mesh`.
        flat: each vertex's place in the flat pattern (the sewing lines, without ease), mm.
        strips: rows of triangles from edge to edge.
    """

    name: str
    vertices: Float[ndarray, "v 3"]
    normals: Float[ndarray, "v 3"]
    flat: Float[ndarray, "v 2"]
    faces: Int[ndarray, "f 3"]
    strips: int

    @property
    def lower(self) -> Int[ndarray, " n"]:
        """Numbers of the lower edge's vertices, from the inner end."""
        return self._edge(0)

    @property
    def upper(self) -> Int[ndarray, " n"]:
        """Numbers of the upper edge's vertices, from the inner end."""
        return self._edge(self.strips)

    def _edge(self, row: int) -> Int[ndarray, " n"]:
        last = len(self.vertices) - 1
        return np.concatenate(([0], np.arange(1 + row, last, self.strips + 1), [last]))


def object_name(mesh: PanelMesh) -> str:
    """What the OBJ file calls a panel."""
    return "_".join(mesh.name.split())


def panel_meshes(
    shape: CupShape, pieces: Sequence[Piece], strips: int = 8, place: Place | None = None
) -> list[PanelMesh]:
    """A mesh for each panel, its vertices also in the flat pattern.

    Args:
        shape: one cup (no batch dimension), cup frame, mm.
        pieces: from `pieces_from_panels`, of the same cup.
        strips: rows of triangles across each panel.
        place: from the cup frame to the frame that is wanted; None: the cup frame.
    """
    mesh = cup_mesh(shape, strips, place)
    meshes = []
    for i, piece in enumerate(pieces):
        lower, upper = piece.edges[0].points, piece.edges[1].points[::-1]
        flat, _ = _panel_vertices(lower, upper, np.zeros_like(lower), strips)
        own = mesh.panel == i
        first = int(np.argmax(own))
        faces = mesh.faces[own[mesh.faces[:, 0]]] - first
        meshes.append(PanelMesh(piece.name, mesh.vertices[own], mesh.normals[own], flat, faces, strips))
    return meshes


def write_cup_obj(path: str | Path, meshes: Sequence[PanelMesh]) -> None:
    """Write panels as Wavefront OBJ: an object a panel, millimetres, texture coordinates the flat pattern in mm.

    With nine digits, so that the angles of the tiny triangles at the tips are still those of a developable surface.
    """
    parts, first = ["# brafit: bra cup, an object a panel; vt is the flat pattern; mm\n"], 1
    for mesh in meshes:
        parts.append(f"o {object_name(mesh)}\n")
        parts.append(_rows("v %.9f %.9f %.9f\n", mesh.vertices))
        parts.append(_rows("vt %.9f %.9f\n", mesh.flat))
        parts.append(_rows("vn %.6f %.6f %.6f\n", mesh.normals))
        parts.append(_rows("f %d/%d/%d %d/%d/%d %d/%d/%d\n", np.repeat(mesh.faces + first, 3, axis=1)))
        first += len(mesh.vertices)
    write_text(path, "".join(parts))


def write_cup_glb(path: str | Path, meshes: Sequence[PanelMesh]) -> None:
    """Write panels as binary glTF 2.0: a node a panel; TEXCOORD_0 is the flat pattern in mm.

    Positions are mm too; as glTF's unit is the metre, the root node scales them by 1/1000.
    """
    body, views, accessors, nodes, entries, materials = b"", [], [], [], [], []

    def add(values: ndarray, kind: str, target: int, **extra: list[float]) -> int:
        nonlocal body
        data = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data), "target": target})
        body += data + b"\0" * (-len(data) % 4)
        component = 5125 if values.dtype == np.uint32 else 5126
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        accessors[-1] |= extra
        return len(accessors) - 1

    for i, mesh in enumerate(meshes):
        positions = mesh.vertices.astype("<f4")
        limits = {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()}
        attributes = {
            "POSITION": add(positions, "VEC3", 34962, **limits),
            "NORMAL": add(mesh.normals.astype("<f4"), "VEC3", 34962),
            "TEXCOORD_0": add(mesh.flat.astype("<f4"), "VEC2", 34962),
        }
        indices = add(mesh.faces.astype("<u4").ravel(), "SCALAR", 34963)
        primitive = {"attributes": attributes, "indices": indices, "material": i}
        entries.append({"name": mesh.name, "primitives": [primitive]})
        nodes.append({"name": mesh.name, "mesh": i})
        colour = [*(PANELS[i % len(PANELS)] / 255).tolist(), 1.0]
        surface = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.9}
        materials.append({"name": mesh.name, "pbrMetallicRoughness": surface, "doubleSided": True})
    root = {"name": "cup", "children": list(range(len(nodes))), "scale": [0.001] * 3}
    scene = {
        "asset": {"version": "2.0", "generator": "brafit", "extras": {"TEXCOORD_0": "flat pattern in mm"}},
        "scene": 0,
        "scenes": [{"nodes": [len(nodes)]}],
        "nodes": [*nodes, root],
        "meshes": entries,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    text = json.dumps(scene, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    write_bytes(path, struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def mesh_view(
    shape: CupShape, points: Float[ndarray, "n 3"], distances: Float[ndarray, " n"], side: Side = "left"
) -> tuple[Float32[ndarray, "v 3"], UInt8[ndarray, "v 3"], Int32[ndarray, "f 3"]]:
    """A cup and its cloud, coloured by distance, as one mesh about the origin: vertices, colours, faces.

    x runs to the right, y up and z to the viewer. Viewers such as TensorBoard's show either points or faces, so every
    point becomes a small tetrahedron.

    Args:
        shape: the cup, cup frame, mm.
        points: cup frame, mm. At most `DOTS` of them, evenly chosen, are shown.
        distances: mm, positive outside the cup.
        side: right cups, which are fitted as left ones, are shown as they are worn.
    """
    worn = np.array((1.0, -1.0 if side == "right" else 1.0, 1.0))
    cup = cup_mesh(shape, strips=6, place=lambda x: x * worn)
    chosen = np.unique(np.linspace(0, len(points) - 1, min(len(points), DOTS)).astype(int))
    size = 0.004 * float(np.ptp(cup.vertices, axis=0).max())
    dots, faces = _tetrahedra(points[chosen] * worn, size)
    vertices = np.vstack((cup.vertices, dots))
    centre = (vertices.min(0) + vertices.max(0)) / 2
    colours = np.repeat(distance_colours(distances[chosen]), 4, axis=0)
    return (
        ((vertices - centre) @ _UPRIGHT.T).astype(np.float32),
        np.vstack((PANELS[cup.panel % len(PANELS)], colours)).astype(np.uint8),
        np.vstack((cup.faces, faces + len(cup.vertices))).astype(np.int32),
    )


def is_mirror(place: Place) -> bool:
    """Whether an isometry turns left hands into right ones."""
    corners = place(np.vstack((np.zeros(3), np.eye(3))))
    return bool(np.linalg.det(corners[1:] - corners[0]) < 0)


def _panel_vertices(
    lower: ndarray, upper: ndarray, normal: ndarray, strips: int
) -> tuple[Float[ndarray, "v k"], Float[ndarray, "v k"]]:
    """First tip, the inner stations' rulings (strips + 1 points each), last tip; a ruling has one normal."""
    share = np.linspace(0, 1, strips + 1)[None, :, None]
    rulings = (1 - share) * lower[1:-1, None] + share * upper[1:-1, None]
    tips = (lower + upper)[[0, -1]] / 2  # the two meet there, up to what the fit left open
    normals = np.repeat(normal[1:-1], strips + 1, axis=0)
    return np.vstack((tips[:1], rulings.reshape(-1, lower.shape[1]), tips[1:])), np.vstack(
        (normal[:1], normals, normal[-1:])
    )


def panel_faces(stations: int, strips: int) -> Int[ndarray, "f 3"]:
    """The triangles of a panel whose vertices are its first tip, `strips` + 1 points across it at every inner station
    from the lower edge to the upper, and its last tip.

    Args:
        stations: along the edges, tips included.
        strips: rows of triangles from edge to edge.
    """
    columns, rows = stations - 2, strips + 1
    last = columns * rows + 1
    k, i = (index.ravel() for index in np.meshgrid(np.arange(columns - 1), np.arange(strips), indexing="ij"))
    a = 1 + k * rows + i
    b, c, d = a + rows, a + rows + 1, a + 1  # along the edge, then across the panel
    i = np.arange(strips)
    first_fan = np.stack((np.zeros_like(i), 1 + i, 2 + i), -1)
    last_fan = np.stack((last - rows + i, np.full_like(i, last), last - rows + i + 1), -1)
    return np.vstack((first_fan, np.stack((a, b, c), -1), np.stack((a, c, d), -1), last_fan))


def _placed(mesh: Mesh, place: Place) -> Mesh:
    vertices = place(mesh.vertices)
    normals = place(mesh.vertices + mesh.normals) - vertices
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)  # the frame that is written may have another unit
    faces = mesh.faces[:, ::-1] if is_mirror(place) else mesh.faces
    return Mesh(vertices, normals, mesh.panel, faces)


def _tetrahedra(centres: Float[ndarray, "n 3"], size: float) -> tuple[Float[ndarray, "4*n 3"], Int[ndarray, "4*n 3"]]:
    """Vertices and outward faces."""
    corners = size * np.array(((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)))
    faces = np.array(((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)))
    vertices = (centres[:, None] + corners).reshape(-1, 3)
    return vertices, (faces + 4 * np.arange(len(centres))[:, None, None]).reshape(-1, 3)


def _columns(names: str, kind: str, values: ndarray) -> Iterable[tuple[str, str, ndarray]]:
    return ((name, kind, values[:, i]) for i, name in enumerate(names.split()))


def _structured(fields: Iterable[tuple[str, str, ndarray]]) -> ndarray:
    fields = list(fields)
    array = np.empty(len(fields[0][2]), dtype=[(name, kind) for name, kind, _ in fields])
    for name, _, values in fields:
        array[name] = values
    return array


def _rows(form: str, values: Shaped[ndarray, "n k"]) -> str:
    """A line of text for each row."""
    return form * len(values) % tuple(values.ravel().tolist())


def _ply(vertices: ndarray, faces: ndarray | None, comment: str) -> bytes:
    types = {"<f8": "double", "<f4": "float", "<i4": "int", "|u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"comment brafit: {comment}", f"element vertex {len(vertices)}"]
    header += [f"property {types[entry[1]]} {entry[0]}" for entry in vertices.dtype.descr]
    body = vertices.tobytes()
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, faces
        body += rows.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body
