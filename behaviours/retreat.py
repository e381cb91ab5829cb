"""Lift the tools clear of the tissue, whatever the attempts came to."""

from __future__ import annotations

from behaviours.run_skill import RunSkill
from hardware.gate import Lease
from skills.retreat_outcome import RetreatOutcome
from skills.skill import Steps


class Retreat(RunSkill[RetreatOutcome]):
    """SUCCESS when the tools are clear and both arms hold; FAILURE with the skill's code."""

    MOVES = True

    def skill(self, lease: Lease | None) -> Steps[RetreatOutcome]:
        """Retreat under the lease."""
        assert lease is not None
        return self.services.skills.retreat(lease)
