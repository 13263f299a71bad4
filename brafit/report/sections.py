"""Sections of surfaces with planes, of many surfaces at once: the way of a tape that is held upright or level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

_X = 0


def sections(
    grids: Float[ndarray, "cups rows n 3"], starts: Float[ndarray, "cups 3"], axis: int
) -> tuple[Float[ndarray, " cups"], Float[ndarray, " cups"]]:
    """Lengths of planes' sections from points on them to the surfaces' rims, both ways: first to the lower end (that
    with the greater x), then to the other; nan where a section does not come to the rim twice.

    Args:
        grids: points of each surface, which is taken as two triangles for each four of them.
        starts: on each surface.
        axis: the planes are at right angles to this axis.
    """
    cuts = _cuts(grids, starts[:, axis], axis)
    found = np.full((2, len(grids)), np.nan)
    if not len(cuts.pairs):
        return found[0], found[1]
    a, b = cuts.points[cuts.pairs[:, 0]], cuts.points[cuts.pairs[:, 1]]
    step, own = b - a, cuts.owner[cuts.pairs[:, 0]]
    share = np.clip(((starts[own] - a) * step).sum(1) / np.maximum((step**2).sum(1), 1e-30), 0, 1)
    away = np.linalg.norm(a + share[:, None] * step - starts[own], axis=1)
    order = np.lexsort((away, own))
    cups, first = np.unique(own[order], return_index=True)
    nearest = order[first]
    lengths, ends = _followed(cuts.pairs, np.linalg.norm(step, axis=1))
    ways = 2 * nearest[:, None] + np.array((0, 1))  # from the nearest piece on, past its one end and past the other
    last = np.where(ends[ways] < 0, 0, ends[ways])
    to_end = np.linalg.norm(cuts.points[cuts.pairs[nearest]] - starts[cups, None], axis=2) + lengths[ways]
    whole = ((ends[ways] >= 0) & cuts.on_rim[last]).all(1) & (last[:, 0] != last[:, 1])
    height = cuts.points[last, _X]
    lower = np.where(height[:, 0] >= height[:, 1], 0, 1)
    each = np.arange(len(cups))
    found[0, cups] = np.where(whole, to_end[each, lower], np.nan)
    found[1, cups] = np.where(whole, to_end[each, 1 - lower], np.nan)
    return found[0], found[1]


@dataclass(frozen=True)
class _Cuts:
    """Where triangles' sides cross planes.

    Attributes:
        points: where.
        owner: the surface of each point.
        pairs: points that a triangle joins.
        on_rim: which points lie on a surface's first or last row.
    """

    points: Float[ndarray, "k 3"]
    owner: Int[ndarray, " k"]
    pairs: Int[ndarray, "m 2"]
    on_rim: Bool[ndarray, " k"]


def _cuts(grids: Float[ndarray, "cups rows n 3"], levels: Float[ndarray, " cups"], axis: int) -> _Cuts:
    _, rows, n = grids.shape[:3]
    side = grids[..., axis] - levels[:, None, None]
    above = side >= 0
    numbers = np.full((3, *side.shape), -1)
    points, owner, count = [], [], 0
    # sides along a row, across rows, and aslant
    for kind, (down, right) in enumerate(((0, 1), (1, 0), (1, 1))):
        first, last = np.s_[:, : rows - down, : n - right], np.s_[:, down:, right:]
        crossed = above[first] != above[last]
        share = side[first][crossed] / (side[first][crossed] - side[last][crossed])
        points.append(grids[first][crossed] + share[:, None] * (grids[last][crossed] - grids[first][crossed]))
        owner.append(np.nonzero(crossed)[0])
        numbers[kind][first][crossed] = count + np.arange(len(share))
        count += len(share)
    along, across, aslant = numbers
    four = above[:, :-1, :-1].astype(np.int8)
    for corner in (above[:, :-1, 1:], above[:, 1:, :-1], above[:, 1:, 1:]):
        four += corner
    k, row, column = np.nonzero((four > 0) & (four < 4))  # of the others no side is crossed
    slant = aslant[k, row, column]
    triangles = (
        (along[k, row, column], across[k, row, column + 1], slant),
        (along[k, row + 1, column], across[k, row, column], slant),
    )
    found = []
    for sides in triangles:
        three = np.stack(sides, axis=-1)
        three = three[(three >= 0).sum(1) == 2]
        found.append(three[three >= 0].reshape(-1, 2))
    on_rim = np.zeros(count, bool)
    rim = along[:, [0, -1]]
    on_rim[rim[rim >= 0]] = True
    return _Cuts(np.concatenate(points), np.concatenate(owner), np.concatenate(found), on_rim)


def _followed(
    pairs: Int[ndarray, "m 2"], lengths: Float[ndarray, " m"]
) -> tuple[Float[ndarray, " 2*m"], Int[ndarray, " 2*m"]]:
    """How far lines go on beyond each end of each of their pieces, and the point where they end; -1 for a ring.

    All lines at once, in steps that double: twice as far from every end, until all have come to theirs.

    Args:
        pairs: the points that a piece joins; no point is one of more than two pieces.
        lengths: of the pieces.

    Returns:
        for the ends in the order of `pairs`, that of the first piece's first point first.
    """
    ends = pairs.ravel()
    order = np.argsort(ends, kind="stable")
    same = np.flatnonzero(ends[order[1:]] == ends[order[:-1]])
    partner = np.full(len(ends), -1)  # the other piece's end at the same point
    partner[order[same]], partner[order[same + 1]] = order[same + 1], order[same]
    ahead = np.where(partner >= 0, partner ^ 1, np.arange(len(ends)))
    length = np.where(partner >= 0, lengths[partner // 2], 0.0)
    for _ in range(len(pairs).bit_length()):
        if (partner[ahead] < 0).all():
            break
        length, ahead = length + length[ahead], ahead[ahead]
    return length, np.where(partner[ahead] < 0, ends[ahead], -1)
