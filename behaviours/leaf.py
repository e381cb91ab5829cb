"""The base of all leaves: services, declared blackboard keys, a result with a code, and no exception ever leaves a tick.

An exception that escaped from a tick would leave every node RUNNING with the arms under a lease; so each leaf turns its
own into a FAILURE with INTERNAL_ERROR. And once the safety gate has tripped, nothing is begun and nothing goes on: leaves wait
until the guards, at the next tick, end the session.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

import py_trees
from py_trees.common import Status

from behaviours.board import Board, Key, result_of
from behaviours.services import Services
from behaviours.session_outcome import StepResult
from hardware.codes import Code

log = logging.getLogger(__name__)


class Leaf(py_trees.behaviour.Behaviour):
    """One leaf. Subclasses say what happens in `begin`, `advance` and `end`; all three must return at once."""

    WATCHES = False  # guards go on while the gate is tripped

    def __init__(self, name: str, services: Services, *, reads: Iterable[Key[Any]] = (), writes: Iterable[Key[Any]] = ()) -> None:
        super().__init__(name)
        self.services = services
        self.gate = services.gate
        self._result = result_of(name)
        self.board = Board(name, reads, (*writes, self._result))
        self._begun = False
        self._ended = False

    def begin(self) -> None:
        """Start; called once before the first `advance`."""

    def advance(self) -> Status:
        """Go on a little and say how it stands."""
        raise NotImplementedError

    def end(self, preempted: bool) -> None:
        """Clean up. May be called more than once, also when the leaf never ran."""

    def succeed(self, message: str) -> Status:
        """End well."""
        return self._finish(Status.SUCCESS, Code.OK, message)

    def fail(self, code: Code, message: str) -> Status:
        """End with a failure; its code and sentence go to the blackboard."""
        return self._finish(Status.FAILURE, code, message)

    def wait(self, message: str) -> Status:
        """Not ended yet; `message` says what is going on."""
        self.feedback_message = message
        return Status.RUNNING

    def initialise(self) -> None:
        """Forget the last result; `begin` follows in the same tick."""
        self._begun = False
        if self._ended:
            self._ended = False
            self.board.set(self._result, None)

    def update(self) -> Status:
        """Begin, go on; an exception is a failure of this leaf."""
        if not self.WATCHES and self.gate.tripped:
            return self.wait("the safety gate has stopped everything")
        try:
            if not self._begun:
                self._begun = True
                self.begin()
            return self.advance()
        except Exception as error:
            return self.fail(Code.INTERNAL_ERROR, self._sentence(error))

    def terminate(self, new_status: Status) -> None:
        """Clean up at any end; if that goes wrong, everything stops."""
        preempted = new_status is Status.INVALID and self.status is Status.RUNNING
        try:
            self.end(preempted)
        except Exception as error:
            self.gate.trip(Code.INTERNAL_ERROR, f"{self.name} could not be ended: {self._sentence(error)}")
        if preempted:
            self.feedback_message = "interrupted"

    def _finish(self, status: Status, code: Code, message: str) -> Status:
        self.feedback_message = message
        self._ended = True
        self.board.set(self._result, StepResult(self.gate.bench.now(), code, message))
        return status

    def _sentence(self, error: Exception) -> str:
        log.exception("%s failed", self.name)
        return f"{type(error).__name__}: {error}"


class Condition(Leaf):
    """A question about the blackboard: SUCCESS means yes, FAILURE means no, and no is not a fault."""

    def holds(self) -> tuple[bool, str]:
        """Answer, with a few words why."""
        raise NotImplementedError

    def advance(self) -> Status:
        """Answer at once."""
        yes, self.feedback_message = self.holds()
        return Status.SUCCESS if yes else Status.FAILURE
