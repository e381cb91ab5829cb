"""The model-based tracker: pixels fixed on the surface mesh once, then followed as the mesh deforms (paper, Eq. model-based tracking).

    p_hat_i             = raycast(p_i, x_i, M, C)
    k, alpha, beta, gamma = barycentric(p_hat_i, x_i, M)
    p_hat_j             = track(x_j, k, alpha, beta, gamma)
    p_j                 = project(p_hat_j, C)

The first two lines are `raycast` here, done once per observation; `track` and `model_tracked_pixels` are done for every predicted
state. A pixel that meets no triangle, or meets one from behind, is off the mesh: triangle -1, and nan wherever it is followed to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel

wp.set_module_options({"enable_backward": False})

FAR = 10.0  # [m] beyond this no ray is followed
LEAST_DEPTH = 1e-4  # [m] a tracked point nearer than this, or behind the camera, has no pixel


@dataclass(frozen=True)
class SurfacePoints:
    """Points fixed on a mesh: `triangle` (N,) int32 index k, -1 off the mesh; `barycentric` (N, 3) float64 (alpha, beta, gamma).

    Barycentric coordinates are not negative and sum to one; off the mesh they are nan.
    """

    triangle: NDArray[np.int32]
    barycentric: Array

    @property
    def on_mesh(self) -> NDArray[np.bool_]:
        """Which points (N,) lie on the mesh."""
        return np.asarray(self.triangle >= 0)


@wp.kernel
def _nearest_hit(mesh: wp.uint64, rays: wp.array(dtype=wp.vec3), far: float, face: wp.array(dtype=wp.int32)):  # type: ignore
    """One thread per ray from the camera's centre: the triangle that it meets first, -1 for none."""
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, wp.vec3(0.0, 0.0, 0.0), rays[i], far)
    if query.result:  # type: ignore[attr-defined]
        face[i] = query.face  # type: ignore[attr-defined]


def raycast(pixels: Array, vertices: Array, triangles: NDArray[np.int32], camera: CameraModel) -> SurfacePoints:
    """Find the nearest triangle behind each of `pixels` (N, 2), and where on it.

    `vertices` (V, 3) float64 [m], left camera frame; `triangles` (F, 3), wound so that normals face the camera. A pixel that is
    not finite is off the mesh. Warp finds the triangle in float32; the place on it is solved in float64.

    Raises:
        ValueError: an array is not of the shape said here, or a vertex is not finite.
    """
    pixels, vertices, triangles = np.asarray(pixels, np.float64), np.asarray(vertices, np.float64), np.asarray(triangles)
    if pixels.ndim != 2 or pixels.shape[1] != 2:
        raise ValueError(f"pixels must be (N, 2), not {pixels.shape}")
    _check_mesh(vertices, triangles)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=1))
    rays = camera.unproject(np.where(finite[:, None], pixels, 0.0), np.ones(len(pixels)))
    face = np.full(len(pixels), -1, np.int32)
    if len(triangles) and len(pixels):
        points: wp.array = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
        mesh = wp.Mesh(points, wp.array(triangles.astype(np.int32).ravel(), dtype=wp.int32, device="cpu"))
        directions: wp.array = wp.array(
            (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32), dtype=wp.vec3, device="cpu"
        )
        found = wp.full(len(pixels), -1, dtype=wp.int32, device="cpu")
        wp.launch(_nearest_hit, dim=len(pixels), inputs=[mesh.id, directions, FAR], outputs=[found], device="cpu")
        face = np.where(finite, found.numpy(), -1).astype(np.int32)
    return _placed(face, rays, vertices, triangles)


def track(points: SurfacePoints, positions: Array, triangles: NDArray[np.int32]) -> Array:
    """Where `points` are when the mesh's vertices are at `positions` (..., V, 3) [m]: (..., N, 3); nan off the mesh.

    Raises:
        ValueError: `positions` does not end in (V, 3), or has fewer vertices than the points' triangles name.
    """
    positions = np.asarray(positions, np.float64)
    if positions.ndim < 2 or positions.shape[-1] != 3:
        raise ValueError(f"positions must end in (V, 3), not {positions.shape}")
    on = points.on_mesh
    corners = np.asarray(triangles)[points.triangle[on]]
    if corners.size and corners.max() >= positions.shape[-2]:
        raise ValueError(f"the points' triangles name vertex {corners.max()}, but there are only {positions.shape[-2]} vertices")
    tracked = np.full((*positions.shape[:-2], len(on), 3), np.nan)
    weights = points.barycentric[on]
    tracked[..., on, :] = sum(weights[:, k, None] * positions[..., corners[:, k], :] for k in range(3))
    return tracked


def model_tracked_pixels(points: SurfacePoints, positions: Array, triangles: NDArray[np.int32], camera: CameraModel) -> Array:
    """Pixels (..., N, 2) of `points` when the mesh is at `positions` (..., V, 3) [m]: the tracker mbt-Q of the paper.

    nan off the mesh and where a point has come to lie behind the camera. Pixels outside the image are given as they are.
    """
    tracked = track(points, positions, triangles)
    visible = tracked[..., 2:] > LEAST_DEPTH
    return np.where(visible, camera.project(np.where(visible, tracked, 1.0)), np.nan)


def _placed(face: NDArray[np.int32], rays: Array, vertices: Array, triangles: NDArray[np.int32]) -> SurfacePoints:
    """Barycentric coordinates of the `rays` (N, 3) on their triangles `face` (N,), those met from behind taken off.

    The camera is the origin, so a ray r = a v0 + b v1 + c v2 has (a, b, c) proportional to its barycentric coordinates.
    """
    hit = np.flatnonzero(face >= 0)
    v0, v1, v2 = (vertices[triangles[face[hit], k]] for k in range(3))
    r = rays[hit]
    volume = (v0 * np.cross(v1, v2)).sum(1)  # negative where the normal faces the camera
    weights = np.column_stack([(r * np.cross(v1, v2)).sum(1), (r * np.cross(v2, v0)).sum(1), (r * np.cross(v0, v1)).sum(1)])
    # Rounding in the search may take a ray just past an edge; it is put back on it.
    weights = np.maximum(weights * np.sign(volume)[:, None], 0.0)
    total = weights.sum(1, keepdims=True)
    good = (volume < 0) & (total[:, 0] > 0)
    triangle = np.full(len(face), -1, np.int32)
    barycentric = np.full((len(face), 3), np.nan)
    triangle[hit[good]] = face[hit[good]]
    barycentric[hit[good]] = weights[good] / total[good]
    return SurfacePoints(triangle, barycentric)


def _check_mesh(vertices: Array, triangles: NDArray[np.int32]) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices must be (V, 3) finite numbers, not {vertices.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or not np.issubdtype(triangles.dtype, np.integer):
        raise ValueError(f"triangles must be (F, 3) indices, not {triangles.shape} of {triangles.dtype}")
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise ValueError(f"triangles must name vertices 0 to {len(vertices) - 1}")
