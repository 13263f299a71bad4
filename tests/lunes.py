"""Cups whose panels are cylinders, with everything known in closed form.

The wire is the half circle of radius R about (0, R, 0) in the plane z = 0, x >= 0. Every further edge is that half
circle turned about the y axis, so all rulings of a panel are parallel (a cylinder), t = 2 R sin(b/2) sin(theta) with b
the angle between neighbouring edges, and all edges have the wire's length. Two panels of 45 degrees make a cup on the
paper's quarter sphere.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.special import ellipeinc

from brafit.cup.shape import CupShape
from brafit.geometry.development import FlatPanel

RADIUS = 80.0


def lune_cup(panels: int = 2, n: int = 101, radius: float = RADIUS) -> CupShape:
    step = np.pi / 2 / panels
    theta = np.linspace(0, np.pi, n)
    sin, cos = np.sin(theta), np.cos(theta)
    turned = [(np.cos(step * i), np.sin(step * i)) for i in range(panels + 1)]
    edges = np.stack([np.stack((radius * sin * c, radius * (1 - cos), radius * sin * s), -1) for c, s in turned])
    edges[:, -1] = edges[0, -1]
    tangents = np.stack([np.stack((cos * c, sin, cos * s), -1) for c, s in turned])
    middles = step * (np.arange(panels) + 0.5)
    directions = np.stack([np.broadcast_to((-np.sin(a), 0.0, np.cos(a)), (n, 3)) for a in middles])
    normals = np.cross(tangents[:-1], directions)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    curvature = np.stack([np.stack((-sin * c, cos, -sin * s), -1) for c, s in turned[:-1]]) / radius
    geodesic = np.einsum("ijk,ijk->ij", curvature, np.cross(normals, tangents[:-1]))
    return CupShape(*(torch.as_tensor(x) for x in (radius * theta, edges, tangents, directions, normals, geodesic)))


def lune_flat(panels: int = 2, n: int = 101, radius: float = RADIUS) -> list[FlatPanel]:
    """The panels rolled out: rulings vertical, abscissa the arc length of the cross-section, an elliptic integral."""
    b = np.pi / 4 / panels
    theta = np.linspace(0, np.pi, n)
    # |X' - (X'.d) d|^2 = R^2 (sin^2 + cos^2 cos(b)^2) = R^2 (1 - sin(b)^2 cos^2), from the middle of the edge
    across = radius * (ellipeinc(theta - np.pi / 2, np.sin(b) ** 2) + ellipeinc(np.pi / 2, np.sin(b) ** 2))
    half = radius * np.sin(b) * np.sin(theta)
    lower, upper = (torch.as_tensor(np.stack((across, sign * half), -1)) for sign in (-1, 1))
    return [FlatPanel(lower, upper)] * panels


def lune_area(panels: int = 2, radius: float = RADIUS) -> float:
    """Area of one panel: the integral of 2 R sin(b) sin(theta) R sqrt(1 - sin(b)^2 cos(theta)^2)."""
    k = np.sin(np.pi / 4 / panels)
    return 2 * radius**2 * k * (np.sqrt(1 - k**2) + np.arcsin(k) / k)


def sphere_points(n: int = 1000, radius: float = RADIUS) -> tuple[np.ndarray, np.ndarray]:
    """Random points of the quarter sphere, and roughly how far they lie outside the two-panel cup of `lune_cup`."""
    direction = np.abs(np.random.default_rng(0).normal(size=(n, 3))) * (1, 1, 1)
    direction[:, 1] *= np.random.default_rng(1).choice((-1, 1), n)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    angle = np.arctan2(direction[:, 2], direction[:, 0])
    folded = np.abs(angle % (np.pi / 4) - np.pi / 8)
    rim = np.hypot(direction[:, 0], direction[:, 2])
    distance = radius * rim * (np.cos(folded) - np.cos(np.pi / 8))
    return radius * direction + (0, radius, 0), distance
