"""Look once more when one look was not enough: at most once in an attempt, counted on the blackboard."""

from __future__ import annotations

import py_trees
from py_trees.common import Status

from behaviours.board import ATTEMPT, LOOKED_AGAIN, Board, Step, result_of
from behaviours.recovery import Recovery, recovery
from behaviours.services import Services
from behaviours.session_outcome import newest_failure


class LookAgain(py_trees.decorators.Decorator):
    """Around expose and estimate. A failure for which `recovery` is LOOK runs them anew, once; then it is a FAILURE."""

    def __init__(self, name: str, services: Services, child: py_trees.behaviour.Behaviour) -> None:
        super().__init__(name=name, child=child)
        self._services = services
        self._results = [result_of(step) for step in (Step.TRACK_EXPOSE, Step.EXPOSE, Step.ESTIMATE)]
        self._board = Board(name, (*self._results, ATTEMPT), (LOOKED_AGAIN,))

    def update(self) -> Status:
        """Judge how the look ended."""
        if self.decorated.status is not Status.FAILURE:
            return self.decorated.status
        failure = newest_failure(self._board.get(key) for key in self._results)
        attempt = self._board.get(ATTEMPT).number
        self.feedback_message = failure.message
        if recovery(failure.code) is not Recovery.LOOK or self._board.get(LOOKED_AGAIN) == attempt:
            return Status.FAILURE
        self._board.set(LOOKED_AGAIN, attempt)
        self.feedback_message = f"looking once more: {failure.message}"
        self._services.tell("recovery", step="look", code=failure.code.value, recovery=Recovery.LOOK.value)
        return Status.RUNNING
