"""A body's axes and mirror plane, and what of its shape says which way is up.

Rules and figures are those of 14 breasts (parametric bodies, a mean of standing scans, one person).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from brafit.surface.symmetry import mirror_of

LEAN = np.radians(6.5)
"""Angle by which the long axis of a standing trunk leans back."""
LEVEL = np.radians(6.0)
"""An axis of the scan within this angle of the vertical that was found is taken for it: scanners stand level."""
TRUNK = 40.0
"""Half width (mm) of the strip about the mirror plane that holds no arm."""
PROTRUDING = np.array([0.42, 0.09, 0.90])
"""Direction (outwards, up, front) in which an apex sticks out farthest."""
SHOULDER_OUT, SHOULDER_UP, SHOULDER_BACK = 124.0, (170.0, 240.0), (-230.0, -130.0)
"""The middle of the shoulder, mm: distance from the mirror plane (mean of 14, spread 6), and where it can lie above and
behind the apex."""
BREAST_AXES = np.array([[0.18, -0.95, 0.23], [0.88, 0.05, -0.47], [0.43, 0.28, 0.85]])
"""Mean axes x, y, z of the cup frames (left) in the body's (outwards, up, front)."""
_Q, _R = np.linalg.qr(BREAST_AXES.T)
BREAST_FRAME: Float[np.ndarray, "3 3"] = (_Q * np.sign(np.diag(_R))).T
"""The same, made orthonormal: the frame in which `brafit.anatomy.wire_detection` works."""


@dataclass(frozen=True, eq=False)
class Body:
    """Axes of a standing body: unit vectors to the wearer's left, up and to the front, and the mirror plane's offset
    along the first."""

    left: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    front: Float[np.ndarray, "3"]
    offset: float

    def outwards(self, side: str) -> Float[np.ndarray, "3 3"]:
        """Rows: outwards, up, front, for a side; right-handed for the left one, mirrored for the right one."""
        return np.stack([self.left if side == "left" else -self.left, self.up, self.front])

    def away(self, points: Float[np.ndarray, "*n 3"], side: str) -> Float[np.ndarray, "*n"]:
        """Distances of points from the mirror plane, outwards of a side."""
        return points @ self.outwards(side)[0] - (self.offset if side == "left" else -self.offset)

    def protruding(self, side: str) -> Float[np.ndarray, "3"]:
        """The unit vector PROTRUDING of a side."""
        return PROTRUDING @ self.outwards(side) / np.linalg.norm(PROTRUDING)

    def breast_axes(self, side: str) -> Float[np.ndarray, "3 3"]:
        """Rows: x, y, z of the frame in which `brafit.anatomy.wire_detection` works, about a breast of this side."""
        return BREAST_FRAME @ self.outwards(side)


def body_from_marks(
    ends: Float[np.ndarray, "2 3"], below: Float[np.ndarray, "3"], apex: Float[np.ndarray, "3"], side: str
) -> Body:
    """Axes from a breast's own marks, where there is no whole torso. Nothing there says where the body's middle is: the
    mirror plane's offset is nan.

    The cup's mean axes (`BREAST_AXES`) are turned back into the body's.

    Args:
        ends: inner and outer end of the wire.
        below: a direction downwards in the wire's plane.
        apex: the bust point.
        side: the wearer's `left` or `right`.
    """
    y = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    # The apex lies before the chest, but also below the middle between the ends: only what is across counts.
    front = apex - ends.mean(axis=0)
    front = front - (front @ below) / (below @ below) * below
    z = front - (front @ y) * y
    z /= np.linalg.norm(z)
    x = below - (below @ y) * y - (below @ z) * z
    x /= np.linalg.norm(x)
    outwards, up, forward = BREAST_FRAME.T @ np.stack([x, y, z])
    return Body(outwards if side == "left" else -outwards, up, forward, np.nan)


FEW = 100
"""Points about the plane of symmetry from which on they show a trunk."""


def candidates(points: np.ndarray) -> list[Body]:
    """Bodies with each choice of up and front."""
    mirror = mirror_of(points)
    left = mirror.normal
    strip = points[np.abs(points @ left - mirror.offset) < TRUNK]
    strip = strip if len(strip) >= FEW else points  # the plane lies between two bodies
    strip = strip - np.median(strip, axis=0)
    strip = strip - np.outer(strip @ left, left)
    strip = strip[np.linalg.norm(strip, axis=1) < 4 * np.median(np.linalg.norm(strip, axis=1))]
    along = np.linalg.eigh(strip.T @ strip)[1][:, 2]
    bodies = []
    for up_sign in (1.0, -1.0):
        for front_sign in (1.0, -1.0):
            front = front_sign * np.cross(left, along)
            up = up_sign * along
            # The trunk's axis leans back: the vertical is that much farther to the front.
            up = np.cos(LEAN) * up + np.sin(LEAN) * front
            axis = max((s * e for e in np.eye(3) for s in (1, -1)), key=lambda axis: float(axis @ up))
            if axis @ up > np.cos(LEVEL):
                up = axis - (axis @ left) * left
                up = up / np.linalg.norm(up)
            front = front - (front @ up) * up
            front = front / np.linalg.norm(front)
            towards_left = np.cross(up, front)
            bodies.append(Body(towards_left, up, front, float(mirror.offset * (towards_left @ left))))
    return bodies


def shoulders(body: Body, points: np.ndarray) -> float:
    """Height of the lower shoulder: the least of the tops beside the neck, so that a raised arm does not count."""
    out, height = points @ body.left - body.offset, points @ body.up
    beside = [height[np.abs(out - sign * place) < 5.0] for sign in (1, -1) for place in (105.0, 115.0, SHOULDER_OUT)]
    return min((float(np.quantile(part, 0.99)) for part in beside if len(part) >= 20), default=float(height.max()))


def neck_of(body: Body, points: np.ndarray) -> float:
    """By how much (mm) the body's middle reaches above its shoulders: neck and head do, where it is upside down the
    middle is flat, or there are legs. At most 100 either way.
    """
    middle = points[np.abs(points @ body.left - body.offset) < 30.0] @ body.up
    if len(middle) < 20:
        return 0.0
    return float(np.clip(np.quantile(middle, 0.99) - shoulders(body, points), -100.0, 100.0))
