"""After a dissection that failed: whether it helps to go on and look what is left, judged by its code."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import Key, Step, result_of
from behaviours.leaf import Leaf
from behaviours.recovery import Recovery, recovery
from behaviours.services import Services
from behaviours.session_outcome import StepResult
from hardware.codes import Code


class LookAnyway(Leaf):
    """SUCCESS when `recovery` of the dissection's code is LOOK; FAILURE otherwise, and when something else failed."""

    def __init__(self, name: str, services: Services) -> None:
        self._dissected: Key[StepResult | None] = result_of(Step.DISSECT)
        super().__init__(name, services, reads=(self._dissected,))

    def advance(self) -> Status:
        """Judge the code."""
        result = self.board.get(self._dissected)
        code = result.code if result else Code.INTERNAL_ERROR
        helps = recovery(code)
        self.feedback_message = f"{code.value}: {helps.value}"
        self.services.tell("recovery", step=Step.DISSECT.value, code=code.value, recovery=helps.value)
        return Status.SUCCESS if helps is Recovery.LOOK else Status.FAILURE
