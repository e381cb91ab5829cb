"""Where the goal's and the grid's points are now in the left image, whether they are seen, and how sure the tracker is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array


@dataclass(frozen=True)
class Tracks:
    """`points` (N, 2) float64 pixels, `visible` (N,) bool, `confidence` (N,) 0..1, of the frame taken at `stamp` [s]."""

    stamp: float
    points: Array
    visible: NDArray[np.bool_]
    confidence: Array


@dataclass(frozen=True)
class TrackedGoal:
    """The goal on the image now.

    The goal's own line lies in the cut, where no texture is; so two rows of points, a few pixels to either side of it, are
    tracked and the goal is their mid-line. `polyline`, `near`, `far` are (M, 2) pixels (`near` on the grasp's side), `visible`
    (M,) bool where both rows are seen, `grasp` (2,) pixel. `lost` when too little of the goal is seen to go on.
    `strain` is that of the tissue beside the goal as a `StrainGauge` read it (nan where none did).
    """

    stamp: float
    polyline: Array
    near: Array
    far: Array
    visible: NDArray[np.bool_]
    grasp: Array
    grasp_visible: bool
    lost: bool
    strain: float
