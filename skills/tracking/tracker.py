"""What every tracker of points does, whatever it is made of: a goal tracker, an experiment or a benchmark asks no more than this."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Frame
from skills.tracking.tracks import Tracks


class PointTracker(Protocol):
    """Follows points on frames as they come; from one thread."""

    def start(
        self, frame: Frame, points: Array, groups: NDArray[np.int64] | None = None, tool_mask: NDArray[np.bool_] | None = None
    ) -> Tracks:
        """Follow `points` (N, 2) pixels from `frame` on; what was followed before is forgotten.

        Points of one group (N,) move together: the two sides of a cut are two groups. `tool_mask` (H, W) is where instruments hide
        the frame; a point there starts hidden.

        Raises:
            ValueError: the groups are not one for each point.
        """
        ...

    def update(self, frame: Frame, tool_mask: NDArray[np.bool_] | None = None) -> Tracks:
        """Follow the points into `frame`. A frame seen before changes nothing.

        Raises:
            RuntimeError: `start` was not called.
            ValueError: the frame is of another size.
        """
        ...

    def tracks(self) -> Tracks:
        """Give where the points were in the newest frame."""
        ...
