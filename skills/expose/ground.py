"""What the jaws must not be pressed into: the tissue as it was seen at t_d, and the bed right under it.

The model's floor lies below the lowest vertex of a surface that is curved and noisy. It keeps free tissue out of the bed, but leaves
millimetres under the jaws, whose vertices no constraint moves.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from hardware.interface import Array
from skills.scene.surface import Surface
from skills.scene.triangles import mesh_of


class Ground:
    """The surface at t_d as the tangent planes of its vertices."""

    def __init__(self, surface: Surface) -> None:
        self._vertices = surface.vertices
        self._normals = np.array(mesh_of(surface.vertices, surface.triangles).vertex_normals)
        self._tree = KDTree(surface.vertices)

    def height(self, points: Array) -> Array:
        """Height (...) [m] of `points` (..., 3) [m], left camera frame, over the plane of the nearest vertex: negative below it."""
        _, nearest = self._tree.query(points)
        return np.asarray(((points - self._vertices[nearest]) * self._normals[nearest]).sum(axis=-1))
