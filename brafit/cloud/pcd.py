"""Clouds of the Point Cloud Library: .pcd (v0.5 to v0.7, data ascii, binary or binary_compressed).

Read here and not by Open3D, which crashes on many damaged headers, and in silence invents points where lines are
missing.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brafit.cloud.dialect import Numbers
from brafit.cloud.refusal import RefusedError

HEADER_BYTES = 100_000
KINDS = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
"""Sizes in bytes that each TYPE of a field can have."""
COLUMNS = {"positions": ("x", "y", "z"), "normals": ("normal_x", "normal_y", "normal_z"), "inside": ("inside",)}
"""What is taken from a file, and the fields that hold it."""


@dataclass(frozen=True)
class _Header:
    """Field names, their formats in one row of data, the number of rows, whether they are the pixels of an image, the
    kind of data and where it starts.
    """

    names: list[str]
    formats: list[np.dtype]
    points: int
    image: bool
    coding: str
    start: int


def read_pcd(path: Path) -> dict[str, np.ndarray]:
    """Those of `COLUMNS` that the file has, each (n, number of its fields); `image` if the points are pixels.

    Raises:
        ValueError: with a short reason, if the file is damaged or cut off.
        OSError: the file cannot be read.
    """
    data = path.read_bytes()
    header = _header(data)
    readers = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
    if header.coding not in readers:
        raise ValueError("its header names no known kind of DATA")
    found = {name: parts for name, parts in COLUMNS.items() if set(parts) <= set(header.names)}
    if "positions" not in found:
        cause = f"its fields are {', '.join(header.names)[:80]}, without positions x, y, z"
        raise RefusedError(cause, "Export it with fields x, y and z")
    needed = list(itertools.chain(*found.values()))
    if doubled := [part for part in needed if header.names.count(part) > 1]:
        raise ValueError(f"its header names the field {doubled[0]} twice")
    at = [header.names.index(part) for part in needed]
    if empty := [header.names[k] for k in at if header.formats[k].shape[0] == 0]:
        raise ValueError(f"its field {empty[0]} has COUNT 0")
    if not header.points:
        return {"positions": np.empty((0, 3))}
    fields = readers[header.coding](header, data[header.start :])
    columns = {part: fields[k].reshape(header.points, -1)[:, 0] for part, k in zip(needed, at, strict=True)}
    image = {"image": np.ones(1)} if header.image else {}
    return {name: np.stack([columns[part] for part in parts], axis=1) for name, parts in found.items()} | image


def _header(data: bytes) -> _Header:
    """The header. What old versions do not say is one value of four bytes for each field, and one row of points."""
    words, start = _words(data)
    names = [name.lower() for name in words.get("FIELDS", words.get("COLUMNS", []))]
    sizes = _numbers(words, "SIZE") or [4] * len(names)
    kinds = [kind.upper() for kind in words.get("TYPE", [])] or ["F"] * len(names)
    counts = _numbers(words, "COUNT") or [1] * len(names)
    if not names or not len(names) == len(kinds) == len(sizes) == len(counts):
        raise ValueError("its header does not describe every field")
    if any(size not in KINDS.get(kind, ()) for kind, size in zip(kinds, sizes, strict=True)):
        raise ValueError("its header has a field of unknown type")
    points, width, height = (_numbers(words, key) for key in ("POINTS", "WIDTH", "HEIGHT"))
    width, height = width or points, height or [1]
    if not points and len(width) == len(height) == 1:
        points = [width[0] * height[0]]
    if not len(points) == len(width) == len(height) == 1 or points[0] != width[0] * height[0]:
        raise ValueError("its header is not clear about the number of points")
    formats = [
        np.dtype((f"<{kind.lower()}{size}", (count,))) for kind, size, count in zip(kinds, sizes, counts, strict=True)
    ]
    image = min(width[0], height[0]) > 1
    return _Header(names, formats, points[0], image, " ".join(words["DATA"]).lower(), start)


def _words(data: bytes) -> tuple[dict[str, list[str]], int]:
    """The header's words by key, and where the data start."""
    found: dict[str, list[str]] = {}
    start = 0
    while start < min(len(data), HEADER_BYTES):
        end = data.find(b"\n", start, start + HEADER_BYTES)
        line = data[start : end if end >= 0 else start + HEADER_BYTES].decode(errors="replace")
        start = end + 1 if end >= 0 else len(data)
        words = line.split("#")[0].split()
        if words:
            found[words[0].upper()] = words[1:]
            if words[0].upper() == "DATA":
                return found, start
    raise ValueError("its header has no line DATA")


