"""The procedure below the guards: it counts its interruptions, and none of them leaves an approval behind."""

from __future__ import annotations

from collections.abc import Sequence as Children

import py_trees
from py_trees.common import Status

from behaviours.board import INTERRUPTIONS, Board
from behaviours.services import Services


class Procedure(py_trees.composites.Sequence):
    """Sequence with memory. When interrupted it forgets where it was; the blackboard tells its leaves where to go on."""

    def __init__(self, name: str, services: Services, children: Children[py_trees.behaviour.Behaviour]) -> None:
        super().__init__(name, memory=True, children=children)
        self._services = services
        self._board = Board(name, (), (INTERRUPTIONS,))

    def terminate(self, new_status: Status) -> None:
        """Count an interruption. All leaves below have been ended by now, the lease first."""
        if new_status is not Status.INVALID or self.status is not Status.RUNNING:
            return
        self._services.gate.withdraw_approval()
        count = self._board.get(INTERRUPTIONS) + 1
        self._board.set(INTERRUPTIONS, count)
        self.feedback_message = "interrupted"
        self._services.tell("interruption", count=count)
