"""Constraints of the sheet from its triangles: stretch edges, bending hinges, areas; rebuilt after every cut."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class Topology:
    """`edges` (E, 2), `edge_triangles` (E, 2), -1 at borders, `hinges` (H, 4) with `hinge_weights` (H, 4), `hinge_scale` (H,).

    `edge_share` (E,) is each edge's share of the sheet's area, `vertex_area` (V,) each vertex's.
    """

    edges: IntArray
    edge_triangles: IntArray
    edge_share: Array
    hinges: IntArray
    hinge_weights: Array
    hinge_scale: Array
    vertex_area: Array


def build_topology(rest: Array, triangles: IntArray) -> Topology:
    """Topology of a sheet with rest coordinates `rest` (V, 2) [m] and `triangles` (T, 3)."""
    edges, edge_triangles, opposite = edges_of(triangles)
    area = triangle_areas(rest, triangles)
    padded = np.append(area, 0.0)
    share = padded[edge_triangles].sum(axis=1) / 3.0
    vertex_area = np.zeros(len(rest))
    np.add.at(vertex_area, triangles.ravel(), np.repeat(area / 3.0, 3))
    inner = (edge_triangles >= 0).all(axis=1)
    hinges = np.column_stack([edges[inner], opposite[inner]]).astype(np.int32)
    weights = _hinge_weights(rest, hinges)
    scale = 3.0 / np.maximum(padded[edge_triangles[inner]].sum(axis=1), 1e-12)
    return Topology(edges, edge_triangles, share, hinges, weights, scale, vertex_area)


def edges_of(triangles: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Unique edges (E, 2), the one or two triangles of each (E, 2), and the vertices opposite in those (E, 2); -1 where none."""
    count = len(triangles)
    half = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    facing = np.concatenate([triangles[:, 2], triangles[:, 0], triangles[:, 1]])
    owner = np.tile(np.arange(count, dtype=np.int32), 3)
    low, high = half.min(axis=1).astype(np.int64), half.max(axis=1).astype(np.int64)
    keys, first, inverse = np.unique(low * (int(triangles.max()) + 1) + high, return_index=True, return_inverse=True)
    edges = np.column_stack([low[first], high[first]]).astype(np.int32)
    edge_triangles = np.full((len(keys), 2), -1, dtype=np.int32)
    opposite = np.full((len(keys), 2), -1, dtype=np.int32)
    order = np.argsort(inverse, kind="stable")
    group = inverse[order]
    slot = np.concatenate([[0], (group[1:] == group[:-1]).astype(np.int64)])
    edge_triangles[group, slot] = owner[order]
    opposite[group, slot] = facing[order]
    return edges, edge_triangles, opposite


def triangle_areas(rest: Array, triangles: IntArray) -> Array:
    """Signed areas (T,) [m^2] in rest coordinates, positive for counter-clockwise triangles."""
    a, b, c = (rest[triangles[:, i]] for i in range(3))
    return np.asarray(0.5 * ((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])))


def _hinge_weights(rest: Array, hinges: IntArray) -> Array:
    """Cotangent weights K of the isometric bending energy 3/(2A) |sum K_i x_i|^2 (Bergou et al. 2006, quadratic bending)."""
    x0, x1, x2, x3 = (rest[hinges[:, i]] for i in range(4))

    def cotangent(at: Array, p: Array, q: Array) -> Array:
        u, v = p - at, q - at
        cross = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        return np.asarray((u * v).sum(axis=1) / np.maximum(cross, 1e-12))

    c01, c02 = cotangent(x0, x1, x2), cotangent(x0, x1, x3)
    c03, c04 = cotangent(x1, x0, x2), cotangent(x1, x0, x3)
    return np.column_stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04])


def components(count: int, pairs: IntArray) -> NDArray[np.int64]:
    """Union-find: the component (count,) of each of `count` items joined by `pairs` (P, 2)."""
    parent = np.arange(count)
    for a, b in np.asarray(pairs).tolist():
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a != b:
            parent[max(a, b)] = min(a, b)
    for i in range(count):
        parent[i] = parent[parent[i]]
    return parent
