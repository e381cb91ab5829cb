"""Whether the goal is approved and being followed, so that a resumed procedure need not begin there again."""

from __future__ import annotations

from behaviours.board import TRACKING
from behaviours.leaf import Condition
from behaviours.services import Services


class GoalSettled(Condition):
    """SUCCESS when the goal is approved and tracked.

    The permission to cut is another question: it ends at each interruption and is asked for again before cutting.
    """

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(TRACKING,))

    def holds(self) -> tuple[bool, str]:
        """Answer from the blackboard."""
        return (
            (True, "the goal is approved and followed") if self.board.get(TRACKING) else (False, "the goal is not approved yet")
        )
