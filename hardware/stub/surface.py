"""Surfaces and tools as the renderer sees them: what the phantom and the arms hand to the camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Pose


@dataclass(frozen=True)
class Ligaments:
    """What joins the lips of cuts that went only part of the way through: below the blade's path, down to the sheet's underside.

    `ends` (S, 4) int32: the sheet's vertices on the left and on the right lip at a ligament's first end, then on the same lips farther
    along the cut (one vertex twice at its tip); left and right as seen by a camera that looks along the cut. `reach` (S,) float32: how
    far the ligament goes from its first end towards the second pair, 0 to 1. `depth` (S, 2) float32: the severed share of the thickness
    at either pair.
    """

    ends: NDArray[np.int32]
    reach: NDArray[np.float32]
    depth: NDArray[np.float32]

    @classmethod
    def none(cls) -> Ligaments:
        """Whole tissue, or cut through."""
        return cls(np.zeros((0, 4), np.int32), np.zeros(0, np.float32), np.zeros((0, 2), np.float32))


@dataclass(frozen=True)
class SheetSurface:
    """The tissue's mid-surface now.

    `positions` (V, 3) float32 [m], left camera frame; `rest` (V, 2) float32 [m], rest coordinates (origin at the sheet's
    middle); `triangles` (T, 3) int32, counter-clockwise seen from the side that faced the camera at rest; `revision` grows whenever
    `rest` or `triangles` change (a cut); `thickness` [m]; `ligaments` may change without a new revision (they tear).
    """

    positions: NDArray[np.float32]
    rest: NDArray[np.float32]
    triangles: NDArray[np.int32]
    revision: int
    thickness: float
    ligaments: Ligaments = field(default_factory=Ligaments.none)


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
