"""Torsos with two breasts, made by formula."""

from __future__ import annotations

import json

import numpy as np
import trimesh

from brafit.cloud.mesh import sample_faces
from brafit.landmarks import landmarks_path

FRONT = np.array([0.0, 0.0, 1.0])


def torso(left: float = 30.0, n: int = 90_000, right: float = 30.0) -> np.ndarray:
    """An ellipsoid as a trunk (x left, y up, z front) with two bumps, so much high."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    body = ball.vertices * [170.0, 320.0, 110.0]
    for sign, height in ((1, left), (-1, right)):
        away = ((body[:, 0] - 75 * sign) ** 2 + (body[:, 1] - 40) ** 2) / 45**2
        body[:, 2] += np.where(body[:, 2] > 0, height * np.exp(-away), 0)
    return sample_faces(body, ball.faces, n)


def mark(points: np.ndarray, x: float, y: float) -> np.ndarray:
    """The front surface's place there."""
    near = points[np.hypot(points[:, 0] - x, points[:, 1] - y) < 6]
    return near[near[:, 2].argmax()]


def write(folder, points: np.ndarray):
    """The torso and a landmark file of its left bump, exact copies of the surface's places."""
    angle = np.linspace(0, np.pi, 31)
    wire = [mark(points, 75 - 60 * np.cos(a), 40 - 60 * np.sin(a)).tolist() for a in angle]
    marks = {"apex": mark(points, 75, 40).tolist(), "strap_point": mark(points, 80, 120).tolist()}
    path = folder / "torso.npy"
    np.save(path, points)
    landmarks_path(path).write_text(json.dumps({"side": "left", "wire": wire, "landmarks": marks}))
    return path
