"""The connectivity graph: keypoints, edges between neighbours, which are severed (paper, Sec. Tissue Connectivity Estimation)."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array


class EdgeState(IntEnum):
    """State of one edge. `UNKNOWN` is never treated as severed."""

    CONNECTED = 0
    SEVERED = 1
    UNKNOWN = 2


@dataclass(frozen=True)
class ConnectivityGraph:
    """Keypoints and edges at the end of exposure, t_e.

    `reference` and `points` (N, 2) pixels at t_d and t_e; `edges` (E, 2) int indices; `elongation` (E,) the ratio rho (nan if
    unknown); `state` (E,) of EdgeState; `probability` (E,) that the edge is severed; `crosses_goal` (E,) bool; `station` (E,)
    position along the goal 0..1 of edges that cross it (nan elsewhere); `goal_length` [m] of the goal at t_d, None where too little
    depth was seen.
    """

    code: Code
    message: str
    reference: Array
    points: Array
    edges: NDArray[np.int64]
    elongation: Array
    state: NDArray[np.int64]
    probability: Array
    crosses_goal: NDArray[np.bool_]
    station: Array
    goal_length: float | None = None

    @property
    def uncut(self) -> NDArray[np.bool_]:
        """(E,) bool: edges that cross the goal and are not known to be severed (E^uncut of the paper, unknown included)."""
        return self.crosses_goal & (self.state != EdgeState.SEVERED)

    @property
    def complete(self) -> bool:
        """Whether no connected and no unknown edge crosses the goal."""
        return self.code is Code.OK and bool(self.crosses_goal.any()) and not self.uncut.any()