def _numbers(words: dict[str, list[str]], key: str) -> list[int]:
    if not all(word.isascii() and word.isdigit() and len(word) < 10 for word in words.get(key, [])):
        raise ValueError(f"{key} in its header is no whole number")
    return [int(word) for word in words.get(key, [])]


def _ascii(header: _Header, body: bytes) -> list[np.ndarray]:
    lines = [line for line in body.decode(errors="replace").split("\n") if line.strip()]
    widths = [format.shape[0] for format in header.formats]
    promised = f"its header promises {header.points} lines of {sum(widths)} numbers"
    if len(lines) != header.points:
        raise ValueError(f"{promised}, {len(lines)} lines follow")
    try:
        table = np.loadtxt(lines, comments=None, ndmin=2)
    except ValueError:  # a line of another length, or words for NaN that NumPy does not know
        table, numbers = np.empty((0, 0)), Numbers()
        if all(len(line.split()) == sum(widths) for line in lines):
            table = np.array([[numbers(word) for word in line.split()] for line in lines])
    if table.shape != (header.points, sum(widths)):
        raise ValueError(f"{promised}, but its lines are not all of {sum(widths)}")
    return np.split(table, np.cumsum(widths)[:-1], axis=1)


def _binary(header: _Header, body: bytes) -> list[np.ndarray]:
    row = np.dtype([(str(i), format) for i, format in enumerate(header.formats)])
    if len(body) < header.points * row.itemsize:
        raise ValueError(f"its header promises {header.points * row.itemsize} bytes, {len(body)} follow")
    table = np.frombuffer(body, dtype=row, count=header.points)
    return [table[str(i)] for i in range(len(header.formats))]


def _compressed(header: _Header, body: bytes) -> list[np.ndarray]:
    """Packed and unpacked size, then the packed fields, one after the other."""
    packed, unpacked = (int.from_bytes(body[i : i + 4], "little") for i in (0, 4))
    sizes = [header.points * format.itemsize for format in header.formats]
    if len(body) < 8 + packed or unpacked != sum(sizes):
        raise ValueError(f"its header promises {sum(sizes)} bytes of data, which do not follow")
    data = unpack(body[8 : 8 + packed], unpacked)
    starts = np.cumsum([0, *sizes])[:-1]
    return [
        np.frombuffer(data, dtype=format.base, count=size // format.base.itemsize, offset=int(start))
        for format, size, start in zip(header.formats, sizes, starts, strict=True)
    ]


def unpack(data: bytes, size: int) -> bytes:
    """Undo LZF compression; ValueError if that does not give `size` bytes.

    A control byte below 32 is followed by that many plus one plain bytes; another one stands for a copy of what was
    written before: length in its upper three bits (7: plus the next byte) plus two, distance less one in its lower five
    bits and the byte that follows.
    """
    out, i = bytearray(), 0
    try:
        while i < len(data):
            control = data[i]
            i += 1
            if control < 32:
                out += data[i : i + control + 1]
                i += control + 1
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += data[i]
                i += 1
            start = len(out) - ((control & 31) << 8) - data[i] - 1
            i += 1
            if start < 0 or len(out) > size:
                raise IndexError
            piece = out[start : start + length]
            out += (piece * (length // len(piece) + 1))[:length]
    except IndexError:
        raise ValueError("its compressed data are damaged") from None
    if len(out) != size:
        raise ValueError("its compressed data are damaged")
    return bytes(out)
