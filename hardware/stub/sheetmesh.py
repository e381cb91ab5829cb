"""Triangulates the tissue sheet at rest: fine in a band around the goal, coarser away from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from hardware.interface import Array


@dataclass(frozen=True)
class MeshSpacing:
    """Edge lengths [m] near the goal and far from it, and the half width [m] of the fine band."""

    fine: float = 0.8e-3
    coarse: float = 2.4e-3
    band: float = 5.0e-3


def triangulate(width: float, height: float, line: Array, spacing: MeshSpacing) -> tuple[Array, NDArray[np.int32]]:
    """Points (V, 2) [m] and counter-clockwise triangles (T, 3) of a `width` x `height` sheet centred on the origin.

    The density follows the distance to `line` (M, 2) [m]: lattices of growing spacing, each kept in its own ring, smoothed so that
    the rings meet without slivers. Equal input gives an equal mesh.
    """
    rings = _ring_spacings(spacing)
    half = np.array([width, height]) / 2
    kept: list[Array] = [_border(half, spacing.coarse)]
    fixed = len(kept[0])
    inner = 0.0
    for step, outer in rings:
        points = _hexagonal(half - 0.6 * spacing.coarse, step)
        distance = distance_to_line(points, line)
        kept.append(points[(distance >= inner) & (distance < outer)])
        inner = outer + 0.45 * step
    points = np.concatenate(kept)
    for _ in range(4):
        points = _smoothed(points, _delaunay(points), fixed)
    return points, _delaunay(points)


def distance_to_line(points: Array, line: Array) -> Array:
    """Distance (N,) of `points` (N, 2) to the polyline `line` (M, 2)."""
    a, b = line[:-1], line[1:]
    along = b - a
    relative = points[:, None, :] - a[None]
    t = np.clip((relative * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-18), 0.0, 1.0)
    gaps = np.linalg.norm(relative - t[..., None] * along, axis=-1)
    return np.asarray(gaps.min(axis=1))


def _ring_spacings(spacing: MeshSpacing) -> list[tuple[float, float]]:
    """(edge length, outer distance) of each ring; the spacing grows by at most 1.5 from ring to ring."""
    rings = [(spacing.fine, spacing.band)]
    step, outer = spacing.fine, spacing.band
    while step * 1.5 < spacing.coarse:
        step *= 1.5
        outer += 2.5 * step
        rings.append((step, outer))
    rings.append((max(spacing.coarse, spacing.fine), np.inf))
    return rings


def _hexagonal(half: Array, step: float) -> Array:
    """A hexagonal lattice inside +-half, mirror-symmetric in both axes."""
    rows = int(half[1] / (step * np.sqrt(0.75)))
    columns = int(half[0] / step) + 1
    points = []
    for j in range(-rows, rows + 1):
        shift = 0.5 if j % 2 else 0.0
        u = (np.arange(-columns, columns + 1) + shift) * step
        u = u[np.abs(u) <= half[0]]
        points.append(np.column_stack([u, np.full(len(u), j * step * np.sqrt(0.75))]))
    return np.concatenate(points)


def _border(half: Array, step: float) -> Array:
    """Points along the sheet's outline, corners included."""
    nu, nv = round(2 * half[0] / step), round(2 * half[1] / step)
    u = np.linspace(-half[0], half[0], nu + 1)
    v = np.linspace(-half[1], half[1], nv + 1)[1:-1]
    return np.concatenate(
        [
            np.column_stack([u, np.full_like(u, -half[1])]),
            np.column_stack([u, np.full_like(u, half[1])]),
            np.column_stack([np.full_like(v, -half[0]), v]),
            np.column_stack([np.full_like(v, half[0]), v]),
        ]
    )


def _delaunay(points: Array) -> NDArray[np.int32]:
    triangles = Delaunay(points).simplices.astype(np.int32)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    return triangles[np.abs(area) > 1e-12]


def _smoothed(points: Array, triangles: NDArray[np.int32], fixed: int) -> Array:
    """One step of Laplacian smoothing of all points but the first `fixed`."""
    total = np.zeros_like(points)
    count = np.zeros(len(points))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        np.add.at(total, triangles[:, i], points[triangles[:, j]])
        np.add.at(count, triangles[:, i], 1.0)
        np.add.at(total, triangles[:, j], points[triangles[:, i]])
        np.add.at(count, triangles[:, j], 1.0)
    smoothed = points.copy()
    smoothed[fixed:] = 0.5 * points[fixed:] + 0.5 * (total / count[:, None])[fixed:]
    return smoothed
