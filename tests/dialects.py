"""Meshes written in the many ways that their formats allow."""

from __future__ import annotations

import base64
import itertools
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Known:
    """Vertices that single precision holds exactly, and polygons."""

    vertices: np.ndarray
    polygons: Sequence[Sequence[int]]


def write_obj(path: Path, mesh: Known, draw: Any) -> Path:
    """`draw(values)` chooses one of some values, here as below."""
    groups = draw((1, 2, 5))
    relative = draw((False, True))
    decorate = draw(("{}", "{}/{}", "{}//{}", "{}/{}/{}"))
    form = draw(("{:.17g}", "{:+.16e}", "{!r}"))
    tail = draw(("", "", " 1", " 1.0", " 0.5 0.25 1", " 0.1 0.2 0.3 1"))
    lines = [draw(("# made by hand", "", "mtllib no such file.mtl", "\t# indented"))]
    last = [max(polygon) for polygon in mesh.polygons]
    done: set[int] = set()
    ends = np.linspace(0, len(mesh.vertices), groups + 1).astype(int)
    for begin, end in itertools.pairwise(ends):
        lines += [draw(("g part 1#2", "o it", "s off", "usemtl skin", "vn 0 0 1", "vt 0.5 0.5"))]
        for vertex in mesh.vertices[begin:end]:
            lines.append("v " + " ".join(form.format(float(x)) for x in vertex) + tail)
        for k, polygon in enumerate(mesh.polygons):
            if last[k] < end and k not in done:
                done.add(k)
                names = [corner - end if relative and draw((True, False)) else corner + 1 for corner in polygon]
                lines.append("f " + " ".join(decorate.format(name, name, name) for name in names))
    lines += [draw(("l 1 2", "p 1", "# the end", ""))]
    return _write_lines(path, lines, draw, comment=" # as measured", joining="\\")


def write_off(path: Path, mesh: Known, draw: Any) -> Path:
    counts = f"{len(mesh.vertices)} {len(mesh.polygons)}" + draw(("", " 0", " 12"))
    lines = draw(([f"OFF {counts}"], ["OFF", counts], ["# a comment", "OFF", "", counts]))
    colour = draw(("", " 255 0 0 255"))
    lines += [" ".join(repr(float(x)) for x in vertex) + colour for vertex in mesh.vertices]
    lines += [f"{len(polygon)} {' '.join(map(str, polygon))}" + draw(("", " 0.5 0.5 0.5")) for polygon in mesh.polygons]
    return _write_lines(path, lines, draw, comment=" # as measured")


def _write_lines(path: Path, lines: list[str], draw: Any, comment: str, joining: str = "") -> Path:
    gap, begin, end = draw((" ", "\t", "   ", " \t")), draw(("", "  ", "\t")), draw(("\n", "\r\n", "\r"))
    comment = draw(("", comment))
    written = []
    for line in lines:
        words = line.split()
        if joining and words and words[0] in ("v", "f") and draw((False, False, True)):
            words.insert(2, joining + end)
        written.append(begin + gap.join(words) + comment)
    mark = draw((b"", b"\xef\xbb\xbf"))
    path.write_bytes(mark + (end.join(written) + draw(("", end, end + end))).encode("latin-1"))
    return path


TYPES = {"<f4": ("float", "float32"), "<f8": ("double", "float64"), "<i4": ("int", "int32"), "<u4": ("uint", "uint32")}
TYPES |= {"<u1": ("uchar", "uint8"), "<i1": ("char", "int8"), "<i2": ("short", "int16"), "<u2": ("ushort", "uint16")}


