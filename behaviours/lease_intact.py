"""Guard: a running skill still has its lease. The safety gate takes it away between ticks when data are lost or an arm drops out.

Such a moment may be over before the next tick, so that no other guard sees it; the skill was stopped all the same, and the
procedure is interrupted like by any guard.
"""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import LEASES
from behaviours.leaf import Leaf
from behaviours.services import Services


class LeaseIntact(Leaf):
    """SUCCESS when no skill runs or its lease is alive; RUNNING when the gate has ended it."""

    WATCHES = True

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=LEASES)

    def advance(self) -> Status:
        """Compare what the leaves hold with what the gate says."""
        if self.gate.lease is None and any(self.board.get(key) for key in LEASES):
            return self.wait("holding: the safety gate took the arms away from a running skill")
        self.feedback_message = "ok"
        return Status.SUCCESS
