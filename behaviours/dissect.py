"""Cut along the approved goal or the approved corrective segments. One approval serves one dissection."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import CUTTING_BEGAN, INTERRUPTIONS, PLAN
from behaviours.run_skill import RunSkill
from behaviours.services import Services
from behaviours.to_cut import to_cut
from hardware.codes import Code
from hardware.gate import Lease
from skills.dissect.outcome import DissectOutcome
from skills.skill import Steps


class Dissect(RunSkill[DissectOutcome]):
    """SUCCESS when every planned snip was made; FAILURE with the agent's code. The approval ends with it, however it ends."""

    MOVES = True

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(INTERRUPTIONS, PLAN), writes=(CUTTING_BEGAN,))
        self._ran = False

    def skill(self, lease: Lease | None) -> Steps[DissectOutcome]:
        """Give the agent what is to be cut, where it is now."""
        assert lease is not None
        self._ran = True
        self.board.set(CUTTING_BEGAN, True)
        return self._cut(lease)

    def judge(self, outcome: DissectOutcome) -> Status:
        """Record what was cut."""
        closed = sum(snip.code is Code.OK for snip in outcome.snips)
        self.services.tell("dissected", code=outcome.code.value, message=outcome.message, snips=len(outcome.snips), closed=closed)
        return super().judge(outcome)

    def end(self, preempted: bool) -> None:
        """Arms first, then the approval."""
        super().end(preempted)
        if self._ran:
            self._ran = False
            self.gate.withdraw_approval()

    def _cut(self, lease: Lease) -> Steps[DissectOutcome]:
        now = to_cut(self.services.goal, self.services.skills.tracked(), self.board.get(PLAN), self.board.get(INTERRUPTIONS))
        if now is None:
            return DissectOutcome(Code.GOAL_LOST, "the goal cannot be seen well enough to cut", ())
        return (yield from self.services.skills.dissect(lease, now.segments))
