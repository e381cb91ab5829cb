"""The tracked pixels around the goal, P_td of the paper: a lattice in goal coordinates, fixed on the surface.

Rows run along the goal, columns across it. No row lies on the goal itself, where the cut leaves no tissue to follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.scene.polyline import arc_lengths, at_length, side_of
from skills.scene.segments import distances
from skills.scene.surface import Surface
from skills.tracking.model_based import SurfacePoints, raycast, track

CROSSED = 0.8  # a pixel nearer to the goal than this share of its lateral belongs to another part of a bent goal


@dataclass(frozen=True)
class RegionConfig:
    """Size of the lattice. Lengths [m], at the depth of the goal."""

    band: float = 5e-3  # reach to either side of the goal
    rows: int = 8  # even; at half offsets, so that none lies on the goal
    column_spacing: float = 1.5e-3  # along the goal
    exclusion: float = 4e-3  # round the grasp, where the rigid patch shears the tissue and would swamp the losses

    def __post_init__(self) -> None:
        if self.rows < 2 or self.rows % 2:
            raise ValueError(f"rows must be an even number of at least 2, not {self.rows}")
        if not (self.band > 0 and self.column_spacing > 0 and self.exclusion >= 0):
            raise ValueError("band and column_spacing must be positive, and exclusion not negative")


@dataclass(frozen=True)
class Region:
    """A lattice of N = rows * columns pixels around the goal at t_d, row-major, followed on the surface.

    `points` (N,) on the surface; `pixels` (N, 2) where they were at t_d; `shape` (rows, columns); `lateral` (rows,) [px] across the
    goal, increasing from the far to the near (grasp) side, never 0; `station` (columns,) [px] along it; `origin` (columns, 2) [px]
    on it. `normal` and `tangent` (columns, 2) are the unit vectors n, towards the grasp's side, and m, along the goal. `spacing`
    (across, along) [px]. `used` (rows, columns) bool: on the mesh, in the image, not too near to the grasp.
    """

    points: SurfacePoints
    pixels: Array
    shape: tuple[int, int]
    lateral: Array
    station: Array
    origin: Array
    normal: Array
    tangent: Array
    spacing: tuple[float, float]
    used: NDArray[np.bool_]


def region_around(
    polyline: Array, grasp: Array, surface: Surface, camera: CameraModel, config: RegionConfig | None = None
) -> Region:
    """Lay the lattice around the goal `polyline` (M, 2) pixels, whose near side is the one of the `grasp` (3,) [m].

    Raises:
        ValueError: the polyline has no length, or it, the grasp or the surface is malformed.
    """
    config = config or RegionConfig()
    polyline, grasp = np.asarray(polyline, np.float64), np.asarray(grasp, np.float64)
    if polyline.ndim != 2 or polyline.shape[1] != 2 or len(polyline) < 2 or not np.isfinite(polyline).all():
        raise ValueError(f"the goal must be (M, 2) finite pixels with M >= 2, not {polyline.shape}")
    if grasp.shape != (3,) or not (np.isfinite(grasp).all() and grasp[2] > 0):
        raise ValueError(f"the grasp must be a point before the camera (3,) [m], not {grasp}")
    length = float(arc_lengths(polyline)[-1])
    if not length > 0:
        raise ValueError("the goal has no length")
    scale = camera.focal / _goal_depth(surface)  # [px/m]

    rows, columns = config.rows, max(2, round(length / (config.column_spacing * scale)))
    across, along = 2 * config.band * scale / rows, length / columns
    lateral = (np.arange(rows, dtype=np.float64) - (rows - 1) / 2) * across
    station = (np.arange(columns, dtype=np.float64) + 0.5) * along
    origin = at_length(polyline, station)
    chord = at_length(polyline, station + along / 2) - at_length(polyline, station - along / 2)
    reach = np.linalg.norm(chord, axis=1, keepdims=True)
    if not reach.min() > 1e-6 * along:
        raise ValueError("the goal folds back on itself")
    tangent = chord / reach
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) * side_of(polyline, camera.project(grasp))
    pixels = (origin[None] + lateral[:, None, None] * normal[None]).reshape(-1, 2)

    points = raycast(pixels, surface.vertices, surface.triangles, camera)
    places = track(points, surface.vertices, surface.triangles)
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    beside = distances(pixels, np.stack([polyline[:-1], polyline[1:]], axis=1)).min(axis=1) > CROSSED * np.repeat(
        np.abs(lateral), columns
    )
    clear = np.linalg.norm(places - grasp, axis=1) > config.exclusion  # False off the mesh, where places are nan
    used = points.on_mesh & inside & beside & clear
    return Region(
        points=points,
        pixels=pixels,
        shape=(rows, columns),
        lateral=lateral,
        station=station,
        origin=origin,
        normal=normal,
        tangent=tangent,
        spacing=(across, along),
        used=used.reshape(rows, columns),
    )


def _goal_depth(surface: Surface) -> float:
    """Median depth [m] of the surface's vertices on the goal's line, within the goal."""
    on_goal = (surface.lateral == 0) & (surface.station >= 0) & (surface.station <= surface.goal_length)
    if not on_goal.any():
        raise ValueError("the surface has no vertex on the goal")
    depth = float(np.median(surface.vertices[on_goal, 2]))
    if not depth > 0:
        raise ValueError(f"the goal must lie before the camera, not at a depth of {depth} m")
    return depth
