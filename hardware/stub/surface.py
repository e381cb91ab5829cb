"""Surfaces and tools as the renderer sees them: what the phantom and the arms hand to the camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Pose


@dataclass(frozen=True)
class SheetSurface:
    """The tissue's mid-surface now.

    `positions` (V, 3) float32 [m], left camera frame; `rest` (V, 2) float32 [m], rest coordinates (origin at the sheet's
    middle); `triangles` (T, 3) int32, counter-clockwise seen from the side that faced the camera at rest; `revision` grows whenever
    `rest` or `triangles` change (a cut); `thickness` [m].
    """

    positions: NDArray[np.float32]
    rest: NDArray[np.float32]
    triangles: NDArray[np.int32]
    revision: int
    thickness: float


@dataclass(frozen=True)
class BaseSurface:
    """The rigid bed under the tissue.

    `positions` (V, 3) float32 [m], left camera frame; `triangles` (T, 3) int32; `texture` (V, 2) float32 [m].
    """

    positions: NDArray[np.float32]
    triangles: NDArray[np.int32]
    texture: NDArray[np.float32]


@dataclass(frozen=True)
class ToolShape:
    """An instrument: `kind` is `grasper` or `scissors`; `pose` of its tip (true, not measured); `jaw` full opening [rad]."""

    kind: str
    pose: Pose
    jaw: float
