"""Reading scans: point clouds (PLY, PCD, text, NumPy) and meshes (OBJ, STL, OFF, glTF, PLY with faces).

All are read in a process of its own, with a time limit, unless the caller's process is one that may crash.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from brafit.cloud.mesh import ABSURD, FLAG, MESH_FORMATS
from brafit.cloud.reader import Reader, reader_for
from brafit.cloud.refusal import RefusedError
from brafit.cloud.text import TEXT_FORMATS
from brafit.cloud.worker import ReaderError, read_apart, read_here
from brafit.errors import InputError

MIN_POINTS = 100
FORMATS = frozenset({".pcd", ".npy", ".npz", *MESH_FORMATS, *TEXT_FORMATS})
"""Extensions of the scans that are read, in lower case."""
SURE_FORMATS = FORMATS - {".txt", ".csv", ".asc", ".npy", ".npz"}
"""Those of them that hold hardly anything but scans; a file of the others may be anything."""

READ_SECONDS = 120.0
MESH_POINTS = 200_000

_MAGIC = {
    b"ply": ".ply",
    b"glTF": ".glb",
    b"# .PCD": ".pcd",
    b"OFF": ".off",
    b"\x93NUMPY": ".npy",
    b"PK\x03\x04": ".npz",
}
"""How files of some formats begin."""
_PACKED = {
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf": "7z",
    b"Rar!": "rar",
    b"(\xb5/\xfd": "zstd",
}
"""How packed files begin."""
_PERMISSIONS = "Check the file and its permissions"
_COMPLETE = "Export the cloud again, and check that the copy is complete"


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud as its file has it.

    Attributes:
        path: the file.
        points: positions, in the file's unit and frame; finite.
        normals: unit normals, or None where the file has none.
        inside: True for points between wire and upper line, or None where the file has no property `inside`.
        vertices, faces: how many vertices and triangles the mesh has that the points were sampled on; 0 for a cloud.
        dropped: points that were left out because their coordinates are NaN, infinite or absurdly large.
        unit: of the points, one of `brafit.landmarks.units.MILLIMETRES`, or None where the file does not state it.
    """

    path: Path
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"] | None
    inside: Bool[np.ndarray, " n"] | None
    faces: int = 0
    dropped: int = 0
    unit: str | None = None
    vertices: int = 0


def read_cloud(
    path: str | Path,
    *,
    seconds: float = READ_SECONDS,
    mesh_points: int = MESH_POINTS,
    apart: bool = True,
    readers: Sequence[Reader] = (),
) -> Cloud:
    """Read a scan (`FORMATS`), in float64.

    Args:
        path: the file; its extension says how it is read.
        seconds: time limit of the reader.
        mesh_points: points to sample on a mesh.
        apart: read in a process of its own, so that a file that crashes or stalls a reader costs no more than itself.
            False: in this process, without a time limit, for a process that is guarded as a whole.
        readers: of other kinds of files; they come before brafit's own.

    Raises:
        InputError: no such file, a format that is not read, a damaged file, fewer than `MIN_POINTS` points, most
            coordinates not finite.
    """
    path = Path(path)
    own = reader_for(path, readers)
    _check_file(path, {end for reader in readers for end in reader.suffixes})
    read = partial(read_apart, seconds=seconds) if apart else read_here
    columns = _read(path, read, mesh_points, own)
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is reported below
        points = np.ascontiguousarray(columns["positions"], dtype=np.float64)
    finite = _check_points(path, points, image="image" in columns)
    normals, flag = columns.get("normals"), columns.get(FLAG)
    return Cloud(
        path=path,
        points=points[finite],
        normals=None if normals is None else normals.astype(np.float64)[finite],
        inside=None if flag is None else flag.reshape(len(points), -1)[finite, 0] > 0.5,
        faces=int(columns["faces"][0]) if "faces" in columns else 0,
        dropped=int((~finite).sum()),
        unit=str(columns["unit"][0]) if "unit" in columns else None,
        vertices=int(columns["vertices"][0]) if "vertices" in columns else 0,
    )


