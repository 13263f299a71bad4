"""Captions: names beside the marks and ends of a piece, where they collide with nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray
from shapely import LineString, Polygon

from brafit.geometry.polyline import running_length
from brafit.pattern.curve import Curve
from brafit.pattern.label import LEVEL, Caption, Sight, box_corners, polygons, text_width

INNER, OUTER = "centre front", "side seam"
"""What the cup's inner and outer ends are called."""
_LEADER_STARTS = ((-0.47, 0.0), (0.47, 0.0), *((x, y) for x in (-0.35, -0.2, 0.0, 0.2, 0.35) for y in (-0.5, 0.5)))
"""Where a leader may begin, in widths and heights of the text from its middle."""
_CAPTIONS = (2.8, 2.4, 2.0)
"""Heights of letters in mm that captions are tried in."""
_SEAM_SHARES = np.array((0.22, 0.78, 0.28, 0.72, 0.17, 0.83, 0.4, 0.6, 0.13, 0.87))
"""Where along a seam its name may stand, the best first."""


def place_captions(
    sight: Sight,
    edges: Sequence[Curve],
    marks: Sequence[tuple[str, Float[ndarray, "2"], Float[ndarray, "2"]]],
    holes: Sequence[tuple[str, Float[ndarray, "2"]]],
    grain: tuple[str, Float[ndarray, "2 2"]],
    seams: Sequence[SeamSide] = (),
) -> tuple[Caption, ...]:
    """Captions of marks inside a piece, of its grain line, of its two ends, of marks on the sewing lines, and of seams.

    Args:
        sight: where there is room; takes what is placed.
        edges: the sewing lines, the first from the inner to the outer end.
        marks: name, foot on a sewing line, and unit vector from there into the piece.
        holes: name and place.
        grain: name and ends of the grain line.
        seams: the sewing lines that are sewn to another piece.
    """
    captions = [_first(sight, name, _around(point), point) for name, point in holes]
    if np.linalg.norm(grain[1][1] - grain[1][0]) > 0:
        captions.append(_first(sight, grain[0], _along_line(grain[1]), grain[1].mean(0)))
    lower, upper = edges[0], edges[-1].reversed()
    for name, a, b in ((INNER, lower, upper), (OUTER, lower.reversed(), upper.reversed())):
        tip, away = a.start, (_along(a, np.array([12.0])) + _along(b, np.array([12.0])))[0] - 2 * a.start
        outward = -away / max(float(np.linalg.norm(away)), 1e-9)
        captions.append(_first(sight, name, _from_tip(tip, a, b, outward, sight), tip))
    for name, foot, inward in marks:
        captions.append(_first(sight, name, _beside(foot, inward), foot))
    for seam in seams:
        captions.append(_first(sight, seam.name, _along_seam(seam), seam.curve.at(seam.curve.length / 4)[0]))
    return tuple(captions)


@dataclass(frozen=True)
class SeamSide:
    """A sewing line that is sewn to another piece.

    Attributes:
        name: of the seam, the same on the other piece.
        curve: the line, from the inner end, so that both pieces have the name at about the same place.
        allowance: beyond it, mm.
        outward: 1 where the cloth lies to its left, -1 where it lies to its right.
    """

    name: str
    curve: Curve
    allowance: float
    outward: float


@dataclass(frozen=True)
class _Places:
    """Where a text may stand, the best first: middles and directions.

    `within`: the polygon that it has to lie in there, None: the piece with its allowance; `led`: whether a line leads
    to what it names.
    """

    at: Float[ndarray, "n 2"]
    along: Float[ndarray, "n 2"]
    within: Polygon | None = None
    led: bool = False


