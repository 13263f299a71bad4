"""Where fits start: edges as arcs that reach as far from the wire's chord as the cloud does."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from brafit.fit.targets import Target

_SPREAD = (0.5, 0.4, 0.6, 0.33, 0.67)


def start_profiles(
    target: Target, panels: int, count: int, seed: int = 0
) -> tuple[Float[np.ndarray, "count panels"], Float[np.ndarray, "count panels"]]:
    """Angles (radians) and reaches (mm) of the edges above the wire, for `count` starts of one scan.

    Seen along the wire's chord (the y axis), the cup is a profile from the wire's bottom over the apex to the upper
    edge. Each edge is put at an angle about the chord between those two, as far out as the cloud is there. The first
    start spaces the edges evenly, the next ones move the ridges down and up, any further ones at random (from `seed`,
    the same for every scan).
    """

    def polar(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.arctan2(points[..., 2], points[..., 0]), np.hypot(points[..., 0], points[..., 2])

    cloud_angle, cloud_reach = polar(target.points)
    wire_angle, wire_reach = polar(target.wire)
    bottom = wire_angle[wire_reach.argmax()]
    if target.neckline is not None:
        line_angle, line_reach = polar(target.neckline)
        top, top_reach = line_angle[line_reach.argmax()], line_reach.max()
    elif target.strap_point is not None:
        top, top_reach = (float(v[0]) for v in polar(target.strap_point[None]))
    else:
        top = np.quantile(cloud_angle, 0.98)
        top_reach = np.quantile(cloud_reach[cloud_angle >= np.quantile(cloud_angle, 0.9)], 0.95)
    random = np.random.default_rng(seed)
    angles, reaches = np.empty((count, panels)), np.empty((count, panels))
    for k in range(count):
        middle = _SPREAD[k] if k < len(_SPREAD) else random.uniform(0.25, 0.75)
        share = np.arange(1, panels + 1) / panels
        share = share + 4 * (middle - 0.5) * share * (1 - share)
        angles[k] = bottom + share * (top - bottom)
        for i in range(panels - 1):
            near = np.abs(cloud_angle - angles[k, i]) < np.radians(10)
            reaches[k, i] = np.quantile(cloud_reach[near], 0.95) if near.any() else wire_reach.max()
        reaches[k, -1] = top_reach
    return angles, reaches
