"""The handle of one commanded motion: written by the driver, read by whoever asked for it."""

from __future__ import annotations

from hardware.codes import Code
from hardware.dvrk.motion import RUNNING
from hardware.interface import MoveReport, MoveStatus


class Move:
    """Implements `hardware.interface.MoveHandle`. It ends once; what comes later changes nothing."""

    def __init__(self) -> None:
        self._report = RUNNING

    def report(self) -> MoveReport:
        """The state of this motion now."""
        return self._report

    def end(self, code: Code, message: str = "") -> None:
        """Settle the report: done with OK, failed with any other code."""
        if self._report is RUNNING:
            self._report = MoveReport(MoveStatus.DONE if code is Code.OK else MoveStatus.FAILED, code, message)

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._report is RUNNING


def refused(message: str, code: Code = Code.MOVE_REJECTED) -> Move:
    """A motion that never began."""
    move = Move()
    move.end(code, message)
    return move
