"""What an arm's force estimate tells with nothing in its jaws: found while a session begins, and taken off from then on.

The dVRK tells a force by motor currents alone (`body/measured_cf`), with weight, friction and the cables' tension in it (reference 1.2).
What of it stays the same, mostly weight, would count as tension of tissue, or hide some. It is taken before the first motion of a
session, when the arm was still for a moment with its jaws so far open that they hold nothing. Neither friction, which turns with the
motion, nor a weight that changes with the wrist is helped by it.
"""

from __future__ import annotations

import math

import numpy as np

from hardware.codes import Code
from hardware.dvrk.preconditions import FINE
from hardware.interface import Array, Pose, Stamped
from hardware.verdicts import Verdict

OPEN = 0.3  # [rad] of full opening, from which jaws hold nothing
SPAN = 0.3  # [s] of stillness
LEAST = 10  # readings in that time
STILL, STILL_JAW = 0.2e-3, 0.02  # [m], [rad]; less is noise of the encoders


class Tare:
    """`look` at each reading until the first motion, then `close`. Forces (3,) [N] and poses are in the left camera frame.

    `most` [N] is what an arm at rest may tell; an arm that tells more touches something, or its estimate is no good.
    """

    def __init__(self, called: str, most: float) -> None:
        self._called, self._most = called, most
        self._looking = True
        self._since, self._tip, self._jaw = math.inf, np.full(3, np.nan), math.nan
        self._forces: list[Array] = []
        self._taken_at = -math.inf  # stamp [s] of the last force
        self._too_much = 0.0  # [N]; 0: it was not
        self.at_rest: Array | None = None  # None: not taken

    def look(self, force: Stamped[Array], tip: Stamped[Pose], opening: float) -> None:
        """One reading of an arm that may move but was not told to: its `force`, its `tip`, and the full `opening` of its jaws [rad]."""
        if not self._looking or self.at_rest is not None or force.stamp <= self._taken_at:
            return
        self._taken_at = force.stamp
        if not (opening >= OPEN and np.isfinite(force.value).all() and tip.value.is_finite()):
            self._begin(math.inf, tip.value.position, opening)
            return
        moved = float(np.linalg.norm(tip.value.position - self._tip))
        if not (moved <= STILL and abs(opening - self._jaw) <= STILL_JAW):
            self._begin(force.stamp, tip.value.position, opening)
        self._forces.append(force.value)
        if force.stamp - self._since >= SPAN and len(self._forces) >= LEAST:
            found = np.median(self._forces, axis=0)
            size = float(np.linalg.norm(found))
            if size <= self._most:
                self.at_rest, self._too_much = found, 0.0
            else:  # look again: it may be freed
                self._too_much = size
                self._begin(force.stamp, tip.value.position, opening)

    def close(self) -> None:
        """The first motion begins: what was not found by now is not looked for any more."""
        self._looking = False

    def corrected(self, force: Array) -> Array:
        """`force` without what the arm tells at rest; as it is where that was not found."""
        return force if self.at_rest is None else force - self.at_rest

    def verdict(self) -> Verdict:
        """Whether what the arm tells at rest is little enough to be taken off."""
        if not self._too_much:
            return FINE
        said = f"{self._called} tells a force of {self._too_much:.1f} N at rest with its jaws open, more than {self._most:.1f} N"
        return Verdict(False, False, Code.ARM_NOT_READY, f"{said}: it touches something, or its estimate is of no use")

    # ------------------------------------------------------------ inside

    def _begin(self, at: float, tip: Array, opening: float) -> None:
        self._since, self._tip, self._jaw = at, tip, opening
        self._forces.clear()
