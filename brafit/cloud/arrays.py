"""Clouds kept as NumPy arrays: .npy (one array) and .npz (several by name)."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from brafit.cloud.refusal import RefusedError

MANY = 30
"""Numbers of a point at most; an array of three or four longer rows has its points in columns."""
POINT_KEYS = ("positions", "points", "xyz", "vertices")
"""Names under which an .npz holds the positions; a single array may have any name."""


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Columns `positions` and, where there are such, `normals` and `inside`; `image` if the points are pixels.

    A plain array has a row for each point: x, y, z, and maybe more, which is ignored; it may also be an image of
    h x w such pixels. A structured one has fields x, y, z. An .npz may name arrays `normals` and `inside` beside the
    positions. Case does not count in names.

    Raises:
        ValueError: with a short reason, if there are no such arrays; a `RefusedError` if they are transposed, have
            other names, or hold other things than numbers.
        OSError: the file cannot be read.
    """
    try:
        if path.suffix.lower() == ".npy":
            # Mapped, not read: NumPy then compares the promised size with the file's.
            return _points(np.load(path, mmap_mode="r", allow_pickle=False))
        return _archive(path)
    except (ValueError, OSError) as error:
        if "pickle" in str(error):  # NumPy takes whatever it does not know for a pickle
            raise ValueError("it holds no plain array of numbers") from None
        if "Python objects" in str(error):
            raise RefusedError(
                "its array holds Python objects, not numbers", "Save it as an array of numbers"
            ) from None
        raise
    except MemoryError:
        raise ValueError("it needs more memory than there is") from None
    except (EOFError, KeyError, TypeError, OverflowError, SyntaxError, tokenize.TokenError) as error:
        raise ValueError(f"its array cannot be read, {type(error).__name__}") from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"its archive is damaged, {' '.join(str(error).split())[:80]}") from None


def _archive(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        names = {name.lower(): name for name in archive.files}
        key = next((name for name in POINT_KEYS if name in names), next(iter(names)) if len(names) == 1 else None)
        if key is not None:
            columns = _points(archive[names[key]])
        elif set("xyz") <= set(names):
            columns = {"positions": np.stack([_numbers(archive[names[axis]]).ravel() for axis in "xyz"], axis=1)}
        else:
            listed = ", ".join(names.values())[:80] or "nothing"
            cause = f"it has no array named {' or '.join(POINT_KEYS)}, only: {listed}"
            raise RefusedError(cause, f"Name the one that holds the points {POINT_KEYS[0]}")
        for name, width in (("normals", 3), ("inside", 1)):
            if name in names and name != key:
                columns[name] = _numbers(archive[names[name]]).reshape(-1, width)
    if any(len(columns[name]) != len(columns["positions"]) for name in ("normals", "inside") if name in columns):
        raise ValueError("its arrays are not equally long")
    return columns


def _points(array: np.ndarray) -> dict[str, np.ndarray]:
    image = {"image": np.ones(1)} if array.ndim - (not array.dtype.names) == 2 and min(array.shape[:2]) > 1 else {}
    names = {name.lower(): name for name in array.dtype.names or ()}
    if names:
        if not set("xyz") <= set(names):
            raise ValueError(f"its fields are {', '.join(names.values())[:80]}, not x, y, z")
        array = np.stack([_numbers(array[names[axis]].ravel()) for axis in "xyz"], axis=1)
    shape = " x ".join(map(str, array.shape)) or "one number"
    if array.ndim < 2 or array.shape[-1] < 3:
        raise ValueError(f"its array is {shape}, not n x 3")
    if array.ndim == 2 and array.shape[0] in (3, 4) and array.shape[1] > MANY:
        raise RefusedError(f"its array is {shape}: a point a column, not a point a row", "Save it transposed, as n x 3")
    return {"positions": _numbers(array)[..., :3].reshape(-1, 3)} | image


def _numbers(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "fiub":
        raise ValueError(f"its array holds {array.dtype}, not numbers")
    return np.array(array, dtype=np.float64)
