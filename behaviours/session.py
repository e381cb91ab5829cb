"""The root of the tree: guards first at every tick, then the procedure; at the end it says how the session ended."""

from __future__ import annotations

from collections.abc import Sequence as Children

import py_trees
from py_trees.common import Status

from behaviours.board import OUTCOME, RESULTS, VERDICT, Board
from behaviours.services import Services
from behaviours.session_outcome import SessionOutcome, newest_failure
from hardware.codes import Code


class Session(py_trees.composites.Sequence):
    """Sequence without memory. SUCCESS only with COMPLETE; the outcome is written to `OUTCOME` when it ends or is aborted."""

    def __init__(self, name: str, services: Services, children: Children[py_trees.behaviour.Behaviour]) -> None:
        super().__init__(name, memory=False, children=children)
        self._services = services
        self._board = Board(name, (*RESULTS, VERDICT), (OUTCOME,))

    def terminate(self, new_status: Status) -> None:
        """Write the outcome. Everything below has been stopped by now."""
        if self.status is not Status.RUNNING and new_status is Status.INVALID:
            return
        outcome = self._outcome(new_status)
        self._board.set(OUTCOME, outcome)
        self.feedback_message = outcome.message
        self._services.gate.withdraw_approval()

    def _outcome(self, status: Status) -> SessionOutcome:
        """A trip explains everything; otherwise the verdict of the attempts, unless something failed after it."""
        if trip := self._services.gate.tripped:
            return SessionOutcome(trip.code, trip.message)
        if status is Status.INVALID:
            return SessionOutcome(Code.ABORTED, "the session was stopped by a person")
        verdict = self._board.get(VERDICT)
        if status is Status.SUCCESS and verdict is not None:
            return verdict
        failure = newest_failure(self._board.get(key) for key in RESULTS)
        if verdict is None or verdict == failure:
            return failure
        return SessionOutcome(failure.code, f"{failure.message}; before that: {verdict.message}")
