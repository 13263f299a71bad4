"""Readers for files of other kinds, added by whoever needs them: one class each. See docs/extending.md."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

import numpy as np


class Reader(ABC):
    """Reads the files of some suffixes, in place of brafit's own reader where it has one.

    It runs in a process of its own: what crashes or hangs there costs one scan. Its class must be one that another
    process can import.

    Attributes:
        suffixes: the ends of the names, with the dot, in lower case: `(".abc",)`.
    """

    suffixes: tuple[str, ...]

    @abstractmethod
    def read(self, path: Path) -> dict[str, np.ndarray]:
        """The columns of a file: `positions` (n, 3); where it has them, `normals` (n, 3) and `inside` (n), the flag of
        points between wire and upper line; `unit`, one text of `brafit.landmarks.units.MILLIMETRES`, where it says so.

        Raises:
            brafit.cloud.refusal.RefusedError: the file is whole, but of a kind that is not read; with a remedy.
            ValueError: with a short reason, if the file is damaged or cut off.
            OSError: it cannot be read.
        """


def checked_readers(given: Iterable[object]) -> tuple[Reader, ...]:
    """What was given as readers, if all are.

    Raises:
        ValueError: one is none, or has no sound suffixes; names the setting.
    """
    readers: list[Reader] = []
    for k, one in enumerate(given):
        if not isinstance(one, Reader):
            what = f"the class {one.__name__} itself" if isinstance(one, type) else f"a {type(one).__name__}"
            remedy = "give {_target_: MODULE.CLASS, ...}, the class derived from that"
            raise ValueError(f"scan.readers.{k}: {what} is no brafit.cloud.Reader: {remedy}")
        ends = getattr(one, "suffixes", None)
        if not (isinstance(ends, tuple) and ends and all(re.fullmatch(r"\.[^.A-Z/]+", str(end)) for end in ends)):
            raise ValueError(f"scan.readers.{k}: suffixes must be a tuple of the form ('.abc',), got {ends}")
        readers.append(one)
    return tuple(readers)


def reader_for(path: Path, readers: Iterable[Reader]) -> Reader | None:
    """The first of the readers that takes a file of this name."""
    return next((reader for reader in readers if path.suffix.lower() in reader.suffixes), None)


def read_columns(path: Path, reader: Reader) -> dict[str, np.ndarray]:
    """What a reader gives, if it can be the columns of a cloud.

    Raises:
        ValueError: it cannot; and what `Reader.read` raises.
    """
    columns = reader.read(path)
    name = type(reader).__name__
    if not isinstance(columns, dict) or "positions" not in columns:
        raise ValueError(f"its reader {name} gives no positions")
    columns = {key: np.asarray(column) for key, column in columns.items()}
    for key in columns.keys() & {"positions", "normals"}:
        column = columns[key]
        if column.ndim != 2 or column.shape[1] != 3 or column.dtype.kind not in "fiu":
            raise ValueError(f"its reader {name} gives {key} that are no numbers of the shape (n, 3)")
    return columns
