"""How much the tissue beside the goal is stretched, in space: edges of the keypoint grid, lifted by stereo, against what they were at t_d.

On poor texture one keypoint in ten is mistracked by more than an edge's length, and what the edges then show is that, not strain: each
row of the grid is made smooth first, wrong points put aside. Depth at single keypoints is as noisy as an edge is long, so each side of the
goal is lifted by one smooth surface through all its keypoints. What is left is what turning to the camera or coming nearer cannot fake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.estimate.grid import Grid, lengths
from skills.scene.stereo import DepthMap, depth_at
from skills.tracking.rows import RowConfig, smooth_row


@dataclass(frozen=True)
class StrainConfig:
    """Which keypoints count, and the surface through them."""

    period: float = 0.3  # [s] between looks
    patience: float = 1.0  # [s] without a usable look after which the strain is unknown
    min_confidence: float = 0.5
    min_edges: int = 8  # fewer, along the goal or across it, say nothing
    percentile: float = 90.0  # not the largest: single edges are noisy, and must not stop a pull
    rows: RowConfig = field(default_factory=RowConfig)
    degree: int = 3  # of the surface of either side
    radius: int = 5  # [px] that a depth is read from
    margin: float = 20.0  # [px] around the keypoints that is matched in stereo


class StrainGauge:
    """Made at t_d; `read` gives the strain since then."""

    def __init__(self, grid: Grid, depth: DepthMap, camera: CameraModel, config: StrainConfig | None = None) -> None:
        self._grid = grid
        self._camera = camera
        self._config = config or StrainConfig()
        everyone = np.ones(len(grid.points), dtype=bool)
        self._rest = lengths(self._lifted(grid.points, everyone, depth), grid.edges)

    def read(self, points: Array, visible: NDArray[np.bool_], confidence: Array, depth: DepthMap) -> float:
        """The 90th percentile of the lengthening of well seen edges that do not cross the goal; nan if too few are seen."""
        c, grid = self._config, self._grid
        points, sure = self._smoothed(points, visible & (confidence >= c.min_confidence), confidence)
        now = lengths(self._lifted(points, sure, depth), grid.edges)
        use = ~grid.crosses_goal & sure[grid.edges].all(axis=1) & np.isfinite(now) & np.isfinite(self._rest)
        # Edges along the goal alone would not know of a stretch across it, and the other way round.
        along = np.diff(grid.edges, axis=1)[:, 0] == 1
        if min((use & along).sum(), (use & ~along).sum()) < c.min_edges:
            return float("nan")
        return float(np.percentile(now[use] / self._rest[use] - 1.0, c.percentile))

    def _smoothed(self, points: Array, sure: NDArray[np.bool_], confidence: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Keypoints (N, 2) made smooth row by row along the goal, and which (N,) were seen and right."""
        columns = int(self._grid.crosses_goal.sum())
        smooth, good = points.copy(), np.zeros(len(points), dtype=bool)
        for first in range(0, len(points), columns):
            row = slice(first, first + columns)
            smooth[row], good[row] = smooth_row(
                self._grid.points[row], points[row], sure[row], confidence[row], self._config.rows
            )
        return smooth, good

    def _lifted(self, points: Array, sure: NDArray[np.bool_], depth: DepthMap) -> Array:
        """Keypoints (N, 3) [m] on the smooth surface of their side; nan where that is not known."""
        lifted = np.full((len(points), 3), np.nan)
        z = depth_at(depth, points, self._config.radius)
        for side in (self._grid.near_side, ~self._grid.near_side):
            known = side & sure & np.isfinite(z)
            surface = _smooth(points[known], 1.0 / z[known], self._config.degree)
            if surface is None:
                continue
            # Only where depth was seen: beyond it a polynomial runs away.
            lifted[known] = self._camera.unproject(points[known], 1.0 / surface(points[known]))
        return lifted


def _smooth(pixels: Array, inverse: Array, degree: int) -> Callable[[Array], Array] | None:
    """A polynomial surface through inverse depths (linear in them a plane is a plane), robust; None with too few points."""
    while degree > 1 and len(pixels) < (degree + 1) * (degree + 2):
        degree -= 1
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    if len(pixels) < 2 * len(powers):
        return None
    centre, scale = pixels.mean(axis=0), np.maximum(np.ptp(pixels, axis=0) / 2.0, 1.0)

    def terms(at: Array) -> Array:
        u, v = ((at - centre) / scale).T
        return np.column_stack([u**i * v**j for i, j in powers])

    matrix, weights = terms(pixels), np.ones(len(pixels))
    coefficients: Array = np.zeros(len(powers))
    for _ in range(4):
        coefficients = np.asarray(np.linalg.lstsq(matrix * weights[:, None], inverse * weights, rcond=None)[0])
        residual = np.abs(inverse - matrix @ coefficients)
        weights = 1.0 / (1.0 + (residual / (3.0 * max(float(np.median(residual)), 1e-3))) ** 2)
    return lambda at: np.asarray(np.maximum(terms(at) @ coefficients, 1e-3))
