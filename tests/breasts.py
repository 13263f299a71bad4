"""A breast whose cup-frame coordinates are known: a quarter sphere on a half-circle wire, written as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

RADIUS = 65.0
"""Of wire and breast, mm."""


def cup_frame_points(n: int = 1500, seed: int = 0) -> np.ndarray:
    """Points on the quarter sphere x > 0, z > 0, in the cup frame of a left breast, float32-representable."""
    direction = np.random.default_rng(seed).standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, [0, 2]] = np.abs(direction[:, [0, 2]])
    return (RADIUS * (direction + np.array([0, 1, 0]))).astype(np.float32).astype(float)


def cup_frame_landmarks() -> dict[str, Any]:
    angle = np.linspace(0, np.pi, 31)
    zero = 0 * angle
    wire = RADIUS * np.stack([np.sin(angle), 1 - np.cos(angle), zero], axis=1)
    upper = RADIUS * np.stack([zero, 1 - np.cos(angle), np.sin(angle)], axis=1)
    marks = {
        "inner_end": wire[0],
        "outer_end": wire[-1],
        "wire_bottom": wire[15],
        "apex": RADIUS * np.array([0.5**0.5, 1, 0.5**0.5]),
        "strap_point": upper[15],
    }
    return {"side": "left", "units": "mm", "landmarks": marks, "wire": wire, "upper_line": upper}


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def transformed(landmarks: dict[str, Any], function: Any) -> dict[str, Any]:
    """Landmarks with `function` applied to every position."""
    marks = {name: function(point) for name, point in landmarks["landmarks"].items()}
    lines = {name: function(landmarks[name]) for name in ("wire", "upper_line")}
    return {**landmarks, **lines, "landmarks": marks}


def write_landmarks(path: Path, landmarks: dict[str, Any]) -> Path:
    path.write_text(json.dumps(landmarks, default=lambda array: array.tolist()))
    return path


def write_ply(path: Path, points: np.ndarray, inside: np.ndarray | None = None) -> Path:
    """A binary PLY in double precision."""
    fields = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")] + ([] if inside is None else [("inside", "u1")])
    rows = np.empty(len(points), dtype=fields)
    for i, name in enumerate("xyz"):
        rows[name] = points[:, i]
    if inside is not None:
        rows["inside"] = inside
    properties = "".join(f"property {'uchar' if kind == 'u1' else 'double'} {name}\n" for name, kind in fields)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{properties}end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())
    return path


def write_breast(folder: Path, name: str = "breast", **changes: Any) -> Path:
    """Path of a sound breast's cloud, in its cup frame; fields of its landmark file changed, or removed where None."""
    folder.mkdir(parents=True, exist_ok=True)
    landmarks = {**cup_frame_landmarks(), **changes}
    write_landmarks(folder / f"{name}.json", {key: value for key, value in landmarks.items() if value is not None})
    return write_ply(folder / f"{name}.ply", cup_frame_points())
