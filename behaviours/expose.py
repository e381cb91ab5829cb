"""Pull the tissue so that what still bridges the goal is seen and stretched."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.run_skill import RunSkill
from hardware.gate import Lease
from skills.expose.outcome import ExposeOutcome
from skills.skill import Steps


class Expose(RunSkill[ExposeOutcome]):
    """SUCCESS when the tissue was pulled as far as planned or as a limit allows; FAILURE with the skill's code."""

    MOVES = True

    def skill(self, lease: Lease | None) -> Steps[ExposeOutcome]:
        """Expose under the lease."""
        assert lease is not None
        return self.services.skills.expose(lease)

    def judge(self, outcome: ExposeOutcome) -> Status:
        """Record how far it went."""
        self.services.tell(
            "exposed",
            code=outcome.code.value,
            message=outcome.message,
            stopped_by=outcome.stopped_by.value,
            steps=len(outcome.path),
        )
        return super().judge(outcome)
