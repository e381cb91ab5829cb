"""The last leaf: the procedure succeeds only if the goal was reached."""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import VERDICT
from behaviours.leaf import Leaf
from behaviours.services import Services
from hardware.codes import Code


class Verdict(Leaf):
    """SUCCESS for COMPLETE; FAILURE with the code of the verdict otherwise."""

    def __init__(self, name: str, services: Services) -> None:
        super().__init__(name, services, reads=(VERDICT,))

    def advance(self) -> Status:
        """Pass the verdict on."""
        verdict = self.board.get(VERDICT)
        if verdict is None:
            return self.fail(Code.INTERNAL_ERROR, "the attempts ended without a verdict")
        return self.succeed(verdict.message) if verdict.complete else self.fail(verdict.code, verdict.message)
