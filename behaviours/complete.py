"""Whether no tissue connection crosses the goal any more."""

from __future__ import annotations

from behaviours.board import ATTEMPT, ESTIMATE, INTERRUPTIONS, Attempt, Estimate
from behaviours.leaf import Condition
from behaviours.services import Services


class Complete(Condition):
    """SUCCESS when this attempt's own estimate, made after the last interruption, finds nothing connected and nothing unknown."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(ATTEMPT, ESTIMATE, INTERRUPTIONS))

    def holds(self) -> tuple[bool, str]:
        """Answer from the blackboard."""
        estimate = self.board.get(ESTIMATE)
        if is_complete(estimate, self.board.get(ATTEMPT), self.board.get(INTERRUPTIONS)):
            return True, "no tissue connection is left across the goal"
        return False, what_is_left(estimate)


def is_complete(estimate: Estimate | None, attempt: Attempt, interruptions: int) -> bool:
    """Whether `estimate` is of this attempt, not stale, and complete."""
    if estimate is None or estimate.attempt != attempt.number or estimate.interruptions != interruptions:
        return False
    return estimate.graph.complete


def what_is_left(estimate: Estimate | None) -> str:
    """Say how much of the goal is not known to be severed."""
    left = int(estimate.graph.uncut.sum()) if estimate else 0
    edges = {0: "nothing was seen that crosses the goal", 1: "1 edge across the goal is not known to be severed"}
    return edges.get(left, f"{left} edges across the goal are not known to be severed")
