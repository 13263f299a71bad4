"""From points and a wire line as arrays to a pattern, without any file: half a dome, whose size is known.

    python examples/points_to_pattern.py [key=value ...]

Prints what the fit found beside what is known of the dome: the length of its wire, and how far it reaches out of the
wire's plane. A dome is no developable surface, so the cup cannot follow it everywhere: the RMS says how far it is off,
and more panels (cup.panels=3) bring it down.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

import brafit

WIDE, DEEP = 65.0, 55.0
"""Half the span of the wire, and the reach of the dome, mm."""


def dome(count: int) -> np.ndarray:
    """Points of a breast, (count, 3): y points up, z out of the chest; the wire's half circle lies below."""
    random = np.random.default_rng(1)
    points = random.standard_normal((count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return np.stack([WIDE * points[:, 0], -WIDE * abs(points[:, 1]), DEEP * abs(points[:, 2])], axis=1)


def arc(rise: float, reach: float) -> np.ndarray:
    """Half an ellipse from the wire's inner end to its outer one, (51, 3)."""
    turn = np.linspace(0, np.pi, 51)
    return np.stack([-WIDE * np.cos(turn), -rise * np.sin(turn), reach * np.sin(turn)], axis=1)


def main(settings: Sequence[str]) -> None:
    wire, neckline = arc(WIDE, 0.0), arc(0.0, DEEP)
    result = brafit.fit(dome(4000), wire=wire, neckline=neckline, side="left", name="dome", settings=settings)
    depth = result.fit.shape.edges[..., 2].max().item()
    print(f"RMS {result.figures['rms_mm']:.2f} mm, largest distance {result.figures['max_mm']:.2f} mm")
    print(f"wire {result.figures['wire_length_mm']:.2f} mm; of the dome {np.pi * WIDE:.2f} mm")
    print(f"edges reach {depth:.1f} mm; the dome {DEEP:.1f} mm")


if __name__ == "__main__":
    main(sys.argv[1:])
