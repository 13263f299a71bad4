"""A torso whose surface is a formula, so that it is known where every ray meets it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from brafit.landmarks import Landmarks, landmarks_path, landmarks_text
from brafit.landmarks.units import MILLIMETRES

TRUNK = np.array([170.0, 320.0, 110.0])
"""Half axes of the trunk, an ellipsoid: x to the wearer's left, y up, z to the front, mm."""
RISE, WIDTH, OUT, UP = 30.0, 45.0, 75.0, 40.0
"""Breasts are bumps of this height and width, so far from the middle and above it, mm."""
WIRE = 60.0
"""Radius of the wire, a half circle in the view from in front, mm."""


def front(x: Float[np.ndarray, "*n"], y: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The front surface's z; NaN beside the trunk."""
    with np.errstate(invalid="ignore"):
        trunk = TRUNK[2] * np.sqrt(1 - (x / TRUNK[0]) ** 2 - (y / TRUNK[1]) ** 2)
    return trunk + sum(RISE * np.exp(-((x - s * OUT) ** 2 + (y - UP) ** 2) / WIDTH**2) for s in (1, -1))


def torso_points(count: int, noise: float = 0.0) -> Float[np.ndarray, "count 3"]:
    """Points of the whole surface, in about even density."""
    random = np.random.default_rng(0)
    ball = random.standard_normal((4 * count, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    # An ellipsoid's area grows unevenly with the ball's.
    growth = np.linalg.norm(ball / TRUNK, axis=1)
    ball = ball[random.uniform(0, growth.max(), len(ball)) < growth][:count]
    points = ball * TRUNK
    ahead = points[:, 2] > 0
    points[ahead, 2] = front(points[ahead, 0], points[ahead, 1])
    return points + noise * random.standard_normal(points.shape)


def meets(origin: Float[np.ndarray, "3"], towards: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Where the front surface is first met by a ray that is looked along against `towards`, a unit vector."""

    def above(t: float) -> float:
        x, y, z = origin + t * towards
        return float(z - front(np.array(x), np.array(y)))

    steps = np.linspace(400.0, -400.0, 4001)
    values = np.array([above(t) for t in steps])
    (crossings,) = np.nonzero((values[:-1] > 0) & (values[1:] <= 0))
    k = int(crossings[0])
    return origin + brentq(above, steps[k + 1], steps[k], xtol=1e-9) * towards


def torso_marks(path: Path, side: str = "left", unit: str = "mm") -> Landmarks:
    """Exact marks of one breast, in millimetres."""
    sign = 1.0 if side == "left" else -1.0

    def place(out: np.ndarray, up: np.ndarray) -> np.ndarray:
        return np.stack([sign * out, up, front(sign * out, up)], axis=-1)

    angle = np.linspace(0, np.pi, 41)
    wire = place(OUT - WIRE * np.cos(angle), UP - WIRE * np.sin(angle))
    points = {"apex": place(np.array(OUT), np.array(UP)), "strap_point": place(np.array(OUT + 5), np.array(UP + 80))}
    return Landmarks(landmarks_path(path), path.stem, side, wire, None, points, unit)


def write_torso(path: Path, points: Float[np.ndarray, "n 3"], marks: Landmarks | None, unit: str = "mm") -> Path:
    """The torso and, if there are marks, its landmark file, in a unit."""
    factor = MILLIMETRES[unit]
    np.save(path, points / factor)
    if marks is not None:
        text = landmarks_text([marks.mapped(lambda places: places / factor, units=unit)])
        landmarks_path(path).write_text(text, encoding="utf-8")
    return path
