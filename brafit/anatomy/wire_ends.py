"""Where the ends of a wire usually lie, once the bust point and the wire's bottom are known.

The crease fades towards the outer end: from the side of the chest on, nothing but the breast's size says where its root
ends. The deeper a breast, the farther the bottom of its wire lies behind the bust point, and its ends with it. The laws
are least squares through the marks of every second of 200 parametric bodies (`scripts/check_bodies.py`; prone ones and
men apart). On the other half the outer end lies 13 mm off in the median, nine tenths within 24; an outer end's own mark
is uncertain by 10 mm there. On 14 scans with landmarks it is 13 off in the median and 54 at most, on a breast whose
crease shows that far.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from brafit.anatomy.body import BREAST_FRAME

INNER, INNER_DEEPER = np.array([-69.0, 23.0, 1.0]), np.array([0.38, 0.23, 0.70])
OUTER, OUTER_DEEPER = np.array([50.0, 27.0, -47.0]), np.array([0.38, 0.13, 0.89])
"""Of each end: its place (outwards, up, front; mm from the bust point) where bust point and bottom are level, and what
each millimetre adds by which the bottom lies before it."""


def usual_ends(line: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "2 3"]:
    """Where the inner and the outer end usually lie, by the bottom of a wire line; both in the breast's frame
    (`brafit.anatomy.wire_detection`), mm.
    """
    body = line @ BREAST_FRAME
    before = body[lowest(body[:, 1]), 2]
    return np.stack([INNER + INNER_DEEPER * before, OUTER + OUTER_DEEPER * before]) @ BREAST_FRAME.T


def lowest(height: Float[np.ndarray, " k"]) -> int:
    """Index of a wire's bottom within the middle half of its points: its arms may sink again beyond its ends."""
    arm = len(height) // 4
    return arm + int(height[arm:-arm].argmin())


def off_usual(wire: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " 2"]:
    """How far (mm) the inner and the outer end of a wire lie from where they usually do, in the breast's frame."""
    return np.linalg.norm(wire[[0, -1]] - usual_ends(wire), axis=1)
