"""Begin the next attempt, or resume the one that was interrupted. The count lives on the blackboard and outlives interruptions.

After an interruption nothing old is trusted: if tissue may have been cut, a resumed attempt looks (exposes and estimates) before
anything is cut again. So does the attempt after one in which nothing could be planned: what is left was not seen, or not within reach as
the tissue lay. Without feedback there is no looking; the attempt then cuts anew, after a new approval.
"""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ATTEMPT, CUTTING_BEGAN, ESTIMATE, INTERRUPTIONS, PLAN, VERDICT, Attempt
from behaviours.leaf import Leaf
from behaviours.services import Services
from hardware.codes import Code


class BeginAttempt(Leaf):
    """SUCCESS with `ATTEMPT` written; FAILURE when there is nothing left to attempt."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(CUTTING_BEGAN, ESTIMATE, INTERRUPTIONS, PLAN, VERDICT), writes=(ATTEMPT,))

    def advance(self) -> Status:
        """Count, or resume."""
        last, interruptions = self.board.get(ATTEMPT), self.board.get(INTERRUPTIONS)
        limit = self.services.max_attempts
        if verdict := self.board.get(VERDICT):
            return self.fail(verdict.code, verdict.message)
        resumed = last.number > 0 and interruptions != last.interruptions
        if resumed:
            look = self.services.feedback and self.board.get(CUTTING_BEGAN)
            attempt = Attempt(last.number, not look, interruptions)
        elif last.number >= limit:
            return self.fail(Code.ATTEMPTS_USED, f"all {limit} attempts are used")
        else:
            attempt = Attempt(last.number + 1, not self._nothing_planned(last), interruptions)
        self.board.set(ATTEMPT, attempt)
        self.services.tell("attempt", number=attempt.number, limit=limit, resumed=resumed, cut=attempt.cut)
        what = "resumed" if resumed else "begun"
        return self.succeed(f"attempt {attempt.number} of {limit} {what}" + ("" if attempt.cut else ", looking first"))

    def _nothing_planned(self, last: Attempt) -> bool:
        """Whether the `last` attempt estimated what is left and made no plan to cut it."""
        estimate = self.board.get(ESTIMATE)
        return estimate is not None and estimate.attempt == last.number and self.board.get(PLAN) is None
