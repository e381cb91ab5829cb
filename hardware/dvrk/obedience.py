"""Whether an arm does what it is told, and so when it may be commanded again after a motion that failed by its own rule.

What was swallowed leaves no trace: the robot says that it is ready, and nothing it publishes would show when it obeys again. That ends
the session, for only another command could tell. Any other failure stands until the arm has been quiet for a while: not busy, setpoint
where it was sent, measured beside it, jaw likewise, and nobody else's motion. The second failure in a row of the same part, tip or jaw,
ends the session too: what fails again is not tried a third time.
"""

from __future__ import annotations

import math
from enum import StrEnum

from hardware.codes import Code
from hardware.dvrk.preconditions import FINE
from hardware.verdicts import Verdict

QUIET = 1.0  # [s]


class Part(StrEnum):
    """What is to obey."""

    SETPOINT = "setpoint"  # which is to follow what is sent
    TIP = "tip"  # which is to arrive
    JAW = "jaw"


class Obedience:
    """`failed` and `obeyed` tell how motions end; `verdict` says whether the arm may be commanded."""

    def __init__(self) -> None:
        self._failures = dict.fromkeys(Part, 0)
        self._standing: Verdict | None = None
        self._quiet_since = math.inf

    def failed(self, part: Part, code: Code, message: str, swallowed: bool = False) -> None:
        """A motion of `part` failed with `code`; `swallowed`: the robot took no notice of its command."""
        self._failures[part] += 1
        self._quiet_since = math.inf
        if swallowed:
            self._standing = Verdict(False, True, Code.NOT_OBEYED, message)
        elif self._failures[part] > 1:
            self._standing = Verdict(False, True, Code.NOT_OBEYED, f"for the second time in a row: {message}")
        else:
            self._standing = Verdict(False, False, code, message)

    def obeyed(self, part: Part) -> None:
        """A motion of `part` was done."""
        self._failures[part] = 0

    def verdict(self, unrest: str, now: float) -> Verdict:
        """The failure that stands; `unrest` says why the arm is not quiet at `now` [s], "" when it is."""
        if self._standing is None:
            return FINE
        if unrest:
            self._quiet_since = math.inf
            message = f"{self._standing.message}; {unrest}"
            return Verdict(False, self._standing.latched, self._standing.code, message)
        self._quiet_since = min(self._quiet_since, now)
        if not self._standing.latched and now - self._quiet_since >= QUIET:
            self._standing = None
            return FINE
        return self._standing
