"""Whether this attempt must look before it may cut."""

from __future__ import annotations

from behaviours.board import ATTEMPT
from behaviours.leaf import Condition
from behaviours.services import Services


class LookFirst(Condition):
    """SUCCESS when nothing is known that may be cut now: then the attempt exposes and estimates first."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(ATTEMPT,))

    def holds(self) -> tuple[bool, str]:
        """Answer from the blackboard."""
        return (
            (False, "cutting") if self.board.get(ATTEMPT).cut else (True, "looking first: nothing is known that may be cut now")
        )
