"""Follow the goal beside another behaviour. It never ends by itself: the parallel above stops it."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.run_skill import RunSkill
from hardware.codes import Code
from hardware.gate import Lease
from skills.skill import Steps


class Track(RunSkill[None]):
    """RUNNING always; FAILURE when tracking breaks, since what runs beside it would work on an old picture."""

    def skill(self, lease: Lease | None) -> Steps[None]:
        """Look at each new frame when due."""
        return self.services.skills.track()

    def judge(self, outcome: None) -> Status:
        """Tracking that ends is a fault."""
        return self.fail(Code.INTERNAL_ERROR, "tracking ended by itself")