def write_ply(path: Path, mesh: Known, draw: Any) -> Path:
    order = draw(("", "<", ">"))
    kinds = {name: draw(("<f4", "<f8")) for name in "xyz"} | {"red": "<u1", "quality": "<f4"}
    names = draw((("x", "y", "z"), ("red", "z", "x", "quality", "y"), ("y", "x", "z", "red")))
    rows: list[list[tuple[str, Any]]] = [
        [(kinds[n], v["xyz".index(n)] if n in "xyz" else 7) for n in names] for v in mesh.vertices
    ]
    header = [[f"property {draw(TYPES[kinds[name]])} {name}" for name in names]]
    if draw((False, True)):
        header[0].append("property list uchar int near")
        rows = [[*row, ("list <u1 <i4", list(range(k % 3)))] for k, row in enumerate(rows)]
    count, corner = draw(("<u1", "<i4", "<u2", "<i1")), draw(("<i4", "<u4", "<u2"))
    corners = draw(("vertex_indices", "vertex_index"))
    header.append([f"property list {draw(TYPES[count])} {draw(TYPES[corner])} {corners}"])
    faces: list[list[tuple[str, Any]]] = [[(f"list {count} {corner}", list(polygon))] for polygon in mesh.polygons]
    if draw((False, True)):
        header[1].append("property list uchar float texcoord")
        faces = [[*face, ("list <u1 <f4", [0.5] * (6 * draw((0, 1))))] for face in faces]
    if draw((False, True)):
        header[1].insert(0, "property uchar flags")
        faces = [[("<u1", 3), *face] for face in faces]
    elements = [("vertex", header[0], rows), ("face", header[1], faces)]
    if draw((False, True)):
        elements.append(("material", ["property int shine"], [[("<i4", 3)]] * 2))
    elements = elements[:: draw((1, -1))]
    end = draw(("\n", "\r\n", "\r"))
    form = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {form} 1.0", draw(("comment TextureFile büste.png", "obj_info made by hand"))]
    for name, properties, content in elements:
        lines += [f"element {name} {len(content)}", *properties]
    data = (end.join([*lines, "end_header"]) + end).encode(draw(("latin-1", "utf-8")))
    for _, _, content in elements:
        for row in content:
            data += _ply_row(row, order, end)
    path.write_bytes(data.removesuffix(end.encode()) if order == "" and draw((False, True)) else data)
    return path


def _ply_row(row: list[tuple[str, Any]], order: str, end: str) -> bytes:
    words, data = [], b""
    for kind, value in row:
        values = [(kind, value)]
        if kind.startswith("list"):
            _, counted, item = kind.split()
            values = [(counted, len(value)), *((item, each) for each in value)]
        for each, number in values:
            data += np.array(number).astype(each).astype(order + each[1:] if order else each).tobytes()
            words.append(repr(float(number)) if "f" in each else str(int(number)))
    return data if order else (" ".join(words) + end).encode()


def write_stl(path: Path, mesh: Known, draw: Any) -> Path:
    """Triangles only."""
    corners = mesh.vertices[np.array(mesh.polygons)]
    if draw((True, False)):
        head = draw((b"solid made by a program", b"COLOR=\xff\xff\xff\xff", b"")).ljust(80, draw((b"\0", b" ")))
        body = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), draw((0, 31))) for triangle in corners)
        data = head + struct.pack("<I", len(corners)) + body
        path.write_bytes(data + draw((b"", b"\0" * 128, b"\0" * 50, b"\n", b"made by hand")))
        return path
    form = draw(("{:.16e}", "{!r}", "{:+.17g}"))
    normal = draw(("0 0 1", "nan nan nan", "-1.#IND -1.#IND -1.#IND"))
    lines = [draw(("solid", "solid facet of vertex 7", "SOLID x"))]
    for triangle in corners:
        lines += [f"facet normal {normal}", "outer loop"]
        lines += ["vertex " + " ".join(form.format(float(x)) for x in corner) for corner in triangle]
        lines += ["endloop", "endfacet"]
        if draw((False, False, False, True)):
            lines += ["endsolid x", "solid y"]
    return _write_lines(path, [*lines, draw(("endsolid", "endsolid x y"))], draw, comment="")


INDEX_KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4"}


