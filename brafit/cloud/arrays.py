"""Clouds kept as NumPy arrays: .npy (one array) and .npz (several by name)."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

POINT_KEYS = ("positions", "points", "xyz", "vertices")
"""Names under which an .npz holds the positions; a single array may have any name."""


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Columns `positions` and, where there are such, `normals` and `inside`.

    A plain array has a row for each point: x, y, z, and maybe more, which is not looked at. A structured one has
    fields x, y, z. An .npz may name arrays `normals` and `inside` beside the positions.

    Raises:
        ValueError: with a short reason, if there are no such arrays in the file.
        OSError: the file cannot be read.
    """
    try:
        if path.suffix.lower() == ".npy":
            # Mapped, not read: NumPy then compares the promised size with the file's.
            return {"positions": _positions(np.load(path, mmap_mode="r", allow_pickle=False))}
        return _archive(path)
    except (ValueError, OSError) as error:
        if "pickle" in str(error):  # NumPy takes whatever it does not know for a pickle
            raise ValueError("it holds no plain array of numbers") from None
        raise
    except MemoryError:
        raise ValueError("it needs more memory than there is") from None
    except (EOFError, KeyError, TypeError, OverflowError, SyntaxError, tokenize.TokenError) as error:
        raise ValueError(f"its array cannot be read, {type(error).__name__}") from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"its archive is damaged, {' '.join(str(error).split())[:80]}") from None


def _archive(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        names = list(archive.files)
        key = next((name for name in POINT_KEYS if name in names), names[0] if len(names) == 1 else None)
        if key is None:
            listed = ", ".join(names)[:80] or "nothing"
            raise ValueError(f"it has no array named {' or '.join(POINT_KEYS)}, only: {listed}")
        columns = {"positions": _positions(archive[key])}
        for name, width in (("normals", 3), ("inside", 1)):
            if name in names and name != key:
                columns[name] = _numbers(archive[name]).reshape(-1, width)
    if any(len(column) != len(columns["positions"]) for column in columns.values()):
        raise ValueError("its arrays are not equally long")
    return columns


def _positions(array: np.ndarray) -> np.ndarray:
    names = array.dtype.names
    if names:
        if not {"x", "y", "z"} <= set(names):
            raise ValueError(f"its fields are {', '.join(names)[:80]}, not x, y, z")
        array = np.stack([_numbers(array[name].ravel()) for name in "xyz"], axis=1)
    if array.ndim < 2 or array.shape[-1] < 3:
        raise ValueError(f"its array is {' x '.join(map(str, array.shape)) or 'one number'}, not n x 3")
    return _numbers(array)[..., :3].reshape(-1, 3)


def _numbers(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind not in "fiub":
        raise ValueError(f"its array holds {array.dtype}, not numbers")
    return np.array(array, dtype=np.float64)
