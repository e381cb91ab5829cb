"""Begin to follow the approved goal on the image."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import TRACKING
from behaviours.run_skill import RunSkill
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import Lease
from skills.skill import Steps
from skills.tracking.outcome import TrackOutcome


class StartTracking(RunSkill[TrackOutcome]):
    """SUCCESS when the goal is followed from now on; that happens once in a session."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, writes=(TRACKING,))

    def skill(self, lease: Lease | None) -> Steps[TrackOutcome]:
        """Start on the goal that the operator drew."""
        return self.services.skills.start_tracking(self.services.goal)

    def judge(self, outcome: TrackOutcome) -> Status:
        """Remember that the goal is followed."""
        if outcome.code is Code.OK:
            self.board.set(TRACKING, True)
        return super().judge(outcome)
