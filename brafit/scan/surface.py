"""A cloud as a sample of a surface: normals with one outward side, noise off the surface, ways along it.

The tool for all three is the graph of nearest neighbours. What lies on two sheets (breast and belly with a gap of
millimetres between them) is told apart by normals, never by distance alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import KDTree

NEIGHBOURS = 24
"""Points that a local plane is laid through."""
LINKS = 10
"""Neighbours that a point is linked to."""
REACH = 4.0
"""A link is no longer than this many times the cloud's spacing (the 90th percentile of the distance to the LINKS-th
neighbour counts as 1.8 of it on a plane)."""
FACING = 0.3
"""Least cosine between the normals of linked points."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Points with unit normals that all look to the same, outer side.

    Attributes:
        points, normals: the sample.
        spacing: typical distance between neighbours (median of the distance to the nearest four, averaged).
    """

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    spacing: float

    def select(self, mask: Bool[np.ndarray, " n"]) -> Surface:
        """The part of it under the mask."""
        return Surface(self.points[mask], self.normals[mask], self.spacing)


def surface_of(points: Float[np.ndarray, "n 3"], outward: Float[np.ndarray, "3"]) -> Surface:
    """Normals by local planes, turned to one side along the graph's minimum spanning tree, then outwards.

    Args:
        points: at least `NEIGHBOURS` of them.
        outward: the direction to which most normals look (the cup frame's z, the front of a body).
    """
    distances, near = _neighbours(points, NEIGHBOURS)
    normals = np.linalg.eigh(_covariances(points, near))[1][:, :, 0]
    normals = _one_side(normals, distances, near)
    if np.median(normals @ outward) < 0:
        normals = -normals
    return Surface(points, normals, float(np.median(distances[:, 1:5].mean(axis=1))))


def off_surface(
    points: Float[np.ndarray, "n 3"], width: float = 4.0, neighbours: int = NEIGHBOURS
) -> Bool[np.ndarray, " n"]:
    """Mask of points that float off the sheet that their neighbours make up.

    A plane is laid through each point's neighbours, again without those that lie far off it; a point goes when its
    distance from that plane exceeds `width` times the cloud's noise (the median of those distances, as a standard
    deviation) and the distance to its fourth neighbour. So neither curved places nor thin ones lose points.
    """
    if len(points) <= neighbours:
        return np.zeros(len(points), dtype=bool)
    distances, near = _neighbours(points, neighbours)
    others = points[near[:, 1:]]
    weights = np.ones(others.shape[:2])
    residual = np.zeros(len(points))
    for _ in range(3):
        total = weights.sum(axis=1)
        centre = np.einsum("nk,nki->ni", weights, others) / total[:, None]
        offset = others - centre[:, None]
        covariance = np.einsum("nk,nki,nkj->nij", weights, offset, offset) / total[:, None, None]
        normal = np.linalg.eigh(covariance)[1][:, :, 0]
        residual = np.abs(np.einsum("ni,ni->n", points - centre, normal))
        from_plane = np.abs(np.einsum("nki,ni->nk", offset, normal))
        scale = np.maximum(np.median(from_plane, axis=1), 1e-9)[:, None]
        weights = 1 / (1 + (from_plane / (2 * scale)) ** 2) ** 2
    noise = 1.4826 * float(np.median(residual))
    return (residual > width * noise) & (residual > 0.5 * np.median(distances[:, 4]))


def links(surface: Surface, count: int = LINKS) -> sparse.csr_array:
    """The graph of neighbours along the surface: symmetric, lengths as weights.

    Points are linked if they are near and look to the same side; so no link leads from one sheet to another.
    """
    points, normals = surface.points, surface.normals
    distances, near = _neighbours(points, min(count + 1, len(points)))
    rows = np.repeat(np.arange(len(points)), near.shape[1] - 1)
    columns, lengths = near[:, 1:].ravel(), distances[:, 1:].ravel()
    kept = (lengths <= REACH * surface.spacing) & ((normals[rows] * normals[columns]).sum(axis=1) >= FACING)
    lengths = np.maximum(lengths, 1e-9)  # a zero would be no link
    shape = (len(points), len(points))
    graph = sparse.coo_array((lengths[kept], (rows[kept], columns[kept])), shape=shape).tocsr()
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
    graph: sparse.csr_array, sources: Int[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """For each point the length of the shortest way to a source, and that source (-1 where no way leads)."""
    lengths, _, origin = csgraph.dijkstra(
        graph, directed=False, indices=sources, min_only=True, return_predecessors=True
    )
    return lengths, np.where(np.isfinite(lengths), origin, -1)


def settle(
    surface: Surface, places: Float[np.ndarray, "k 3"], radius: float, tree: KDTree | None = None
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Places drawn onto the surface, and the normals there.

    The surface near a place is the plane through the weighted mean of the points within `radius` (or of the 8 nearest,
    where there are fewer), with a bell of that radius as weights. Only points that face as the nearest one does count.
    """
    tree = KDTree(surface.points) if tree is None else tree
    count = min(64, len(surface.points))
    distances, near = tree.query(places, k=count)
    radius_of = np.maximum(radius, distances[:, min(8, count) - 1])[:, None]
    normals = surface.normals[near]
    alike = np.einsum("nki,ni->nk", normals, normals[:, 0]) > 0
    weights = np.clip(1 - (distances / (1.0001 * radius_of)) ** 2, 0, None) ** 2 * alike
    weights[:, 0] += 1e-12
    weights /= weights.sum(axis=1, keepdims=True)
    centre = np.einsum("nk,nki->ni", weights, surface.points[near])
    normal = np.einsum("nk,nki->ni", weights, normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = ((places - centre) * normal).sum(axis=1, keepdims=True)
    return places - height * normal, normal


def _neighbours(points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances to the nearest `count` points and their indices; each point is its own first neighbour."""
    distances, near = KDTree(points).query(points, k=min(count, len(points)))
    return np.asarray(distances), np.asarray(near)


def _covariances(points: np.ndarray, near: np.ndarray) -> np.ndarray:
    around = points[near]
    offset = around - around.mean(axis=1, keepdims=True)
    return np.einsum("nki,nkj->nij", offset, offset)


def _one_side(normals: np.ndarray, distances: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Turn normals so that neighbours agree, going along the spanning tree of least change (Hoppe et al. 1992).

    Parts of the graph that hang together only by longer links are joined by these, at a high price.
    """
    n, count = near.shape
    rows = np.repeat(np.arange(n), count - 1)
    columns, lengths = near[:, 1:].ravel(), distances[:, 1:].ravel()
    change = 1 - np.abs((normals[rows] * normals[columns]).sum(axis=1))
    # Length counts as well: among equals the nearer neighbour is the better witness.
    cost = change + 0.02 * lengths / max(float(np.median(lengths)), 1e-12) + 1e-9
    graph = sparse.coo_array((cost, (rows, columns)), shape=(n, n)).tocsr()
    tree = csgraph.minimum_spanning_tree(graph.maximum(graph.T))
    tree = (tree + tree.T).tocsr()
    sign = np.zeros(n)
    _, label = csgraph.connected_components(tree, directed=False)
    whole = normals.copy()
    for part in range(label.max() + 1):
        members = np.flatnonzero(label == part)
        root = members[0]
        order, before = csgraph.breadth_first_order(tree, root, directed=False)
        sign[root] = 1.0
        for i in order[1:]:
            k = before[i]
            sign[i] = sign[k] if normals[i] @ normals[k] >= 0 else -sign[k]
        whole[members] = normals[members] * sign[members, None]
    return _agree_between_parts(whole, label)


def _agree_between_parts(normals: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Small unconnected parts look, in the mean, to where the largest does."""
    if label.max() == 0:
        return normals
    main = normals[label == np.bincount(label).argmax()].mean(axis=0)
    turned = normals.copy()
    for part in range(label.max() + 1):
        members = label == part
        if normals[members].mean(axis=0) @ main < 0:
            turned[members] *= -1
    return turned
