"""What a list of triangles says by itself: which edges they share, which pieces hang together, what they cover in the picture."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.segments import cross

Triangles = NDArray[np.int32]


def mesh_of(vertices: Array, triangles: Triangles) -> trimesh.Trimesh:
    """Give `vertices` (V, 3) and `triangles` (F, 3) to trimesh as they are: nothing merged, nothing turned around."""
    return trimesh.Trimesh(vertices, triangles, process=False, validate=False)


def edges_of(triangles: Triangles, shared_by: int) -> NDArray[np.int64]:
    """Edges (E, 2), smaller index first, that just `shared_by` of the `triangles` (F, 3) have."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    if not len(edges):
        return edges
    most = int(edges.max()) + 1
    key, count = np.unique(edges @ [most, 1], return_counts=True)
    return np.column_stack(np.divmod(key[count == shared_by], most))


def piece_with(wanted: NDArray[np.bool_], triangles: Triangles) -> Triangles:
    """Of the pieces of `triangles` (F, 3) that hang together by edges, give the one with most of the `wanted` (V,) vertices."""
    if not len(triangles):
        return triangles
    adjacent = mesh_of(np.zeros((len(wanted), 3)), triangles).face_adjacency
    label = trimesh.graph.connected_component_labels(adjacent, node_count=len(triangles))
    held = np.zeros((int(label.max()) + 1, len(wanted)), bool)
    held[label[:, None], triangles] = True
    return triangles[label == np.argmax((held & wanted).sum(axis=1))]


def turn(corners: Array) -> Array:
    """Twice the signed area (F,) [px^2] of triangles with `corners` (F, 3, 2) pixels: negative where they face the camera."""
    return cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def covers(corners: Array, pixel: Array) -> bool:
    """Whether `pixel` (2,) lies in any triangle that faces the camera, of those with `corners` (F, 3, 2) pixels."""
    edges = np.roll(corners, -1, axis=1) - corners
    return bool((cross(edges, pixel - corners) <= 1e-9).all(axis=1).any())
