"""Plan the corrective goal from the newest estimate."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ESTIMATE, INTERRUPTIONS, PLAN, Plan
from behaviours.run_skill import RunSkill
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import Lease
from skills.replan.next_goal import NextGoal
from skills.skill import Steps


class Replan(RunSkill[NextGoal]):
    """SUCCESS with `PLAN` written; FAILURE with the skill's code, and with NO_CANDIDATE when the plan is empty."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(ESTIMATE, INTERRUPTIONS), writes=(PLAN,))

    def skill(self, lease: Lease | None) -> Steps[NextGoal]:
        """Plan; the last plan is forgotten first."""
        self.board.set(PLAN, None)
        estimate = self.board.get(ESTIMATE)
        if estimate is None:
            raise RuntimeError("there is no estimate to plan from")
        return self.services.skills.replan(estimate.graph)

    def judge(self, outcome: NextGoal) -> Status:
        """Keep the plan with the picture it was made on."""
        self.services.tell(
            "plan",
            code=outcome.code.value,
            message=outcome.message,
            segments=outcome.segments.tolist(),
            severs=[list(edges) for edges in outcome.severs],
            reasons=list(outcome.reasons),
            proven=outcome.proven,
            greedy_segments=outcome.greedy_segments,
            left_out=outcome.left_out,
        )
        if outcome.code is Code.OK and not len(outcome.segments):
            return self.fail(Code.NO_CANDIDATE, "the goal is not known to be severed, but no segment would sever what is left")
        if outcome.code is Code.OK:
            self.board.set(PLAN, Plan(outcome, self.services.skills.tracked(), self.board.get(INTERRUPTIONS)))
        return super().judge(outcome)
