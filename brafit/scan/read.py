"""Reading point clouds: PLY through Open3D's tensor interface; PCD and plain text by NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from brafit.errors import InputError
from brafit.scan.engine import listening, open3d
from brafit.scan.pcd import read_pcd
from brafit.scan.text import TEXT_FORMATS, read_text

MIN_POINTS = 100
FLAG = "inside"

_FAILURES = ("fail", "error", "unable", "unexpected")
_PERMISSIONS = "Check the file and its permissions"
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
    with np.errstate(invalid="ignore"):  # NaNs are reported below
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
        raise InputError(path, f"cannot be read ({error.strerror})", _PERMISSIONS) from None
    if empty:
        raise InputError(path, "the file is empty", _COMPLETE)


def _read(path: Path) -> dict[str, np.ndarray]:
    """The cloud's columns by name."""
    try:
        columns = _READERS[path.suffix.lower()](path)
    except ValueError as error:
        raise InputError(path, f"cannot be read as a cloud, it is damaged or cut off ({error})", _COMPLETE) from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", _PERMISSIONS) from None
    if not len(columns.get("positions", ())):
        raise InputError(path, "the cloud is empty: 0 points", _COMPLETE)
    return columns


def _read_ply(path: Path) -> dict[str, np.ndarray]:
    """The columns of a PLY file; ValueError with a short reason if it is damaged.

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


_READERS: dict[str, Callable[[Path], dict[str, np.ndarray]]] = {
    ".ply": _read_ply,
    ".pcd": read_pcd,
    **dict.fromkeys(TEXT_FORMATS, read_text),
}
FORMATS = frozenset(_READERS)
"""Extensions of the clouds that are read, in lower case."""


def _check_points(path: Path, points: Float[np.ndarray, "n 3"]) -> None:
    if len(points) < MIN_POINTS:
        cause = f"the cloud is too small: {len(points)} point{'' if len(points) == 1 else 's'}"
        raise InputError(path, cause, f"A cup needs at least {MIN_POINTS}, and thousands to be good: scan more densely")
    bad = int((~np.isfinite(points).all(axis=1)).sum())
    if bad:
        cause = f"{bad} of {len(points)} points have coordinates that are NaN or infinite"
        raise InputError(path, cause, "Remove these points and export the cloud again")
