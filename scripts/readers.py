"""What is needed to read files with programs and packages that brafit does not write with."""

from __future__ import annotations

import shutil
import subprocess
import warnings
from typing import Any

import numpy as np

SVG = "{http://www.w3.org/2000/svg}"
LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
POINT = 25.4 / 72
"""Millimetres of a point, the unit of PDF."""


class MissingReaderError(Exception):
    """A reader that is not installed.

    Attributes:
        package: that has it, where one is named.
    """

    def __init__(self, text: str, package: str = ""):
        super().__init__(text)
        self.package = package


def program(name: str, package: str) -> str:
    """The path of a reader; the Debian package is named where there is none."""
    path = shutil.which(name)
    if path is None:
        raise MissingReaderError(f"the program {name} is not installed (Debian package {package})", package)
    return path


def module(name: str, package: str = "") -> Any:
    """A reader that is a Python package."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return __import__(name)
    except ImportError:
        package = package or name
        raise MissingReaderError(f"the Python package {package} is not installed (extra `test`)", package) from None


def quietly(*command: object) -> bytes:
    """What a program writes to its output."""
    return subprocess.run([str(part) for part in command], check=True, capture_output=True).stdout


def polyline_length(points: Any) -> float:
    """Length of a polyline in the plane; further coordinates do not count."""
    line = np.array([tuple(point)[:2] for point in points], float)
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def path_points(path: Any, count: int = 60) -> np.ndarray:
    """Points of a path of lines and Bezier arcs, `count` an arc."""
    share = np.linspace(0, 1, count)[:, None]
    points = []
    for arc in path:
        known = [getattr(arc, key, None) for key in ("start", "control1", "control2", "end")]
        c = np.array([(p.x, p.y) for p in known if p is not None])
        if type(arc).__name__ == "CubicBezier":
            points.append((1 - share) ** 3 * c[0] + 3 * share * (1 - share) ** 2 * c[1]
                          + 3 * share**2 * (1 - share) * c[2] + share**3 * c[3])  # fmt: skip
        elif type(arc).__name__ in ("Line", "Close") and len(c) > 1:
            points.append(c)
    line = np.vstack(points)
    return line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-7)]
