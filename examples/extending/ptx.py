"""A reader: PTX, the text that Leica's Cyclone and many structured-light scanners write, in metres.

    brafit scan.ptx 'scan.readers=[{_target_: ptx.PtxReader}]'

Each scan of a file is a grid: columns, rows, the scanner's place and axes (four lines), a 4x4 matrix by rows that takes
row vectors to the frame of the file (four lines), and a line for each cell: x y z, the intensity, maybe a colour. Cells
that saw nothing are 0 0 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from brafit.cloud import Reader

HEAD = 10
"""Lines before a scan's cells."""


class PtxReader(Reader):
    """Reads all scans of a file as one cloud."""

    suffixes = (".ptx",)

    def read(self, path: Path) -> dict[str, np.ndarray]:
        lines = [line.split() for line in path.read_text(encoding="ascii").splitlines() if line.strip()]
        clouds = list(_scans(lines))
        if not clouds:
            raise ValueError("it holds no scan")
        return {"positions": np.concatenate(clouds), "unit": np.array(["m"])}


def _scans(lines: Sequence[Sequence[str]]) -> Iterator[np.ndarray]:
    first = 0
    while first < len(lines):
        head = lines[first : first + HEAD]
        if [len(line) for line in head] != [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]:
            raise ValueError(f"line {first + 1} begins no scan of columns, rows, axes and matrix")
        count = int(head[0][0]) * int(head[1][0])
        cells = lines[first + HEAD : first + HEAD + count]
        if count < 1 or len(cells) < count:
            raise ValueError(f"its header promises {count} points, {len(cells)} follow")
        points = np.array([cell[:3] for cell in cells], dtype=float)
        seen = points[(points != 0).any(axis=1)]
        matrix = np.array(head[6:], dtype=float)
        yield seen @ matrix[:3, :3] + matrix[3, :3]
        first += HEAD + count