def write_gltf(path: Path, mesh: Known, draw: Any) -> tuple[Path, np.ndarray, np.ndarray]:
    """Triangles only, as .glb or .gltf. The file; its vertices as they are in the scene, and the triangles."""
    vertices, triangles = mesh.vertices, np.array(mesh.polygons)
    component, normalised = draw(((5126, False), (5122, True), (5123, True), (5120, True), (5122, False)))
    scale = np.ones(3)
    if component != 5126:
        kind = {5120: "i1", 5122: "i2", 5123: "u2"}[component]
        most = np.iinfo(kind).max
        span = np.abs(vertices).max() or 1.0
        stored = np.round((vertices / span) * most if kind[0] == "i" else (vertices / span + 1) / 2 * most).astype(
            "<" + kind
        )
        scale = np.array([2.0, 3.0, 0.5])
        vertices = stored / most if normalised else stored.astype(float)
    else:
        stored = vertices.astype("<f4")
    data, views = b"", []

    def view(array: np.ndarray, stride: int = 0) -> int:
        nonlocal data
        row = np.ascontiguousarray(array).reshape(len(array), -1).view(np.uint8)
        rows = np.zeros((len(row), max(stride, row.shape[1])), np.uint8)
        rows[:, : row.shape[1]] = row
        data += bytes(-len(data) % 4)
        views.append(
            {
                "buffer": 0,
                "byteOffset": len(data),
                "byteLength": rows.size,
                **({"byteStride": stride} if stride else {}),
            }
        )
        data += rows.tobytes()
        return len(views) - 1

    position: dict[str, Any] = {
        "componentType": component,
        "count": len(stored),
        "type": "VEC3",
        "normalized": normalised,
    }
    if draw((False, True)):  # sparse: the last vertices are not in the base
        base, changed = stored.copy(), np.arange(len(stored) // 2, len(stored))
        base[changed] = 1
        position["bufferView"] = view(base, draw((0, 16)))
        indices = {"bufferView": view(changed.astype("<u2")), "componentType": 5123}
        position["sparse"] = {
            "count": len(changed),
            "indices": indices,
            "values": {"bufferView": view(stored[changed])},
        }
    else:
        position["bufferView"] = view(stored, draw((0, 16)))
    accessors, primitives = [position], []
    for part in np.array_split(triangles, draw((1, 2))):
        mode, order = draw(((4, part.ravel()), (5, _strip(part)), (4, part.ravel())))
        code = draw([code for code, kind in INDEX_KINDS.items() if len(stored) < np.iinfo(kind).max])
        accessors.append(
            {
                "bufferView": view(order.astype(INDEX_KINDS[code])),
                "componentType": code,
                "count": len(order),
                "type": "SCALAR",
            }
        )
        primitives.append({"attributes": {"POSITION": 0}, "indices": len(accessors) - 1, "mode": mode})
    turn = [0.5, 0.5, 0.5, 0.5]  # x to y to z to x
    nodes: list[dict[str, Any]] = [
        {"children": [1], "rotation": turn, "scale": scale.tolist()},
        {"mesh": 0, "translation": [1, 2, 3]},
    ]
    placed = ((vertices + np.array([1, 2, 3])) * scale)[:, [2, 0, 1]]
    if draw((False, True)):
        matrix = np.zeros((4, 4))
        matrix[[1, 2, 0, 3], [0, 1, 2, 3]] = [*scale, 1]
        nodes[0] = {"children": [1], "matrix": matrix.T.ravel().tolist()}
    content = {
        "asset": {"version": "2.0"}, "nodes": nodes, "meshes": [{"primitives": primitives}], "accessors": accessors,
        "bufferViews": views, "buffers": [{"byteLength": len(data)}],
        "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
    }  # fmt: skip
    if draw((False, True)):
        content |= {"scene": 0, "scenes": [{"nodes": [0]}]}
    return _write_gltf(path, content, data, draw((".glb", ".gltf", "beside"))), placed, triangles


def _strip(triangles: np.ndarray) -> np.ndarray:
    """A strip of triangles, joined by triangles without area; each keeps its corners in order."""
    order: list[int] = []
    for a, b, c in triangles:
        order += [order[-1], a] if order else []
        order += [a] * (len(order) % 2)
        order += [a, b, c]
    return np.array(order)


def _write_gltf(path: Path, content: dict[str, Any], data: bytes, way: str) -> Path:
    if way == ".glb":
        text = json.dumps(content).encode()
        text, data = text + b" " * (-len(text) % 4), data + bytes(-len(data) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
        path = path.with_suffix(".glb")
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return path
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    if way == "beside":
        uri = "its%20data.bin"
        (path.parent / "its data.bin").write_bytes(data)
    content["buffers"][0]["uri"] = uri
    path = path.with_suffix(".gltf")
    path.write_text(json.dumps(content))
    return path
