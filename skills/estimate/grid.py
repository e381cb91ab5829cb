"""The keypoint grid around the tracked goal and its edges (paper, Sec. Tissue Connectivity Estimation).

Stations run along the goal, rows across it; no row lies on the goal line, where the cut leaves no tissue to follow. Rows are laid
out from the two lips of the cut, and moved outwards where no tissue is seen, so that an opening that is already there when the grid is
made holds no keypoints: one that follows the bed through the opening would say nothing about the tissue.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.polyline import arc_lengths, left_normals
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class GridConfig:
    """Spacing of the grid. All in pixels."""

    station_spacing: float = 8.0  # along the goal
    row_spacing: float = 14.0  # across it; rows at +-0.5, 1.5, 2.5 ... of this from the (closed) goal line
    rows_per_side: int = 3
    # Of the first and last station from the goal's ends, where a complete cut opens little: the tip of a cut of the goal's own length lay
    # right on edges 6 px from its ends, which nobody could tell to be severed. 9 px are 1.2 mm on the bench.
    end_inset: float = 9.0
    rim: int = 5  # from the border of an opening that a keypoint keeps: what is nearer shows bed in its patch
    farthest: int = 60  # that keypoints are moved outwards from an opening

    def __post_init__(self) -> None:
        if not (self.station_spacing > 0 and self.row_spacing > 0 and self.rows_per_side >= 1 and self.end_inset >= 0):
            raise ValueError("grid spacings must be positive, with at least one row per side and no negative inset")


@dataclass(frozen=True)
class Grid:
    """Keypoints and their edges at t_d.

    `points` (N, 2) pixels; `edges` (E, 2) indices; `crosses_goal` (E,) bool; `station` (E,) 0..1 along the goal of edges that
    cross it, nan elsewhere; `near_side` (N,) bool, True on the grasp's side. `spacing` is the distance between stations, 0..1.
    `closed_length` [px] is the length of an edge across the goal while the cut is closed: the spacing of the rows.
    """

    points: Array
    edges: NDArray[np.int64]
    crosses_goal: NDArray[np.bool_]
    station: Array
    near_side: NDArray[np.bool_]
    spacing: float
    closed_length: float


def grid_around(
    tracked: TrackedGoal, row_offset: float, config: GridConfig | None = None, tissue: NDArray[np.bool_] | None = None
) -> Grid:
    """Lay the grid around `tracked`, whose near and far rows follow tissue `row_offset` [px] away from the goal line.

    With `tissue` (H, W), where tissue is seen, no keypoint lies in an opening: the rows of its side begin beyond it at that station.
    """
    config = config or GridConfig()
    stations, spacing = _stations(tracked.polyline, config)
    offsets = (np.arange(config.rows_per_side) + 0.5) * config.row_spacing - row_offset
    count, rows = len(stations), 2 * config.rows_per_side
    # One field of normals for both sides: the mid-line is smoother than either lip.
    normals = left_normals(tracked.polyline)
    to_near = normals if ((tracked.near - tracked.far) * normals).sum() >= 0 else -normals
    outward = _at_stations(to_near, stations)
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    rim = np.ones((2 * config.rim + 1, 2 * config.rim + 1), np.uint8)
    solid = None if tissue is None else np.asarray(cv2.erode(tissue.astype(np.uint8), rim), dtype=np.uint8)
    blocks = []
    for row, away in ((tracked.near, outward), (tracked.far, -outward)):
        block = _at_stations(row, stations)[None] + offsets[:, None, None] * away[None]
        moved = 0.0 if solid is None else _to_tissue(block[0], away, solid, config.farthest)[None, :, None] * away[None]
        blocks.append(block + moved)
    # Rows in order across the goal: outermost near ... innermost near | innermost far ... outermost far.
    points = np.concatenate([blocks[0][::-1], blocks[1]]).reshape(-1, 2)
    index = np.arange(rows * count).reshape(rows, count)
    along = np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()])
    across = np.column_stack([index[:-1].ravel(), index[1:].ravel()])
    row_of, column_of = np.divmod(across[:, 0], count)
    crosses = np.concatenate([np.zeros(len(along), bool), row_of == config.rows_per_side - 1])
    station = np.concatenate([np.full(len(along), np.nan), stations[column_of]])
    return Grid(
        points=points,
        edges=np.concatenate([along, across]).astype(np.int64),
        crosses_goal=crosses,
        station=np.where(crosses, station, np.nan),
        near_side=np.repeat(np.arange(rows) < config.rows_per_side, count),
        spacing=spacing,
        closed_length=config.row_spacing,
    )


def lengths(points: Array, edges: NDArray[np.int64]) -> Array:
    """Length (E,) [px] of each edge between `points` (N, 2)."""
    return np.asarray(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))


def _stations(polyline: Array, config: GridConfig) -> tuple[Array, float]:
    """Stations 0..1 along the goal, evenly spaced between the insets, and their distance; at least two."""
    length = max(float(arc_lengths(polyline)[-1]), 1e-9)
    inset = min(config.end_inset / length, 0.25)
    count = max(2, round((1.0 - 2.0 * inset) * length / config.station_spacing) + 1)
    return np.linspace(inset, 1.0 - inset, count), (1.0 - 2.0 * inset) / (count - 1)


def _at_stations(row: Array, stations: Array) -> Array:
    """Read a tracked row (M, 2) at `stations` (S,), fractions of its index, which goes with the tissue: (S, 2)."""
    index = np.linspace(0.0, 1.0, len(row))
    return np.column_stack([np.interp(stations, index, row[:, k]) for k in (0, 1)])


def _to_tissue(points: Array, directions: Array, solid: NDArray[np.uint8], farthest: int) -> Array:
    """How far (S,) [px] to go from `points` (S, 2) along unit `directions` (S, 2) to come to tissue; 0 where there is none that near."""
    steps = np.arange(farthest + 1.0)
    at = np.rint(points[:, None] + steps[None, :, None] * directions[:, None]).astype(np.int64)
    height, width = solid.shape
    inside = ((at >= 0) & (at < (width, height))).all(axis=2)
    found = inside & (solid[np.clip(at[..., 1], 0, height - 1), np.clip(at[..., 0], 0, width - 1)] > 0)
    return np.where(found.any(axis=1), steps[np.argmax(found, axis=1)], 0.0)
