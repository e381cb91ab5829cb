"""Whether there is an attempt left for which a plan is worth making."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ATTEMPT, ESTIMATE
from behaviours.complete import what_is_left
from behaviours.leaf import Leaf
from behaviours.services import Services
from hardware.codes import Code


class AttemptsLeft(Leaf):
    """SUCCESS while attempts are left; FAILURE with ATTEMPTS_USED."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(ATTEMPT, ESTIMATE))

    def advance(self) -> Status:
        """Count."""
        used, limit = self.board.get(ATTEMPT).number, self.services.max_attempts
        if used < limit:
            return self.succeed(f"{limit - used} of {limit} attempts left")
        return self.fail(Code.ATTEMPTS_USED, f"all {limit} attempts are used and {what_is_left(self.board.get(ESTIMATE))}")
