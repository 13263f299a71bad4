"""Reading point clouds, through Open3D's tensor interface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from brafit.errors import InputError
from brafit.scan.engine import listening, open3d

FORMATS = frozenset({".ply", ".pcd", ".xyz", ".xyzn", ".pts"})
"""Extensions of the clouds that are read, in lower case."""
MIN_POINTS = 100
FLAG = "inside"

_COMPLETE = "Export the cloud again, and check that the copy is complete"


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud as its file has it.

    Attributes:
        path: the file.
        points: positions, in the file's unit and frame.
        normals: unit normals, or None where the file has none.
        inside: True for points between wire and upper line, or None where the file has no property `inside`.
    """

    path: Path
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"] | None
    inside: Bool[np.ndarray, " n"] | None


def read_cloud(path: str | Path) -> Cloud:
    """Read a cloud (`FORMATS`; of a mesh, the vertices), in float64.

    Raises:
        InputError: no such file, a format that is not read, a damaged file, fewer than `MIN_POINTS` points,
            coordinates that are not finite.
        Open3DError: Open3D cannot be imported.
    """
    path = Path(path)
    _check_file(path)
    columns = _read(path)
    points = columns["positions"].astype(np.float64)
    _check_points(path, points)
    normals = columns.get("normals")
    flag = columns.get(FLAG)
    return Cloud(
        path=path,
        points=points,
        normals=None if normals is None else normals.astype(np.float64),
        inside=None if flag is None else flag.reshape(len(points), -1)[:, 0] > 0.5,
    )


def _check_file(path: Path) -> None:
    formats = ", ".join(sorted(FORMATS))
    if path.is_dir():
        raise InputError(path, "is a folder without usable scans", "Name a folder with clouds and landmark files")
    if not path.exists():
        raise InputError(path, "there is no such file", "Check the path")
    if path.suffix.lower() not in FORMATS:
        raise InputError(path, f"is not a cloud of a known format ({formats})", "Name a cloud, or export it as .ply")
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "Check the file and its permissions") from None
    if empty:
        raise InputError(path, "the file is empty", _COMPLETE)


def _read(path: Path) -> dict[str, np.ndarray]:
    """The cloud's columns by name.

    A damaged file makes Open3D print something and return a cloud that is empty, or of the promised size with
    arbitrary numbers in it; so anything said about a failure counts as one.
    """
    o3d = open3d()
    with listening() as messages:
        try:
            table: Any = o3d.t.io.read_point_cloud(str(path)).point
            columns = {name: table[name].numpy().copy() for name in table}
            trouble = ""
        except (RuntimeError, KeyError) as error:
            columns, trouble = {}, str(error)
    said = [line for line in messages.lines() if "fail" in line.lower() or "error" in line.lower()]
    said += [line for line in messages.lines() if "unable" in line.lower() or "unexpected" in line.lower()]
    if said or trouble:
        reason = (said or ["it has no positions x, y, z"])[0].rstrip(".").replace(f": {path}", "")
        raise InputError(path, f"cannot be read as a cloud, it is damaged or cut off ({reason})", _COMPLETE)
    if path.suffix.lower() == ".pts":
        _check_pts(path)
    if "positions" not in columns or not len(columns["positions"]):
        raise InputError(path, "the cloud is empty: 0 points", _COMPLETE)
    return columns


def _check_pts(path: Path) -> None:
    """A .pts file that ends early is filled up with zeros by Open3D; its first line says how many lines must follow."""
    with path.open("rb") as file:
        promised = file.readline().split()
        lines = sum(bool(line.strip()) for line in file)
    if len(promised) != 1 or int(promised[0]) != lines:
        first = promised[0].decode(errors="replace") if len(promised) == 1 else "no number"
        reason = f"its first line promises {first}, {lines} points follow"
        raise InputError(path, f"cannot be read as a cloud, it is damaged or cut off ({reason})", _COMPLETE)


def _check_points(path: Path, points: Float[np.ndarray, "n 3"]) -> None:
    if len(points) < MIN_POINTS:
        cause = f"the cloud is too small: {len(points)} point{'' if len(points) == 1 else 's'}"
        raise InputError(path, cause, f"A cup needs at least {MIN_POINTS}, and thousands to be good: scan more densely")
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    if bad:
        cause = f"{bad} of {len(points)} points have coordinates that are NaN or infinite"
        raise InputError(path, cause, "Remove these points and export the cloud again")
