"""PLY, ASCII and binary: the header says which elements follow and what each row of them is made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from brafit.cloud.ply_rows import TYPES, Bytes, Element, Numbers, Property, Table, read_tables
from brafit.cloud.polygons import Mesh, filled
from brafit.cloud.refusal import RefusedError
from brafit.cloud.words import in_utf8

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""PLY's formats, and the order of bytes in each."""
COLUMNS = {"normals": ("nx", "ny", "nz"), "inside": ("inside",)}
"""What is taken of the vertices beside their positions, and the properties that hold it."""
CORNERS = ("vertex_indices", "vertex_index")
HEADER_BYTES = 100_000


def cloud_ply(
    points: Float[np.ndarray, "n 3"], comment: str = "units mm", inside: Bool[np.ndarray, " n"] | None = None
) -> bytes:
    """A cloud as a binary PLY in single precision, with the flag `inside` where it is given."""
    fields = [(axis, "<f4") for axis in "xyz"] + ([] if inside is None else [("inside", "u1")])
    table = np.empty(len(points), dtype=fields)
    for axis, values in zip("xyz", points.T, strict=True):
        table[axis] = values
    if inside is not None:
        table["inside"] = inside
    properties = "".join(f"property {'float' if kind == '<f4' else 'uchar'} {name}\n" for name, kind in fields)
    header = f"comment {comment}\nelement vertex {len(points)}\n{properties}end_header\n"
    return f"ply\nformat binary_little_endian 1.0\n{header}".encode() + table.tobytes()


def read_ply(path: Path) -> Mesh:
    """Vertices of a PLY, with normals and the flag `inside` where it has them; triangles of its faces and strips.

    The elements may come in any order, have any other properties, and lists of any lengths.

    Raises:
        RefusedError: the file is whole, but its vertices have no positions x, y, z.
        ValueError: with a short reason, if the header is damaged or what follows is not what it promises.
        OSError: the file cannot be read.
    """
    data = in_utf8(path.read_bytes())
    lines, start, before = _lines(data[:HEADER_BYTES])
    order, elements = _header(lines)
    body = Bytes(data[start:], order) if order else Numbers(data[start:], before)
    tables = read_tables(elements, body)
    vertex = tables["vertex"]
    vertices = np.stack([vertex.scalars(axis) for axis in "xyz"], axis=1, dtype=np.float64)
    columns = {
        column: np.stack([vertex.scalars(part) for part in parts], axis=1, dtype=np.float64)
        for column, parts in COLUMNS.items()
        if set(parts) <= set(vertex.element.names(listed=False))
    }
    triangles = [_triangles(tables[name], vertices) for name in ("face", "tristrips") if name in tables]
    return Mesh(vertices, np.concatenate([np.empty((0, 3), dtype=np.int64), *triangles]), columns)


def _lines(head: bytes) -> tuple[list[list[str]], int, int]:
    """The header's lines as words, without comments; where the data start; and how many lines come before."""
    lines, start = [], 0
    rows = head.splitlines(keepends=True)
    # Where lines end with CR alone, an LF after the last one is data.
    alone = rows[0].endswith(b"\r") if rows else False
    for number, row in enumerate(rows, start=1):
        start += len(row)
        words = row.decode(errors="replace").split()
        if words == ["end_header"]:
            return lines, start - (alone and row.endswith(b"\r\n")), number
        if words and words[0] not in ("comment", "obj_info"):
            lines.append(words)
        if lines and lines[0] != ["ply"]:
            raise ValueError("its first line is not 'ply'")
    raise ValueError("its header has no end")


def _header(lines: list[list[str]]) -> tuple[str, list[Element]]:
    """The order of bytes (none in ASCII) and the elements that the header names."""
    form = next((line for line in lines if line[0] == "format"), [])
    if len(form) < 2 or form[1] not in FORMATS:
        raise ValueError("its header names no known format")
    elements: list[Element] = []
    for words in lines[1:]:
        if words[0] == "element":
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) < 13):
                raise ValueError("its header has an element without a number")
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property":
            if not elements or len(words) < 3:
                raise ValueError("its header has a property of nothing")
            elements[-1].properties.append(_property(words))
        elif words[0] != "format":
            raise ValueError(f"its header has a line that is none: {' '.join(words)[:60]}")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise ValueError("its header names an element twice")
    vertex = next((element for element in elements if element.name == "vertex"), Element("vertex", 0))
    _in_lower_case(vertex)
    parts = vertex.names(listed=False)
    if not {"x", "y", "z"} <= set(parts):
        has = f"only {', '.join(parts)[:80]}" if parts else "it has no vertices at all"
        raise RefusedError(f"its vertices have no positions x, y, z: {has}", "Export it with properties x, y and z")
    if len(set(parts)) < len(parts):
        raise ValueError("its header names a property twice")
    return FORMATS[form[1]], elements


def _in_lower_case(vertex: Element) -> None:
    """Properties X, Y, Z and the like become x, y, z, where no others are called so."""
    names = {each.name for each in vertex.properties}
    wanted = {part for parts in (("x", "y", "z"), *COLUMNS.values()) for part in parts}
    vertex.properties = [
        replace(each, name=each.name.lower()) if each.name.lower() in wanted - names else each
        for each in vertex.properties
    ]


def _property(words: list[str]) -> Property:
    listed = words[1] == "list"
    kinds = words[2:4] if listed else words[1:2]
    known = all(kind in TYPES for kind in kinds) and len(words) == (5 if listed else 3)
    if not known or (listed and TYPES[kinds[0]][0] == "f"):
        raise ValueError(f"its header has a property of unknown type: {' '.join(words)[:60]}")
    return Property(words[-1], TYPES[kinds[-1]], TYPES[kinds[0]] if listed else None)


def _triangles(table: Table, vertices: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, "f 3"]:
    """Triangles of the faces, or of the strips, that a table lists."""
    element = table.element
    name = next((name for name in CORNERS if name in element.names(listed=True)), None)
    if not element.count:
        return np.empty((0, 3), dtype=np.int64)
    if name is None:
        raise ValueError(f"its {element.name} elements have no list {' or '.join(CORNERS)}")
    values, sizes = table.lists(name)
    corners = values.astype(np.int64)
    if (corners != values).any():
        raise ValueError(f"a vertex that its {element.name} elements name is no whole number")
    if element.name == "face":
        return filled(vertices, corners, sizes)
    # -1 ends a strip, as does a row's end.
    strip = np.insert(corners, np.cumsum(sizes), -1)
    three = np.lib.stride_tricks.sliding_window_view(strip, 3)
    three = three[(three != -1).all(axis=1)]
    return filled(vertices, three.ravel(), np.full(len(three), 3))
