"""A cloud as a sample of a surface: normals with one outward side, noise off the surface, ways along it.

The tool for all three is the graph of nearest neighbours. What lies on two sheets (breast and belly with a gap of
millimetres between them) is told apart by normals, never by distance alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

from brafit.surface.neighbours import Neighbours, nearest, tree_of
from brafit.surface.planes import distances_off, normals_at

FRONT = np.array([0.0, 0.0, 1.0])
"""Out of the chest, in the cup frame."""
NEIGHBOURS = 24
"""Points that a local plane is laid through."""
LINKS = 10
"""Neighbours that a point is linked to."""
REACH = 4.0
"""A link is no longer than this many times the cloud's spacing (the 90th percentile of the distance to the LINKS-th
neighbour counts as 1.8 of it on a plane)."""
FACING = 0.3
"""Least cosine between the normals of linked points."""
WIDTH = 4.0
"""A point floats if it is off the plane of its neighbours by more than WIDTH times the cloud's noise."""
CHEAP = 0.2
"""A link whose ends' normals differ by less than this (one less the cosine, and a share of the length) costs little."""
BEHIND = 0.2
"""Most breasts look everywhere away from a place so far behind their middle, over the size of the cloud."""
BELL = 1.0001
"""The foot of the bell in `settle` over its radius: so that the last of the 8 nearest has some weight."""
LEAST, MOST = 8, 64
"""Points whose mean plane `settle` uses for a place, at least and at most."""
PASSES, FEW = 3, 500
"""Floating points are taken out up to PASSES times, since each spoils its neighbours' planes too; fewer times, once
less than one point in FEW floats."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Points with unit normals that all look to the same, outer side.

    Attributes:
        points, normals: the sample.
        spacing: typical distance between neighbours (median of the distance to the nearest four, averaged).
        known: the points' neighbours, where they have been looked up.
    """

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    spacing: float
    known: Neighbours | None = None

    @cached_property
    def tree(self) -> KDTree:
        """Of the points."""
        return tree_of(self.points)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Of the points, NEIGHBOURS of each."""
        return Neighbours.of(self.points, NEIGHBOURS) if self.known is None else self.known

    def at(self, points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> Surface:
        """The surface after a motion that took its points and normals there."""
        known = None if self.known is None else replace(self.known, points=points)
        return Surface(points, normals, self.spacing, known)

    def select(self, mask: Bool[np.ndarray, " n"]) -> Surface:
        """The part of it under the mask."""
        known = None if self.known is None else self.known.among(mask)[0]
        return Surface(self.points[mask], self.normals[mask], self.spacing, known)


def surface_of(
    points: Float[np.ndarray, "n 3"], outward: Float[np.ndarray, "3"], known: Neighbours | None = None
) -> Surface:
    """Normals by local planes, turned to one side along the graph's minimum spanning tree, then outwards.

    Args:
        points: at least `NEIGHBOURS` of them.
        outward: the direction to which most normals look (the cup frame's z, the front of a body).
        known: the points' neighbours, NEIGHBOURS of each at least, where they have been looked up.
    """
    known = Neighbours.of(points, NEIGHBOURS) if known is None else known
    distances, near = known.distances[:, :NEIGHBOURS], known.near[:, :NEIGHBOURS]
    behind = points.mean(axis=0) - BEHIND * float(np.linalg.norm(np.ptp(points, axis=0))) * outward
    normals = _one_side(normals_at(points, near), distances, near, points - behind)
    if np.median(normals @ outward) < 0:
        normals = -normals
    return Surface(points, normals, float(np.median(distances[:, 1:5].mean(axis=1))), known)


def on_surface(known: Neighbours) -> tuple[Bool[np.ndarray, " n"], Neighbours]:
    """Mask of a cloud's points without those that float (see `off_surface`), and the neighbours among what is left."""
    left, kept = np.arange(len(known.points)), np.zeros(len(known.points), dtype=bool)
    away, stale = np.empty(len(left)), np.ones(len(left), dtype=bool)
    for _ in range(PASSES):
        if len(left) <= NEIGHBOURS:
            break
        chosen = np.flatnonzero(stale)
        away[chosen] = distances_off(known.points, chosen, known.near[chosen, 1:NEIGHBOURS])
        off = _floats(away, known.distances)
        known, stale = known.among(~off)
        left, away = left[~off], away[~off]
        if off.sum() <= len(off) // FEW:
            break
    kept[left] = True
    return kept, known


def off_surface(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Mask of points that float off the sheet that their neighbours make up.

    A plane is laid through each point's neighbours, again without those that lie far off it; a point goes when its
    distance from that plane exceeds WIDTH times the cloud's noise (the median of those distances, as a standard
    deviation) and half the distance to its fourth neighbour. So neither curved places nor thin ones lose points.
    """
    if len(points) <= NEIGHBOURS:
        return np.zeros(len(points), dtype=bool)
    known = Neighbours.of(points, NEIGHBOURS)
    return _floats(distances_off(points, np.arange(len(points)), known.near[:, 1:NEIGHBOURS]), known.distances)


def links(surface: Surface, count: int = LINKS) -> sparse.csr_array:
    """The graph of neighbours along the surface: symmetric, lengths as weights.

    Points are linked if they are near and look to the same side; so no link leads from one sheet to another.
    """
    normals, known = surface.normals, surface.neighbours
    width = min(count + 1, len(normals))
    near, lengths = known.near[:, 1:width], known.distances[:, 1:width]
    kept = (lengths <= REACH * surface.spacing) & (_cosines(normals, near) >= FACING)
    graph = _graph(np.maximum(lengths, 1e-9), near, kept)  # a zero would be no link
    return graph.maximum(graph.T).tocsr()


def parts(graph: sparse.csr_array) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " parts"]]:
    """The connected part of each point, numbered from the largest, and the parts' sizes."""
    _, label = csgraph.connected_components(graph, directed=False)
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return rank[label], sizes[order]


def nearest_source(
    graph: sparse.csr_array, sources: Int[np.ndarray, " k"], limit: float = np.inf
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """For each point the length of the shortest way to a source, and that source (-1 where no way leads that is no
    longer than the limit).

    Args:
        graph: symmetric, as `links` gives it.
        sources: indices of points.
        limit: the longest way, in the graph's unit.
    """
    lengths, _, origin = csgraph.dijkstra(
        graph, directed=True, indices=sources, min_only=True, return_predecessors=True, limit=limit
    )
    return lengths, np.where(np.isfinite(lengths), origin, -1)


def settle(
    surface: Surface, places: Float[np.ndarray, "k 3"], radius: float
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Places drawn onto the surface, and the normals there.

    The surface near a place is the plane through the weighted mean of the points within `radius` (or of the 8 nearest,
    where there are fewer), with a bell of that radius as weights. Only points that face as the nearest one does count.

    Args:
        surface: with outward normals.
        places: near the surface, in its unit.
        radius: in its unit.
    """
    distances, near, radius_of = _within(surface, places, radius)
    normals = surface.normals[near]
    alike = np.einsum("nki,ni->nk", normals, normals[:, 0]) > 0
    weights = np.clip(1 - (distances / (BELL * radius_of[:, None])) ** 2, 0, None) ** 2 * alike
    weights[:, 0] += 1e-12
    weights /= weights.sum(axis=1, keepdims=True)
    centre = np.einsum("nk,nki->ni", weights, surface.points[near])
    normal = np.einsum("nk,nki->ni", weights, normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((places - centre) * normal).sum(axis=1, keepdims=True)
    return places - height * normal, normal


def _within(
    surface: Surface, places: Float[np.ndarray, "k 3"], radius: float
) -> tuple[Float[np.ndarray, "k m"], Int[np.ndarray, "k m"], Float[np.ndarray, " k"]]:
    """Distances and indices of the points about each place, filled up by infinite ones, and the radius they lie in."""
    least, most = (min(count, len(surface.points)) for count in (LEAST, MOST))
    distances, near = nearest(surface.tree, places, most, BELL * radius)
    width = max(least, int(np.isfinite(distances).sum(axis=1).max(initial=0)))
    distances, near = distances[:, :width], near[:, :width]
    radius_of = np.full(len(places), radius)
    if len(few := np.flatnonzero(~(distances[:, least - 1] <= radius))):
        distances[few, :least], near[few, :least] = nearest(surface.tree, places[few], least)
        distances[few, least:] = np.inf
        radius_of[few] = distances[few, least - 1]
    return distances, np.where(np.isfinite(distances), near, 0), radius_of


def _floats(away: Float[np.ndarray, " n"], distances: Float[np.ndarray, "n k"]) -> Bool[np.ndarray, " n"]:
    noise = 1.4826 * float(np.median(away))
    return (away > WIDTH * noise) & (away > 0.5 * np.median(distances[:, 4]))


def _graph(
    weights: Float[np.ndarray, "n k"], near: Int[np.ndarray, "n k"], kept: Bool[np.ndarray, "n k"] | None = None
) -> sparse.csr_array:
    """The directed graph from each point to its neighbours, or to those of them that are kept."""
    n, count = near.shape
    if kept is None:
        starts, weights, near = np.arange(0, n * count + 1, count), weights.ravel(), near.ravel()
    else:
        starts, weights, near = np.append(0, np.cumsum(kept.sum(axis=1))), weights[kept], near[kept]
    return sparse.csr_array((weights, near.astype(np.int32), starts.astype(np.int32)), shape=(n, n))


def _cosines(normals: Float[np.ndarray, "n 3"], near: Int[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Between each point's normal and those of its neighbours."""
    total = np.zeros(near.shape)
    for column in np.ascontiguousarray(normals.T):
        total += np.take(column, near) * column[:, None]
    return total


def _one_side(
    normals: Float[np.ndarray, "n 3"],
    distances: Float[np.ndarray, "n k"],
    near: Int[np.ndarray, "n k"],
    outwards: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Turn normals so that neighbours agree, going along the spanning tree of least change (Hoppe et al. 1992).

    Parts of the graph that hang together only by longer links are joined by these, at a high price.

    Args:
        normals: unit normals, to either side.
        distances: of each point to its neighbours, itself first.
        near: indices of the neighbours, itself first.
        outwards: a direction for each point to which its normal may look: where all neighbours then agree, no tree is
            needed.
    """
    turned = normals * np.where((normals * outwards).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    cosines = _cosines(turned, near[:, 1:])
    if (cosines >= 0).all():  # every tree would say the same
        return turned
    lengths, others = distances[:, 1:], near[:, 1:]
    # Length counts as well: among equals the nearer neighbour is the better witness.
    cost = 1 - np.abs(cosines) + 0.02 * lengths / max(float(np.median(lengths)), 1e-12) + 1e-9
    cheap = cost <= CHEAP
    # Where links of little cost all agree, every tree of them says the same: a few will do, and what joins the parts.
    few = cheap.copy()
    few[:, LINKS:] = False
    _, label = csgraph.connected_components(_graph(cost, others, few), directed=False)
    signs = _along_a_tree(_graph(cost, others, few | (label[others] != label[:, None])), turned)
    if (cheap & (cosines * signs[others] * signs[:, None] < 0)).any():
        signs = _along_a_tree(_graph(cost, others), turned)
    return turned * signs[:, None]


def _along_a_tree(graph: sparse.csr_array, normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Signs with which normals agree along a graph's minimum spanning tree."""
    tree = csgraph.minimum_spanning_tree(graph)
    tree = (tree + tree.T).tocsr()
    parts, label = csgraph.connected_components(tree, directed=False)
    before = np.arange(len(normals))
    for root in np.unique(label, return_index=True)[1]:
        order, leads = csgraph.breadth_first_order(tree, root, directed=False)
        before[order[1:]] = leads[order[1:]]
    sign = np.where((normals * normals[before]).sum(axis=1) >= 0, 1.0, -1.0)
    # From every point to its root, in steps that double.
    while (before != before[before]).any():
        sign, before = sign * sign[before], before[before]
    return sign * _agreeing_parts(normals * sign[:, None], label, parts)


def _agreeing_parts(
    normals: Float[np.ndarray, "n 3"], label: Int[np.ndarray, " n"], parts: int
) -> Float[np.ndarray, " n"]:
    """Signs with which small unconnected parts look, in the mean, to where the largest does."""
    if parts == 1:
        return np.ones(len(normals))
    total = np.stack([np.bincount(label, weights=column) for column in normals.T], axis=1)
    main = total[np.bincount(label).argmax()]
    return np.where(total @ main < 0, -1.0, 1.0)[label]
