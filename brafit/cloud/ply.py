"""PLY: the header is checked here; vertices are read by Open3D, in the readers' own process (`brafit.cloud.worker`).

What Open3D does not notice is noticed before: rows that do not fit the header, counts that the file cannot hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from brafit.cloud.open3d_runtime import listening, open3d

SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of PLY's types."""
HEADER_BYTES = 100_000
_FAILURES = ("fail", "error", "unable", "unexpected")


@dataclass(frozen=True)
class Element:
    """One element of a header: its name, count, property names, and bytes a row (None: it holds lists)."""

    name: str
    count: int
    properties: tuple[str, ...]
    row: int | None


def ply_elements(path: Path) -> list[Element]:
    """The elements that the header promises, after checking that the file can hold them.

    Raises:
        ValueError: with a short reason, if the header is damaged or the file's size does not fit it.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
    size = path.stat().st_size
    lines, start = _lines(head)
    if not lines or lines[0] != ["ply"]:
        raise ValueError("its first line is not 'ply'")
    form = next((line for line in lines if line[0] == "format"), [])
    if len(form) < 2 or form[1] not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise ValueError("its header names no known format")
    elements = _elements(lines)
    _check_size(elements, form[1], size - start)
    return elements


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


def read_vertices(path: Path) -> dict[str, np.ndarray]:
    """The columns of the vertices; ValueError with a short reason if the file is damaged.

    A damaged PLY makes Open3D say something and return a cloud that is empty, or of the promised size with arbitrary
    numbers in it; so anything said about a failure counts as one.
    """
    o3d = open3d()
    columns: dict[str, np.ndarray] = {}
    with listening() as messages:
        try:
            table: Any = o3d.t.io.read_point_cloud(str(path)).point
            columns = {name: table[name].numpy().copy() for name in table}
            trouble = ""
        except (RuntimeError, KeyError, UnicodeDecodeError) as error:
            trouble = str(error)
    said = [line for line in messages.lines() if any(word in line.lower() for word in _FAILURES)]
    if said:
        raise ValueError(said[0].rstrip(".").replace(f": {path}", ""))
    if "positions" in trouble:
        raise ValueError("it has no positions x, y, z")
    if trouble:
        raise ValueError("Open3D refuses it")
    return columns


def _lines(head: bytes) -> tuple[list[list[str]], int]:
    """The header's lines as words, without comments, and where the data start."""
    lines, start = [], 0
    for line in head.splitlines(keepends=True):
        start += len(line)
        words = line.decode(errors="replace").split()
        if words == ["end_header"]:
            return lines, start
        if words and words[0] not in ("comment", "obj_info"):
            lines.append(words)
        if lines and lines[0] != ["ply"]:
            break
    if lines and lines[0] == ["ply"]:
        raise ValueError("its header has no end")
    return lines, start


def _elements(lines: list[list[str]]) -> list[Element]:
    elements: list[Element] = []
    for words in lines[1:]:
        if words[0] == "element":
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) < 13):
                raise ValueError("its header has an element without a number")
            elements.append(Element(words[1], int(words[2]), (), 0))
        elif words[0] == "property":
            if not elements or len(words) < 3:
                raise ValueError("its header has a property of nothing")
            last = elements.pop()
            listed = words[1] == "list"
            kinds = words[2:4] if listed else words[1:2]
            if any(kind not in SIZES for kind in kinds) or len(words) != (5 if listed else 3):
                raise ValueError(f"its header has a property of unknown type: {' '.join(words)[:60]}")
            row = None if listed or last.row is None else last.row + SIZES[words[1]]
            elements.append(Element(last.name, last.count, (*last.properties, words[-1]), row))
        elif words[0] != "format":
            raise ValueError(f"its header has a line that is none: {' '.join(words)[:60]}")
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None or not {"x", "y", "z"} <= set(vertex.properties):
        raise ValueError("it has no positions x, y, z")
    if len(set(vertex.properties)) < len(vertex.properties):
        raise ValueError("its header names a property twice")
    return elements


def _check_size(elements: list[Element], form: str, body: int) -> None:
    if form == "ascii":
        least = sum(element.count * max(2 * len(element.properties), 1) for element in elements) - 2
    else:
        least = sum(
            element.count * (len(element.properties) if element.row is None else element.row) for element in elements
        )
    if body < least:
        raise ValueError(f"its header promises {least} bytes or more, {body} follow")
    fixed = form != "ascii" and all(element.row is not None for element in elements)
    if fixed and body > least + 2:
        raise ValueError(f"its header promises {least} bytes, {body} follow: its rows are not as the header says")
