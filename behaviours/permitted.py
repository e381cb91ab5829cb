"""Whether what would be cut now is what was approved: the approval lives, the cut is the same, the scene has not moved."""

from __future__ import annotations

from collections.abc import Sequence

from behaviours.approve import scene_moved
from behaviours.board import INTERRUPTIONS, PLAN, Key
from behaviours.leaf import Condition
from behaviours.proposal import Proposal
from behaviours.services import Services
from behaviours.to_cut import to_cut


class Permitted(Condition):
    """SUCCESS when dissection may begin; FAILURE when the operator has to be asked again."""

    def __init__(self, name: str, services: Services, grants: Sequence[Key[Proposal | None]]) -> None:
        super().__init__(name, services, reads=(*grants, INTERRUPTIONS, PLAN))
        self._grants = grants

    def holds(self) -> tuple[bool, str]:
        """Compare the gate's approval with what would be cut now."""
        approval = self.gate.approval
        if approval is None:
            return False, "there is no live approval"
        known = [grant for key in self._grants if (grant := self.board.get(key))]
        asked = max((grant for grant in known if grant.goal_id == approval.goal_id), key=lambda grant: grant.stamp, default=None)
        if asked is None:
            return False, "the approval is for another goal"
        now = to_cut(self.services.goal, self.services.skills.tracked(), self.board.get(PLAN), self.board.get(INTERRUPTIONS))
        if now is None:
            return False, "the goal cannot be seen"
        if (now.segments is None) != (asked.kind == "goal") or (
            now.segments is not None and len(now.segments) != len(asked.segments)
        ):
            return False, "the approval is for another cut"
        moved = scene_moved(asked, now, self.services.max_displacement)
        return (False, moved) if moved else (True, f"approved by {approval.by}")