def _first(sight: Sight, words: str, places: Callable[[str, float], Sequence[_Places]], foot: ndarray) -> Caption:
    """The caption at the first place that is free beside what it names, else near it with a leader, else anywhere on
    the piece."""
    for size, group in chain(_near(words, places), ((size, _anywhere(foot, sight)) for size in _CAPTIONS)):
        along = np.where(group.along[:, :1] >= -1e-9, 1.0, -1.0) * group.along
        boxes = polygons(box_corners(group.at, along, text_width(words, size), size))
        free = sight.free(boxes) & shapely.contains(sight.cut if group.within is None else group.within, boxes)
        if group.led:
            free &= sight.passable(_leader_starts(group.at, along, text_width(words, size), size, foot), foot)
        if free.any():
            k = int(free.argmax())
            caption = Caption(words, group.at[k], along[k], size)
            sight.take(boxes[k].buffer(0.4))
            if not group.led:
                return caption
            caption = _led(caption, foot)
            sight.take(LineString(caption.leader).buffer(0.4))
            return caption
    return _outside(sight, words, foot)


def _near(words: str, places: Callable[[str, float], Sequence[_Places]]) -> Iterator[tuple[float, _Places]]:
    """Places beside what a caption names in every size, largest first, then those that need a leader; made as they are
    asked for."""
    led = []
    for size in _CAPTIONS:
        for group in places(words, size):
            if group.led:
                led.append((size, group))
            else:
                yield size, group
    yield from led


def _outside(sight: Sight, words: str, foot: ndarray) -> Caption:
    """Above or below a piece that has no room, with a leader."""
    size = _CAPTIONS[-1]
    low, high = sight.cut.bounds[1], sight.cut.bounds[3]
    below = foot[1] < (low + high) / 2
    step = np.array((0.0, -2.0 * size if below else 2.0 * size))
    caption = Caption(words, np.array((foot[0], low if below else high)) + step, LEVEL, size)
    while sight.taken(Polygon(caption.corners)):
        caption = replace(caption, at=caption.at + step)
    sight.take(Polygon(caption.corners).buffer(0.4))
    return _led(caption, foot)


def _led(caption: Caption, foot: ndarray) -> Caption:
    """With a line from the nearest side of it to what it names."""
    width = text_width(caption.words, caption.size)
    (near,) = _leader_starts(caption.at[None], caption.along[None], width, caption.size, foot)
    return replace(caption, leader=np.stack((near, foot)))


def _leader_starts(
    at: Float[ndarray, "n 2"], along: Float[ndarray, "n 2"], width: float, height: float, foot: Float[ndarray, "2"]
) -> Float[ndarray, "n 2"]:
    """Where leaders of texts begin: above, below or beside the letters, not at the corners of the box around them,
    which is rather too wide."""
    across = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    starts = np.stack(
        [at + x * width * along + y * height * across for x, y in _LEADER_STARTS],
        axis=1,
    )
    nearest = np.linalg.norm(starts - foot, axis=2).argmin(1)
    return starts[np.arange(len(at)), nearest]


def _anywhere(foot: ndarray, sight: Sight) -> _Places:
    """A grid over the piece, the nearest places first."""
    low, high = np.array(sight.cut.bounds[:2]), np.array(sight.cut.bounds[2:])
    grid = np.stack(np.meshgrid(*(np.arange(a, b, 2.5) for a, b in zip(low, high, strict=True))), axis=-1).reshape(
        -1, 2
    )
    grid = grid[np.argsort(np.linalg.norm(grid - foot, axis=1))][:1500]
    return _Places(grid, np.broadcast_to(LEVEL, grid.shape), led=True)


def _around(point: ndarray) -> Callable[[str, float], Sequence[_Places]]:
    """Places beside, above and below a mark, level."""

    def places(words: str, size: float) -> Sequence[_Places]:
        width = text_width(words, size)
        spots = []
        for gap in (4.0, 5.5, 8.0):
            aside, up = gap + width / 2, gap + size / 2
            spots += [
                (aside, 0),
                (-aside, 0),
                (0, -up),
                (0, up),
                (aside, up),
                (aside, -up),
                (-aside, up),
                (-aside, -up),
            ]
        return [_Places(point + np.array(spots), np.broadcast_to(LEVEL, (len(spots), 2)))]

    return places


