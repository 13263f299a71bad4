"""Both breasts of a body: how far what was found of them can be trusted, and one pair of marks where they are alike.

Where the two are mirror images, so are their marks: the mean of what was found on either side, in the mirrored frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from brafit.anatomy.body import Body
from brafit.anatomy.confidence import Confidence, compared, evidence
from brafit.anatomy.wire_detection import FoundWire
from brafit.geometry.polyline import polyline_length
from brafit.surface.cropping import facing, neckline_over
from brafit.surface.normals import Surface
from brafit.surface.symmetry import ALIKE, SYMMETRIC, Mirror, breasts_apart

ARM = 12.0
"""What is so much (mm) farther outwards than the wire may be an arm: no neckline is laid on it."""
OF_THE_PAIR = ("wires", "mirrored")
"""How the two sides agree, where only one of them bears the marks of both."""


@dataclass(frozen=True, eq=False)
class Breast:
    """What was found of one breast, in the scan's frame, mm.

    Attributes:
        side: the wearer's `left` or `right`.
        apex: the bust point.
        wire: in the crease, inner end first.
        strap: where a strap meets the upper line.
        upper_line: of the cup, inner end first.
        surface: about the breast.
    """

    side: str
    apex: Float[np.ndarray, "3"]
    wire: FoundWire
    strap: Float[np.ndarray, "3"]
    upper_line: Float[np.ndarray, "m 3"]
    surface: Surface

    def mapped(self, mirror: Mirror, side: str) -> Breast:
        """Its marks on the other breast, which keeps its own name and surface for whoever looks them up there."""
        wire = replace(self.wire, line=mirror(self.wire.line))
        return Breast(side, mirror(self.apex), wire, mirror(self.strap), mirror(self.upper_line), self.surface)


def trunk_of(surface: Surface, wire: Float[np.ndarray, "k 3"], body: Body, side: str) -> Surface:
    """The part of the surface about a breast that is no arm's.

    Args:
        surface: about the breast, mm.
        wire: of the breast.
        body: axes of the torso.
        side: the wearer's `left` or `right`.
    """
    return surface.select(body.away(surface.points, side) < float(body.away(wire, side).max()) + ARM)


def confidences(body: Body, found: Sequence[Breast]) -> list[Confidence]:
    """How far marks of both sides can be trusted. Where one side has no breast the two are not compared; where they are
    too far apart to be a pair, the side that rises less is none.

    Args:
        body: axes of the torso.
        found: both sides.
    """
    alone = [_alone(body, breast) for breast in found]
    if any(one.faults for one in alone):
        return alone
    pair = _compared(body, found)
    deepest = max(max(breast.wire.hollow for breast in found), 1e-9)
    lengths = [polyline_length(breast.wire.line) for breast in found]
    both = []
    for k, one in enumerate(alone):
        own = {"crease": max(found[k].wire.hollow, 0.0) / deepest, "longer": lengths[k] - lengths[1 - k]}
        both.append(Confidence(one.side, {**one.evidence, **pair, **own}))
    faulty = [one for one in both if one.faults]
    if len(faulty) == 2:  # too far apart to be a pair
        faulty = [min(both, key=lambda one: one.evidence["rise"])]
    return [one if one in faulty or not faulty else only for one, only in zip(both, alone, strict=True)]


def are_alike(
    points: Float[np.ndarray, "n 3"],
    mirror: Mirror,
    body: Body,
    side: str,
    apex: Float[np.ndarray, "3"],
    wire: Float[np.ndarray, "k 3"],
) -> bool:
    """Whether both breasts of a body are mirror images of each other, within ALIKE.

    Args:
        points: of the whole scan, mm.
        mirror: its plane of symmetry.
        body: axes of the torso.
        side: of the breast that says where to look, the wearer's `left` or `right`.
        apex: its bust point.
        wire: its wire line.
    """
    if mirror.rms > SYMMETRIC:
        return False
    axes = body.breast_axes(side)

    def before(places: np.ndarray) -> np.ndarray:
        """In the breast's frame, whose z leads out of the chest."""
        return (places - apex) @ axes.T

    middle, length = before(wire.mean(axis=0)), polyline_length(wire)
    return breasts_apart(before(points), before(mirror(points)), middle, length) < ALIKE


def mean_wire(wires: Sequence[FoundWire]) -> FoundWire:
    """The mean of wires that were found on the same breast, with as many points each."""
    return FoundWire(
        np.mean([one.line for one in wires], axis=0),
        float(np.mean([one.guessed for one in wires])),
        float(np.mean([one.hollow for one in wires])),
    )


def one_pair(
    mirror: Mirror, body: Body, found: Sequence[Breast], trusted: Sequence[Confidence]
) -> tuple[list[Breast], list[Confidence]]:
    """The marks of two breasts that are alike, as one pair of mirror images, and how far they can be trusted.

    The mean of both sides' marks; the marks of one side alone, where those of the other are impossible. On 21
    parametric bodies the ends of the mean are off by 11 and 16 mm (RMS), those of either side by 12 and 17, and so are
    those of the side with the greater confidence. A wire found on the points of both together is farther off.

    Args:
        mirror: the plane between the two.
        body: axes of the torso.
        found: both sides, as they were found.
        trusted: of both, from `confidences`; at least one has no faults.
    """
    first, second = found
    sound = [breast for breast, one in zip(found, trusted, strict=True) if not one.faults]
    on_first = [breast if breast is first else breast.mapped(mirror, first.side) for breast in sound]
    mean = _mean(first.side, on_first)
    surfaces = [first.surface, second.surface]
    images = [mean, mean.mapped(mirror, second.side)]
    images = [replace(image, surface=surface) for image, surface in zip(images, surfaces, strict=True)]
    lines = [_upper_line(image, body) for image in images]
    upper = (lines[0] + mirror(lines[1])) / 2
    images = [replace(images[0], upper_line=upper), replace(images[1], upper_line=mirror(upper))]
    alone = [_alone(body, image) for image in images]
    agreed = {key: float(np.mean([one.evidence[key] for one in alone])) for key in alone[0].evidence}
    return images, [Confidence(one.side, agreed | _agreement(body, found, trusted)) for one in alone]


def _alone(body: Body, breast: Breast) -> Confidence:
    found = evidence(breast.surface, body, breast.side, breast.apex, breast.wire.line)
    return Confidence(breast.side, found)


def _compared(body: Body, found: Sequence[Breast]) -> dict[str, float]:
    return compared(body, {b.side: b.apex for b in found}, {b.side: b.wire.line for b in found})


def _agreement(body: Body, found: Sequence[Breast], trusted: Sequence[Confidence]) -> dict[str, float]:
    """How well the two sides agreed before they were made one pair."""
    pair = _compared(body, found)
    if any(one.faults for one in trusted):
        return {key: pair[key] for key in OF_THE_PAIR}
    return pair | {"crease": min(one.evidence["crease"] for one in trusted)}


def _mean(side: str, found: Sequence[Breast]) -> Breast:
    """The mean of marks that were found on one breast."""

    def mean(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.mean(values, axis=0)

    wire = mean_wire([breast.wire for breast in found])
    apex, strap = mean([breast.apex for breast in found]), mean([breast.strap for breast in found])
    return Breast(side, apex, wire, strap, found[0].upper_line, found[0].surface)


def _upper_line(breast: Breast, body: Body) -> np.ndarray:
    wire = breast.wire.line
    trunk = trunk_of(breast.surface, wire, body, breast.side)
    return neckline_over(trunk, wire[0], breast.strap, wire[-1], facing(wire, body.front))
