"""Before any motion, and again after each interruption: arms, camera, calibration, limits, disk."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import CHECKLIST_PASSED
from behaviours.run_skill import RunSkill
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import Lease
from skills.checklist_outcome import CheckOutcome
from skills.skill import Steps


class Checklist(RunSkill[CheckOutcome]):
    """SUCCESS when every item is as it must be. From then on the guards accept nothing less."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, writes=(CHECKLIST_PASSED,))

    def skill(self, lease: Lease | None) -> Steps[CheckOutcome]:
        """Run the checklist."""
        return self.services.skills.checklist()

    def judge(self, outcome: CheckOutcome) -> Status:
        """Record the items."""
        self.services.tell("checklist", code=outcome.code.value, message=outcome.message, items=list(outcome.items))
        if outcome.code is Code.OK:
            self.board.set(CHECKLIST_PASSED, True)
        return super().judge(outcome)