def _along_line(ends: Float[ndarray, "2 2"]) -> Callable[[str, float], Sequence[_Places]]:
    """Places along a line on either side of it, the middle first."""
    step = ends[1] - ends[0]
    along = step / np.linalg.norm(step)
    across = np.array((-along[1], along[0]))
    shares = np.array((0.5, 0.35, 0.65, 0.2, 0.8, 0.1, 0.9))

    def places(words: str, size: float) -> Sequence[_Places]:
        gap = size / 2 + 2.0
        at = np.concatenate([ends[0] + shares[:, None] * step + way * gap * across for way in (1, -1)])
        return [_Places(at, np.broadcast_to(along, at.shape))]

    return places


def _along_seam(seam: SeamSide) -> Callable[[str, float], Sequence[_Places]]:
    """Places along a seam: in its allowance, where no other text wants to be, else inside the line."""
    middle, along = seam.curve.trace(seam.curve.places(_SEAM_SHARES * seam.curve.length))
    outward = seam.outward * along[:, ::-1] * (1.0, -1.0)

    def places(words: str, size: float) -> Sequence[_Places]:
        gaps = (seam.allowance / 2, -(size / 2 + 1.5), -(size / 2 + 3.0))
        return [_Places(middle + gap * outward, along) for gap in gaps]

    return places


def _beside(foot: ndarray, inward: ndarray) -> Callable[[str, float], Sequence[_Places]]:
    """Places inside a sewing line, the nearest first: level, then along the line."""
    edge = np.array((-inward[1], inward[0]))
    along = np.stack((LEVEL, edge))
    across = np.stack((-along[:, 1], along[:, 0]), axis=-1)

    def group(words: str, size: float, distances: tuple[float, ...], led: bool) -> _Places:
        shifts = (0.0, 3.0, -3.0, 6.0, -6.0, 10.0, -10.0)
        distance, way, shift = (v.ravel() for v in np.meshgrid(distances, (0, 1), shifts, indexing="ij"))
        half = (np.abs(along @ inward) * text_width(words, size) + np.abs(across @ inward) * size) / 2
        at = foot + (distance + np.sign(distance) * half[way])[:, None] * inward + shift[:, None] * edge
        return _Places(at, along[way], led=led)

    def places(words: str, size: float) -> Sequence[_Places]:
        beyond = group(words, size, (-1.0, -2.0), False)
        return [
            group(words, size, (1.0, 2.0, 3.5), False),
            beyond,
            group(words, size, (5.0, 7.0, 9.0, 12.0, 16.0, 20.0), True),
        ]

    return places


def _from_tip(
    tip: ndarray, a: Curve, b: Curve, outward: ndarray, sight: Sight
) -> Callable[[str, float], Sequence[_Places]]:
    """Places between two edges, from their common end on; last in the allowance beyond it.

    A sharp tip is narrow: there the text follows its middle line.
    """
    reach = np.arange(2.0, 0.45 * min(a.length, b.length, 150.0), 1.5)
    middles = (_along(a, reach) + _along(b, reach)) / 2
    k = np.arange(len(middles))
    beyond = middles[np.minimum(k + 3, len(k) - 1)] - middles[np.maximum(k - 3, 0)]
    follow = beyond / np.maximum(np.linalg.norm(beyond, axis=1, keepdims=True), 1e-9)
    near = (k < len(k) - 2) & (np.linalg.norm(middles - tip, axis=1) < 45)
    directions = np.stack((np.broadcast_to((1.0, 0.0), follow.shape), follow), axis=1)[near]
    across = np.array((-outward[1], outward[0]))

    def places(words: str, size: float) -> Sequence[_Places]:
        between = _Places(np.repeat(middles[near], 2, axis=0), directions.reshape(-1, 2), sight.inside)
        out = tip + (size / 2 + np.array((1.2, 2.0, 3.0)))[:, None] * outward
        return [between, _Places(out, np.broadcast_to(across, out.shape))]

    return places


def _along(curve: Curve, distances: Float[ndarray, " n"]) -> Float[ndarray, "n 2"]:
    """About the points at arc lengths from a curve's start."""
    points = curve.polyline(0.05)
    lengths = running_length(points)
    return np.stack([np.interp(distances, lengths, points[:, i]) for i in range(2)], axis=-1)
