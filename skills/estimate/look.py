"""What was seen of the keypoint grid at one moment of a pull."""

from dataclasses import dataclass

from hardware.interface import Array
from skills.tracking.tracks import Tracks


@dataclass(frozen=True)
class Look:
    """After `step` steps of the pull: the keypoints, and what opened along each edge so far, (E,) [px].

    `parted` is the widest opening, `bed` the widest that showed the bed (`GapWatch`); nan where it could not be looked for.
    """

    step: int
    tracks: Tracks
    parted: Array
    bed: Array
