"""Attempt after attempt until there is a verdict. Whatever it is, this is SUCCESS: the tools must be lifted clear after it."""

from __future__ import annotations

import py_trees
from py_trees.common import Status

from behaviours.board import ATTEMPT, ESTIMATE, INTERRUPTIONS, RESULTS, VERDICT, Board
from behaviours.complete import is_complete
from behaviours.recovery import Recovery, recovery
from behaviours.services import Services
from behaviours.session_outcome import SessionOutcome, newest_failure
from hardware.codes import Code


class Attempts(py_trees.decorators.Decorator):
    """Around one attempt. RUNNING until the verdict; the attempts are counted on the blackboard, not here."""

    def __init__(self, name: str, services: Services, child: py_trees.behaviour.Behaviour) -> None:
        super().__init__(name=name, child=child)
        self._services = services
        self._board = Board(name, (*RESULTS, ATTEMPT, ESTIMATE, INTERRUPTIONS), (VERDICT,))

    def update(self) -> Status:
        """Judge how the attempt ended."""
        if self.decorated.status is Status.RUNNING:
            self.feedback_message = f"attempt {self._board.get(ATTEMPT).number} of {self._services.max_attempts}"
            return Status.RUNNING
        verdict = self._board.get(VERDICT) or self._verdict()
        if verdict is None:
            self.feedback_message = "going on to the next attempt"
            return Status.RUNNING
        if self._board.get(VERDICT) is None:
            self._services.gate.withdraw_approval()  # nothing is to be cut any more
            self._board.set(VERDICT, verdict)
            self._services.tell("verdict", code=verdict.code.value, message=verdict.message)
        self.feedback_message = verdict.message
        return Status.SUCCESS

    def _verdict(self) -> SessionOutcome | None:
        """Decide from what the attempt left on the blackboard; None: go on with the next attempt."""
        attempt, limit = self._board.get(ATTEMPT), self._services.max_attempts
        if self.decorated.status is Status.FAILURE:
            failure = newest_failure(self._board.get(key) for key in RESULTS)
            again = recovery(failure.code) is Recovery.RETRY and attempt.number < limit
            if again:
                self._services.tell("recovery", step="attempt", code=failure.code.value, recovery=Recovery.RETRY.value)
            return None if again else failure
        if not self._services.feedback:
            if attempt.number < limit:
                return None
            return SessionOutcome(Code.UNVERIFIED, f"the goal was cut {limit} times; without feedback nobody looked what is left")
        if is_complete(self._board.get(ESTIMATE), attempt, self._board.get(INTERRUPTIONS)):
            when = f"in attempt {attempt.number} of {limit}"
            return SessionOutcome(Code.COMPLETE, f"no tissue connection is left across the goal {when}")
        return None
