"""What was seen of the keypoint grid at one moment of a pull."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.tracking.tracks import Tracks


@dataclass(frozen=True)
class Look:
    """After `step` steps of the pull: the keypoints, and what opened along each edge so far, (E,) [px].

    `placed` (N,) are the keypoints whose place is known, seen or not. `parted` is the widest opening since t_d, `bed` the widest that
    showed the bed, `slit` the widest since the goal was drawn (`GapWatch`); nan where it could not be looked for. `stranded` (E,) are
    edges beside a strand that is there now.
    """

    step: int
    tracks: Tracks
    placed: NDArray[np.bool_]
    parted: Array
    bed: Array
    slit: Array
    stranded: NDArray[np.bool_]
