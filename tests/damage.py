"""Damaged scan files: sound ones of every format with bytes flipped, cut, dropped, doubled or swapped, and worse."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import trimesh
from breasts import cup_frame_points, write_ply
from scipy.spatial import Delaunay


def sound_files(folder: Path, n: int = 600) -> list[Path]:
    """A small cloud, or a mesh of it, in every format."""
    folder.mkdir(parents=True, exist_ok=True)
    points = cup_frame_points(n)
    write_ply(folder / "a.ply", points)
    rows = "\n".join(" ".join(map(str, row)) for row in points)
    texts = {
        "b.xyz": rows,
        "c.pts": f"{n}\n{rows}",
        "d.csv": "x,y,z\n" + rows.replace(" ", ","),
        "e.txt": rows.replace(" ", "; "),
        "f.xyzn": "\n".join(f"{row} 0 0 1" for row in rows.split("\n")),
        "g.pcd": f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\n"
        f"DATA ascii\n{rows}\n",
        "h.ply": f"ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n"
        f"end_header\n{rows}\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    np.save(folder / "i.npy", points)
    np.savez(folder / "j.npz", points=points)
    faces = Delaunay(points[:, :2]).simplices
    mesh = trimesh.Trimesh(points, faces, process=False)
    for k, kind in enumerate(("obj", "stl", "off", "glb", "ply")):
        mesh.export(folder / f"{'klmno'[k]}.{kind}")
    return sorted(folder.iterdir())


def _flipped(data: bytearray, generator: np.random.Generator) -> bytes:
    for place in generator.integers(0, len(data), size=int(generator.integers(1, 60))):
        data[place] ^= 1 << int(generator.integers(8))
    return bytes(data)


def _header_flipped(data: bytearray, generator: np.random.Generator) -> bytes:
    for place in generator.integers(0, min(200, len(data)), size=int(generator.integers(1, 6))):
        data[place] = int(generator.integers(256))
    return bytes(data)


def _cut(data: bytearray, generator: np.random.Generator) -> bytes:
    return bytes(data[: int(generator.integers(0, len(data)))])


def _hole(data: bytearray, generator: np.random.Generator) -> bytes:
    start, length = int(generator.integers(0, len(data))), int(generator.integers(1, 400))
    return bytes(data[:start] + data[start + length :])


def _doubled(data: bytearray, generator: np.random.Generator) -> bytes:
    start, end = sorted(int(k) for k in generator.integers(0, len(data), size=2))
    return bytes(data[:end] + data[start:])


def _noise(data: bytearray, generator: np.random.Generator) -> bytes:
    return generator.bytes(int(generator.integers(1, 5000)))


def _line_dropped(data: bytearray, generator: np.random.Generator) -> bytes:
    """One of the first lines, so of a header where there is one."""
    lines = bytes(data).split(b"\n")
    del lines[int(generator.integers(0, min(12, len(lines))))]
    return b"\n".join(lines)


def _word_changed(data: bytearray, generator: np.random.Generator) -> bytes:
    """A number among the first words becomes another, maybe huge, negative or no number."""
    words = bytes(data[:2000]).split(b" ")
    choices = (b"-1", b"0", b"99999999999", b"4294967295", b"nan", b"inf", b"1e400", b"x", b"")
    words[int(generator.integers(0, len(words)))] = choices[int(generator.integers(len(choices)))]
    return b" ".join(words) + bytes(data[2000:])


def _count_changed(data: bytearray, generator: np.random.Generator) -> bytes:
    """Four bytes near the start become a huge or odd count."""
    place = int(generator.integers(0, max(1, min(120, len(data) - 4))))
    data[place : place + 4] = struct.pack("<I", int(generator.integers(0, 2**32)))
    return bytes(data)


DAMAGES: tuple[Callable[[bytearray, np.random.Generator], bytes], ...] = (
    _flipped,
    _header_flipped,
    _cut,
    _hole,
    _doubled,
    _noise,
    _line_dropped,
    _word_changed,
    _count_changed,
)


def damaged_files(folder: Path, count: int, seed: int = 0) -> Iterator[tuple[str, Path]]:
    """`count` damaged files, one after another (each overwrites the one before): what was done to it, and the file."""
    sound = sound_files(folder / "sound")
    generator = np.random.default_rng(seed)
    for k in range(count):
        source = sound[int(generator.integers(len(sound)))]
        damage = DAMAGES[k % len(DAMAGES)]
        path = folder / f"damaged{source.suffix}"
        path.write_bytes(damage(bytearray(source.read_bytes()), generator))
        yield f"{k}: {source.name}{damage.__name__}", path
