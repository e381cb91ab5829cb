"""A guard: asked at every tick, before anything else. What it cannot accept stops the procedure at once.

SUCCESS: all is well. RUNNING: a condition that may pass; the procedure is interrupted, both arms hold, and the guard waits.
FAILURE: a condition that only a person may clear; the gate is tripped with its code and the session ends in hold.
"""

from __future__ import annotations

from collections.abc import Callable

from py_trees.common import Status

from behaviours.board import CHECKLIST_PASSED
from behaviours.leaf import Leaf
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import SafetyGate, Verdict


class Guard(Leaf):
    """Asks `check` at every tick.

    With `once_checked`, what may pass by itself is accepted until the checklist has passed for the first time: arms that are not
    yet enabled and homed cannot say where they are. Nothing but the checklist runs until then, and it moves no arm by a lease.
    """

    WATCHES = True

    def __init__(self, name: str, services: Services, check: Callable[[], Verdict], *, once_checked: bool = False) -> None:
        super().__init__(name, services, reads=(CHECKLIST_PASSED,))
        self._check = check
        self._once_checked = once_checked

    def advance(self) -> Status:
        """Ask; a check that raises counts as a latched condition."""
        try:
            verdict = self._check()
        except Exception as error:
            verdict = Verdict(False, True, Code.INTERNAL_ERROR, f"the guard '{self.name}' failed: {error}")
        if verdict.ok:
            self.feedback_message = verdict.message or "ok"
            return Status.SUCCESS
        if verdict.latched:
            self.gate.trip(verdict.code, verdict.message)
            return self.fail(verdict.code, verdict.message)
        if self._once_checked and not self.board.get(CHECKLIST_PASSED):
            self.feedback_message = f"before the checklist: {verdict.message}"
            return Status.SUCCESS
        if self.status is not Status.RUNNING:
            self.services.tell("waiting", guard=self.name, code=verdict.code.value, message=verdict.message)
        return self.wait(f"holding: {verdict.message}")


def no_trip(gate: SafetyGate) -> Verdict:
    """Whether the emergency stop is free and nothing else has tripped the gate; either is latched."""
    if trip := gate.tripped:
        return Verdict(False, True, trip.code, trip.message)
    return gate.check_emergency_stop()


def recorder_writing(fault: str | None) -> Verdict:
    """Whether the record can be written; a `fault` is latched."""
    return Verdict(True) if fault is None else Verdict(False, True, Code.RECORDER_FAILED, fault)