def _check_file(path: Path, others: Set[str]) -> None:
    known = FORMATS | others
    formats = ", ".join(sorted(known))
    if path.is_dir():
        raise InputError(path, "is a folder, and one cloud is wanted", "Name a file in it")
    if not path.exists():
        raise InputError(path, "there is no such file", "Check the path")
    if not path.is_file():
        raise InputError(path, "is no regular file, but a pipe, a device or the like", "Name a cloud")
    if path.suffix.lower() not in known:
        beside = [path.with_suffix(end).name for end in sorted(known) if path.with_suffix(end).is_file()]
        if beside:
            raise InputError(path, "is no cloud, but stands beside one", f"Name {' or '.join(beside)}")
        raise InputError(path, f"is not a cloud of a known format ({formats})", "Name a cloud, or export it as .ply")
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", _PERMISSIONS) from None
    if empty:
        raise InputError(path, "the file is empty", _COMPLETE)


def _read(
    path: Path, read: Callable[..., dict[str, np.ndarray]], mesh_points: int, own: Reader | None
) -> dict[str, np.ndarray]:
    """The cloud's columns by name."""
    if own is None:
        _check_extension(path)
    try:
        columns = _columns(path, read, mesh_points) if own is None else read(own, path)
    except ReaderError as error:
        remedy = "Export it again, as a binary .ply; a very large file may need more: scan.read_seconds"
        raise InputError(path, f"cannot be read as a cloud ({error})", remedy) from None
    except RefusedError as error:
        raise InputError(path, f"cannot be read as a cloud ({_plain(error.cause)})", error.remedy) from None
    except ValueError as error:
        cause = f"cannot be read as a cloud, it is damaged or cut off ({_plain(str(error))})"
        raise InputError(path, cause, _COMPLETE) from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror or error})", _PERMISSIONS) from None
    if not len(columns.get("positions", ())):
        raise InputError(path, "the cloud is empty: 0 points", _COMPLETE)
    if any(len(column) != len(columns["positions"]) for name, column in columns.items() if name in ("normals", FLAG)):
        raise InputError(path, "cannot be read as a cloud, its columns are not equally long", _COMPLETE)
    return columns


def _columns(path: Path, read: Callable[..., dict[str, np.ndarray]], mesh_points: int) -> dict[str, np.ndarray]:
    kind = path.suffix.lower()
    own = {**dict.fromkeys(TEXT_FORMATS, "text"), ".pcd": "pcd", ".npy": "arrays", ".npz": "arrays"}
    if kind in own:
        return read(own[kind], path)
    return read("mesh", path, count=mesh_points)


def _check_extension(path: Path) -> None:
    """Refuse a file that is packed, or whose content is of another format than its name says."""
    with path.open("rb") as file:
        head = file.read(16)
    packed = next((kind for magic, kind in _PACKED.items() if head.startswith(magic)), None)
    if packed is not None:
        raise InputError(path, f"is packed ({packed})", "Unpack it first")
    found = next((kind for magic, kind in _MAGIC.items() if head.startswith(magic)), None)
    named = path.suffix.lower()
    if found is not None and found != named:
        if found == ".npz":  # an archive of any kind
            raise InputError(
                path, f"is named {named}, but is a zip archive", f"Unpack it; NumPy's own is {path.stem}.npz"
            )
        raise InputError(path, f"is named {named}, but its content is {found}", f"Rename it to {path.stem}{found}")


def _plain(reason: str) -> str:
    """A reason in printable characters, not too long."""
    text = "".join(c if c.isprintable() else "?" for c in reason)
    return text if len(text) <= 160 else text[:157] + "..."


def _check_points(path: Path, points: Float[np.ndarray, "n 3"], image: bool) -> Bool[np.ndarray, " n"]:
    """Mask of the points that are finite; `image`: they are pixels, most of which may see nothing."""
    if len(points) < MIN_POINTS:
        cause = f"the cloud is too small: {len(points)} point{'' if len(points) == 1 else 's'}"
        raise InputError(path, cause, f"A cup needs at least {MIN_POINTS}, and thousands to be good: scan more densely")
    with np.errstate(invalid="ignore"):
        finite = np.asarray((np.abs(points) < ABSURD).all(axis=1))
    good = int(finite.sum())
    # Scanners mark what they did not see by NaN; a file that is mostly so is no scan.
    if good < MIN_POINTS or (2 * good < len(points) and not image):
        cause = (
            f"{len(points) - good} of {len(points)} points have coordinates that are NaN, infinite or absurdly large"
        )
        raise InputError(path, cause, "Remove these points and export the cloud again")
    return finite
